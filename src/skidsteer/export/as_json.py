"""A calibration as JSON for software that is not ours: numbers with units in their names, and no history."""

from __future__ import annotations

import json
from dataclasses import asdict

from skidsteer.calibration import Calibration
from skidsteer.export.forced import Forced, force
from skidsteer.models import MatrixModel


def as_json(calibration: Calibration, forced: Forced | None = None) -> str:
    """Model, multipliers, covariance, noise and timing of a calibration as strict JSON.

    Raises:
        RequestError: the model does not move as a differential drive at all.
    """
    forced, model = forced or force(calibration), calibration.model
    found, timing = forced.projection, calibration.timing
    content = {
        "skidsteer_export": 1,
        "vehicle": {
            "name": calibration.vehicle.name,
            "track_width_m": calibration.vehicle.track_width,
            "wheel_radius_m": calibration.vehicle.wheel_radius,
        },
        "model": model.NAME,
        "parameters": {name: asdict(e) for name, e in calibration.parameters.items()},
        "matrix": model.matrix().tolist() if isinstance(model, MatrixModel) else None,  # rows v_x, v_y, omega
        "covariance": {"names": list(calibration.names), "rows": calibration.covariance.tolist()},
        "multipliers": {
            **{p.name: getattr(found.multipliers, p.name) for p in found.multipliers.PARAMETERS},
            "of_point_m": [found.x, found.y],
        },
        "noise": asdict(calibration.noise),
        "time_offset_s": timing.time_offset,
        "lag_s": timing.lag,
        "software": calibration.provenance.software,
    }
    return json.dumps(content, indent=2, allow_nan=False) + "\n"
