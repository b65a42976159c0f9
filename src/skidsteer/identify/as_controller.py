"""What a model becomes in a differential drive controller, and its errors there on held-out windows."""

from __future__ import annotations

from skidsteer.calibration import Controller, HeldOut
from skidsteer.drive import Drive
from skidsteer.identify.holdout import HeldOutErrors, held_out_errors
from skidsteer.models import Model
from skidsteer.multipliers import moving_rims, project


def as_controller(model: Model, drives: list[Drive], judged: HeldOutErrors | None, length: float) -> Controller | None:
    """Force a model into three multipliers; None where no differential drive comes near to it.

    Args:
        model: fitted to all drives.
        drives: their motions decide what a model that is not linear in the rim speeds becomes.
        judged: the fits to parts of the drives; each is forced and judged on the other part. None: no figures.
        length: of the judging windows [s].
    """
    rims, width = moving_rims(drives), drives[0].vehicle.track_width
    try:
        projection = project(model, rims, width)
        if judged is None:
            return Controller(projection, None)
        forced = held_out_errors(judged.folds, drives, length, lambda fitted: project(fitted, rims, width).multipliers)
    except ValueError:
        return None
    return Controller(projection, HeldOut.of(forced.errors, block=forced.block))
