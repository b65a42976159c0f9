"""GNSS fixes to positions in a local metric frame."""

from __future__ import annotations

import numpy as np

from skidsteer.errors import DataError, RequestError
from skidsteer.io.stamps import Timed
from skidsteer.se2 import FloatArray

_KNOWN_COVARIANCE = 1  # position_covariance_type: 1 approximated, 2 diagonal known, 3 known
_POOR = 5.0  # fixes this many times less certain than the median one are from another mode of the receiver
_STATUS = {0: "single", 1: "SBAS", 2: "GBAS or RTK"}


def positions(fixes: Timed, name: str, notes: list[str]) -> Timed:
    """Fixes as positions east, north [m] of the first good one, (n, 2), in the plane that touches the ellipsoid there.

    Fixes with a status below zero (no fix), impossible coordinates, or a standard deviation of more than five times
    the median are dropped and counted in ``notes``.

    Args:
        fixes: (n, 6) latitude, longitude [deg], altitude [m], status, horizontal variance [m2], covariance type.
        name: of the topic, for messages.
        notes: takes what was dropped.

    Raises:
        DataError: no usable fix.
        RequestError: ``pyproj`` is not installed.
    """
    latitude, longitude, _, status, _, _ = fixes.values.T
    real = (status >= 0) & (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 360.0)
    if not real.any():
        raise DataError(f"{name}: none of its {len(real)} messages holds a GNSS fix")
    good = real & ~_much_less_certain(fixes.values, real)
    if not good.all():
        notes.append(
            f"{name}: {int((~real).sum())} of {len(real)} messages without a fix"
            f" and {int((real & ~good).sum())} with a poor one dropped"
        )
    best = int(np.median(status[good]))
    notes.append(f"{name}: {int(good.sum())} fixes, most of them {_STATUS.get(best, f'of status {best}')}")
    kept = fixes.where(good)
    return kept.with_values(east_north(kept.values[:, :3]))


def _much_less_certain(values: FloatArray, real: np.typing.NDArray[np.bool_]) -> np.typing.NDArray[np.bool_]:
    known = real & (values[:, 5] >= _KNOWN_COVARIANCE) & (values[:, 4] > 0)
    if not known.any():
        return np.zeros(len(values), dtype=bool)
    return np.asarray(known & (values[:, 4] > _POOR**2 * np.median(values[known, 4])))


def east_north(geodetic: FloatArray) -> FloatArray:
    """Latitude, longitude [deg], altitude [m] (n, 3) on WGS 84 as east, north [m] (n, 2) of the first of them.

    Raises:
        RequestError: ``pyproj`` is not installed.
    """
    try:
        from pyproj import Transformer
    except ImportError as error:
        raise RequestError("reading NavSatFix needs more packages: pip install 'skidsteer[bags]'") from error
    latitude, longitude, altitude = geodetic.T
    local = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84"
        f" +lat_0={latitude[0]:.12f} +lon_0={longitude[0]:.12f} +h_0={altitude[0]:.6f}"
    )
    east, north, _ = local.transform(longitude, latitude, altitude, radians=False)
    return np.stack([east, north], axis=1)
