"""A controller on the exact kinematics of an ICR model, for the tests of the controllers."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from skidsteer.control import Controller, Wheels
from skidsteer.control.path_state import State
from skidsteer.models import Icr
from skidsteer.paths import Path
from skidsteer.se2 import FloatArray, compose, exp

PLANT = Icr(0.48, -0.42, 0.28, 0.9, 0.93)  # every parameter non-zero, no two alike
CENTRED = Icr(0.48, -0.42, 0.0, 0.9, 0.93)
# PLANT with its rear taken for its front
TURNED = Icr(-PLANT.icr_y_right, -PLANT.icr_y_left, -PLANT.icr_x, PLANT.alpha_right, PLANT.alpha_left)


class Run(NamedTuple):
    poses: FloatArray  # (n, 3)
    rims: FloatArray  # (n, 2) [m/s]
    s: FloatArray  # (n,) [m] of the state
    aside: FloatArray  # (n,) [m] cross-track error, positive to the left
    twists: FloatArray  # (n, 3)


def follow(
    controller: Controller[State], wheels: Wheels, path: Path, start: ArrayLike, duration: float, dt: float = 0.02
) -> Run:
    """Poses at the beginning of each step, and the rim speeds held during it."""
    pose, twist = np.asarray(start, dtype=float), np.zeros(3)
    state = controller.begin(path, pose)
    near, rows = state.s, []
    for _ in range(round(duration / dt)):
        rims = wheels.speeds(*controller.command(pose, twist, state))
        near = path.project(pose[:2], near=near)
        twist = wheels.model.twist(rims[0], rims[1])
        rows.append((pose, rims, state.s, path.error(pose, near)[1], twist))
        v, _, omega = twist.tolist()
        pose = compose(pose, exp(twist * dt))
        state = controller.advance(state, pose, twist, dt, (v, omega))
    return Run(*(np.array(column) for column in zip(*rows, strict=True)))
