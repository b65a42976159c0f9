"""A drive made by a model instead of a robot: wheel speeds in, a Drive with noisy, late sensors out. Simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.models import Model
from skidsteer.noise import Noise
from skidsteer.se2 import FloatArray, chain, compose, exp
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Timing, Windows, predict


@dataclass(frozen=True, slots=True)
class Sensors:
    """What the simulated robot carries. Times in s, lengths in m, angles in rad."""

    reference_rate: float = 5.0  # [Hz]
    position_sigma: float = 0.01  # [m] each axis
    yaw_sigma: float = np.radians(0.5)
    stamp_sigma: float = 0.0  # [s] scatter of the reference's stamps
    reference_delay: float = 0.0  # [s] the stamps of the reference are late by this
    encoder_step: float = 0.0  # [m] rolled for one count; 0: no quantisation


def kinematic_drive(
    name: str,
    vehicle: Vehicle,
    model: Model,
    rims: Series,
    sensors: Sensors = Sensors(),
    lag: float = 0.0,
    motion_noise: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
) -> Drive:
    """Drive a kinematic model with held rim speeds and record it.

    Args:
        name: of the drive.
        vehicle: of the drive.
        model: the truth.
        rims: (n, 2) true rim speeds [m/s], held from sample to sample: what perfect encoders would tell.
        sensors: noise, rate and delay of what is recorded.
        lag: [s] time constant with which the body follows the rims.
        motion_noise: walk [m/sqrt(m)] and turn [rad/sqrt(m)] of ``skidsteer.noise.Noise``.
        seed: of the noise.

    Returns:
        A drive with wheels and reference poses on the same clock, the reference late by its delay.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(rims.t[0] + 0.05, rims.t[-1] - 0.05, 1.0 / sensors.reference_rate)
    windows = Windows(t[:-1], t[1:], np.zeros((len(t) - 1, 3)), np.ones(len(t) - 1, bool))
    motion = predict(model, rims, windows, Timing(0.0, lag))
    rolled = np.abs(rims.values).mean(axis=1)
    distance = np.diff(np.interp(t, rims.t, np.r_[0.0, np.cumsum(rolled[:-1] * np.diff(rims.t))]))
    spread = np.sqrt(distance)[:, None] * [motion_noise[0], motion_noise[0], motion_noise[1]]
    truth = chain(compose(motion, exp(spread * rng.standard_normal(motion.shape))))
    stamped = t + sensors.reference_delay + sensors.stamp_sigma * rng.standard_normal(len(t))
    noise = np.array([sensors.position_sigma, sensors.position_sigma, sensors.yaw_sigma])
    measured = compose(truth, exp(noise * rng.standard_normal(truth.shape)))
    order = np.argsort(stamped)
    pose = Series(stamped[order], measured[order], "pose")
    return Drive(name, vehicle, _encoders(rims, sensors.encoder_step), pose=pose, source=f"simulated, seed {seed}")


def _encoders(rims: Series, step: float) -> Series:
    """Rim speeds as counts of an encoder tell them: the rolled distance rounded to whole counts, differentiated."""
    if step == 0.0:
        return rims
    dt = np.diff(rims.t, append=2.0 * rims.t[-1] - rims.t[-2])[:, None]
    rolled = np.concatenate([np.zeros((1, 2)), np.cumsum(rims.values * dt, axis=0)])
    return Series(rims.t, np.diff(np.round(rolled / step) * step, axis=0) / dt, "wheels")


def rims_from_manoeuvres(
    manoeuvres: FloatArray, model: Model, rate: float = 100.0, acceleration: float = 0.6
) -> Series:
    """Rim speeds (n, 2) that follow manoeuvres one after the other.

    Args:
        manoeuvres: rows of duration [s], v [m/s], omega [rad/s]; what is commanded, held for the duration.
        model: turns v and omega into rim speeds.
        rate: [Hz] of the samples.
        acceleration: [m/s^2] that no rim exceeds.
    """
    targets = model.wheel_speeds(manoeuvres[:, 1], manoeuvres[:, 2])
    ends = np.cumsum(manoeuvres[:, 0])
    t = np.arange(0.0, ends[-1], 1.0 / rate)
    wanted = targets[np.minimum(np.searchsorted(ends, t, side="right"), len(ends) - 1)]  # t may round up to the end
    rims = np.zeros_like(wanted)
    for i in range(1, len(t)):
        rims[i] = rims[i - 1] + np.clip(wanted[i] - rims[i - 1], -acceleration / rate, acceleration / rate)
    return Series(t, rims, "wheels")


def matching_noise(sensors: Sensors, motion_noise: tuple[float, float]) -> Noise:
    """The ``Noise`` that a simulated drive has, with zeros replaced by the least that an estimator allows."""
    values = (sensors.position_sigma, sensors.yaw_sigma, sensors.stamp_sigma, *motion_noise)
    return Noise(*(max(v, least) for v, least in zip(values, (1e-6, 1e-6, 1e-5, 1e-6, 1e-6), strict=True)))
