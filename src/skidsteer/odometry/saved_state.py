"""A filter's state as JSON, exact to the last bit, so that a robot continues where it was switched off."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from skidsteer.errors import DataError
from skidsteer.io.atomic import write_text
from skidsteer.io.text_file import decode, read_bytes
from skidsteer.odometry.state import Filter, FilterState, refuse_foreign, refuse_indefinite

SCHEMA = 1
LARGEST = 1 << 20  # [bytes]


class _File(BaseModel):
    """The layout of the file; NaN is null."""

    model_config = ConfigDict(extra="forbid")

    skidsteer_filter_state: int
    filter: str
    names: list[str]
    time: float
    mean: list[float]
    covariance: list[list[float]]
    memory: list[float | None]


def save_state(filter: Filter, state: FilterState, path: str | os.PathLike[str]) -> None:
    """Write the state of a filter, all of it or nothing.

    Raises:
        DataError: the file cannot be written.
        RequestError: the state belongs to another filter.
    """
    refuse_foreign(state, filter.fingerprint)
    content: dict[str, Any] = {
        "skidsteer_filter_state": SCHEMA,
        "filter": state.filter,
        "names": list(filter.names),
        "time": state.time,
        "mean": state.mean.tolist(),
        "covariance": state.covariance.tolist(),
        "memory": [None if value != value else value for value in state.memory.tolist()],
    }
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def load_state(filter: Filter, path: str | os.PathLike[str]) -> FilterState:
    """Read the state of a filter.

    Raises:
        DataError: no such file, not a state, shapes that do not fit, numbers that are not finite, a covariance that is
            not positive definite.
        RequestError: the state of another filter, or of the same with another calibration.
    """
    text = decode(path, read_bytes(path, LARGEST))
    try:
        file = _File.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "JSON"
        raise DataError(f"{path}: is not a state of a filter: {where}: {first['msg']}") from error
    if file.skidsteer_filter_state != SCHEMA:
        raise DataError(f"{path}: a state of version {file.skidsteer_filter_state}, this software reads {SCHEMA}")
    n = len(filter.names)
    mean = np.array(file.mean)
    memory = np.array([np.nan if value is None else value for value in file.memory], dtype=float)
    if any(len(row) != len(file.covariance) for row in file.covariance):
        raise DataError(f"{path}: the rows of the covariance are not of one length")
    covariance = refuse_indefinite(f"{path}", np.array(file.covariance, dtype=float))
    state = FilterState(file.filter, file.time, mean, covariance, memory)
    refuse_foreign(state, filter.fingerprint)
    expected = len(filter.start(0.0, np.zeros(3), np.eye(3)).memory)
    if mean.shape != (n,) or covariance.shape != (n, n) or memory.shape != (expected,):
        raise DataError(
            f"{path}: {len(mean)} means, {len(covariance)} rows and {len(memory)} further numbers do not fit the"
            f" filter, which has {n} and {expected}"
        )
    if not (np.isfinite(mean).all() and np.isfinite(file.time)):
        raise DataError(f"{path}: time and mean must be finite")
    return state
