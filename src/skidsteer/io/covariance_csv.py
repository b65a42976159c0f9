"""Covariances of a trajectory as CSV: a line for each pose, with the upper triangle of its matrix."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.io import atomic

HEADER = "t,xx,xy,xyaw,yy,yyaw,yawyaw"  # [s], [m^2], [m^2], [m rad], [m^2], [m rad], [rad^2]
UPPER = np.triu_indices(3)


def write_covariances(path: str | os.PathLike[str], t: ArrayLike, covariances: ArrayLike) -> None:
    """Write covariances (m, 3, 3) of x, y [m], yaw [rad] at times t (m,) [s], in one step.

    Raises:
        ValueError: times and covariances do not belong together.
        DataError: the file cannot be written.
    """
    t, P = np.asarray(t, dtype=float), np.asarray(covariances, dtype=float).reshape(-1, 3, 3)
    if t.shape != (len(P),):
        raise ValueError(f"need one time for each covariance, got {t.shape} times and {len(P)} covariances")
    rows = zip(t.tolist(), P[:, UPPER[0], UPPER[1]].tolist(), strict=True)
    lines = (f"{time:.9f},{','.join(map(repr, row))}\n" for time, row in rows)
    atomic.write_text(path, f"{HEADER}\n{''.join(lines)}")
