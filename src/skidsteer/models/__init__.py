"""Motion models. A new one is one file and one line here, from the simplest to the richest."""

from skidsteer.models.curvature import Curvature
from skidsteer.models.differential import Differential, Multiplier
from skidsteer.models.icr import Icr, SymmetricIcr
from skidsteer.models.linear import Linear
from skidsteer.models.model import MatrixModel, Model, Parameter
from skidsteer.models.scheduled_icr import ScheduledIcr

MODELS: dict[str, type[Model]] = {
    "differential": Differential,
    "multiplier": Multiplier,
    "icr_symmetric": SymmetricIcr,
    "curvature": Curvature,
    "icr": Icr,
    "linear": Linear,
    "scheduled_icr": ScheduledIcr,
}

__all__ = [
    "MODELS",
    "Curvature",
    "Differential",
    "Icr",
    "Linear",
    "MatrixModel",
    "Model",
    "Multiplier",
    "Parameter",
    "ScheduledIcr",
    "SymmetricIcr",
]
