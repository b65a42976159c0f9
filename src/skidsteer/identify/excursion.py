"""How far a robot that is not calibrated yet may get from where a table of commands wants it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.drive import Series
from skidsteer.models import Model, ScheduledIcr
from skidsteer.noise import Noise, paths_between
from skidsteer.se2 import chain, compose, exp
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Timing, Windows, predict

TERMS = {
    "turn_loss": 0.1,
    "side_slip": 0.25,
    "straight_gain": 0.05,
    "load_gain": 0.1,
    "slip_fade": 0.1,
}  # typical of fits on real drives
MOST = {
    "turn_loss": 0.15,
    "side_slip": 0.35,
    "straight_gain": 0.2,
    "load_gain": 0.2,
    "slip_fade": 0.4,
}  # the most of them
COARSE = 0.2  # [s] between the poses looked at
SURE = 0.95  # share of robots and drives that stay within what is said
DRAWS = 60


def expected_icr_distance(vehicle: Vehicle) -> float:
    """Distance [m] of the tread ICRs to expect of a robot before any drive.

    The factory's correction where there is one; else that of four equally loaded wheels with isotropic Coulomb
    friction, B (1 + (L / B)^2), the limit of Wang 2015 without rolling resistance and shear; else 1.5 track widths.
    """
    if vehicle.factory_multiplier is not None:
        return (vehicle.factory_separation or vehicle.track_width) * vehicle.factory_multiplier
    if vehicle.wheel_base is not None:
        return vehicle.track_width * (1.0 + (vehicle.wheel_base / vehicle.track_width) ** 2)
    return 1.5 * vehicle.track_width


def expected_model(family: type[Model], vehicle: Vehicle) -> Model:
    """What to expect of a robot before any drive, in terms of one of the models."""
    width, model = expected_icr_distance(vehicle), family.nominal(vehicle)
    chi = width / vehicle.track_width
    known = {"icr_y_left": width / 2, "icr_y_right": -width / 2, "icr_y": width / 2, "multiplier": chi, "a": chi - 1.0}
    known |= {"omega_left": -1.0 / width, "omega_right": 1.0 / width} | TERMS
    return model.with_theta([known.get(p.name, getattr(model, p.name)) for p in model.PARAMETERS])


def possible_models(vehicle: Vehicle, seed: int) -> list[Model]:
    """What the robot may turn out to be: ``DRAWS`` scheduled ICR models about the expected one.

    Standard deviations: the ICR distance 20 % (a ground changes it by as much, Mandow 2007, Table I), each tread's ICR
    5 % of it beside, icr_x a tenth of the track, scale factors 4 % and 1.5 % of each side beside; the terms at speed
    from nothing to ``MOST``. Fits on real drives of two robots on six grounds scatter like that.
    """
    rng, width = np.random.default_rng(seed), expected_icr_distance(vehicle)
    out: list[Model] = []
    for common, left, right, x, alpha, left_alpha, right_alpha in np.clip(rng.standard_normal((DRAWS, 7)), -2.5, 2.5):
        half = 0.5 * width * (1.0 + 0.2 * common)
        constant = (
            half + 0.05 * width * left,
            -half + 0.05 * width * right,
            0.1 * vehicle.track_width * x,
            1.0 + 0.04 * alpha + 0.015 * left_alpha,
            1.0 + 0.04 * alpha + 0.015 * right_alpha,
        )
        out.append(ScheduledIcr(*constant, **{name: float(rng.uniform(0.0, most)) for name, most in MOST.items()}))
    return out


def calibrated_models(calibration: Calibration, seed: int) -> list[Model]:
    """What a calibrated robot may be: draws from the covariance of its parameters, inside their bounds."""
    rng, model = np.random.default_rng(seed), calibration.model
    index = [calibration.names.index(name) for name in calibration.parameters]
    covariance = calibration.covariance[np.ix_(index, index)]
    theta = rng.multivariate_normal(model.theta, covariance, DRAWS, method="eigh")
    return [model.with_theta(np.clip(row, *type(model).bounds(calibration.vehicle).T)) for row in theta]


def footprint_radius(vehicle: Vehicle) -> float:
    """Radius [m] of a circle about base_link that holds the robot: outer corners of its wheels, a radius wide."""
    base = vehicle.wheel_base if vehicle.wheel_base is not None else vehicle.track_width
    return float(np.hypot(0.5 * base + vehicle.wheel_radius, 0.5 * (vehicle.track_width + vehicle.wheel_radius)))


def trajectory(
    model: Model, rims: Series, lag: float, noise: Noise | None = None, seed: int = 0, step: float = COARSE
) -> Series:
    """Poses (n, 3) every ``step`` seconds from the origin; with motion noise where it is given."""
    t = np.append(np.arange(rims.t[0], rims.t[-1] - 1e-9, step), rims.t[-1])
    windows = Windows(t[:-1], t[1:], np.zeros((len(t) - 1, 3)), np.ones(len(t) - 1, bool))
    motion = predict(model, rims, windows, Timing(0.0, lag))
    if noise is not None:
        spread = np.sqrt(paths_between(rims, t)) * [noise.walk, noise.walk, noise.turn]
        motion = compose(motion, exp(spread * np.random.default_rng(seed).standard_normal(motion.shape)))
    return Series(t, chain(motion), "path")


@dataclass(frozen=True, slots=True)
class Excursion:
    """How far base_link gets from the start: along x and y at most, and in the end; ``SURE`` of all draws stay within.

    Along x is ahead of and behind the first pose.
    """

    x: float  # [m]
    y: float  # [m]
    end: float  # [m]


def excursion(models: list[Model], rims: Series, lag: float, noise: Noise | None, seed: int = 0) -> Excursion:
    """Play rim speeds on possible robots; without noise none but the models' own differences."""
    paths = [trajectory(m, rims, lag, noise, seed + i).values for i, m in enumerate(models)]
    far = np.array([[*np.abs(p[:, :2]).max(axis=0), np.hypot(*p[-1, :2])] for p in paths])
    x, y, end = np.quantile(far, SURE, axis=0)
    return Excursion(float(x), float(y), float(end))
