"""Simulation: a model or plant in place of the robot; wheel speeds in, a Drive with noisy, late sensors out.

A plant tells how the robot moved, as a `Motion`; what its sensors record of it is the same for every plant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skidsteer.drive import Drive, Series
from skidsteer.errors import RequestError
from skidsteer.models import Differential, Model
from skidsteer.noise import paths_between
from skidsteer.se2 import FloatArray, chain, compose, exp
from skidsteer.vehicle import Vehicle
from skidsteer.windows import Mount, Timing, Windows, predict

CENTRE = Mount()
FASTEST = 20.0  # [m/s] of a rim; no skid-steer robot is faster
MARGIN = 0.05  # [s] from the ends of the wheels' log to the first and the last reference


CREDIBLE = {  # least and most of each number; beyond, it is in another unit
    "reference_rate": (1e-3, 1e4, "Hz"),
    "position_sigma": (0.0, 10.0, "m"),
    "yaw_sigma": (0.0, np.pi, "rad"),
    "stamp_sigma": (0.0, 1.0, "s"),
    "reference_delay": (-60.0, 60.0, "s"),
    "encoder_step": (0.0, 1.0, "m"),
    "encoder_rate": (0.0, 1e4, "Hz"),
    "gyro_rate": (0.0, 1e4, "Hz"),
    "gyro_sigma": (0.0, 10.0, "rad/s"),
    "gyro_bias": (-10.0, 10.0, "rad/s"),
}
MOST_WALK = (1.0, np.pi)  # [m/sqrt(m)], [rad/sqrt(m)] of a motion's noise


@dataclass(frozen=True, slots=True)
class Sensors:
    """What the simulated robot carries. Times in s, lengths in m, angles in rad.

    Raises:
        RequestError: a number outside ``CREDIBLE``.
    """

    reference_rate: float = 5.0  # [Hz]
    position_sigma: float = 0.01  # [m] each axis
    yaw_sigma: float = np.radians(0.5)
    stamp_sigma: float = 0.0  # [s] scatter of the reference's stamps
    reference_delay: float = 0.0  # [s] the stamps of the reference are late by this
    encoder_step: float = 0.0  # [m] rolled for one count; 0: no quantisation
    encoder_rate: float = 0.0  # [Hz] of the wheels' log; 0: as the plant tells them
    mount: Mount = CENTRE  # of the reference's sensor; the drive holds its poses
    lost_share: float = 0.0  # of the time that no reference comes
    lost_duration: float = 2.0  # [s] mean of a stretch without
    gyro_rate: float = 0.0  # [Hz]; 0: no gyro
    gyro_sigma: float = 0.002  # [rad/s] each sample
    gyro_bias: float = 0.0  # [rad/s]

    def __post_init__(self) -> None:
        for name, (least, most, unit) in CREDIBLE.items():
            if not least <= (value := getattr(self, name)) <= most:
                raise RequestError(f"sensors: {name} must be from {least:g} to {most:.3g} {unit}, got {value:g}")


PLAIN = Sensors()


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """How a plant moved, at n times, in the frame of its start."""

    t: FloatArray  # (n,) [s]
    pose: FloatArray  # (n, 3) of base_link
    twist: FloatArray  # (n, 3) of base_link, in its own frame
    rims: FloatArray  # (n, 2) left and right [m/s]
    power: FloatArray  # (n, 3) [W] mean over the step before: by the rims, lost by sliding, by rolling; NaN: not told

    def held_rims(self) -> Series:
        """Mean rim speeds (n - 1, 2) of each step, stamped with its start: what perfect encoders tell."""
        return Series(self.t[:-1], 0.5 * (self.rims[:-1] + self.rims[1:]), "wheels")

    def pose_at(self, t: FloatArray) -> FloatArray:
        """Pose (k, 3) at times (k,) [s] between the first and the last."""
        return np.column_stack([np.interp(t, self.t, column) for column in self.pose.T])


def recorded(
    name: str, vehicle: Vehicle, motion: Motion, sensors: Sensors, seed: int = 0, wheel_command: Series | None = None
) -> Drive:
    """What sensors record of a plant's motion.

    Args:
        name: of the drive.
        vehicle: of the drive.
        motion: of the plant.
        sensors: noise, rate and delay of what is recorded.
        seed: of the noise.
        wheel_command: (n, 2) [m/s] what the plant was asked for.

    Raises:
        RequestError: the motion is shorter than two references.
    """
    rims = motion.held_rims()
    t = _reference_times(rims, sensors)
    rng = np.random.default_rng(seed)
    truth = Series(t, motion.pose_at(t), "pose")
    return _record(name, vehicle, rims, truth, lambda s: motion.pose_at(s)[:, 2], sensors, rng, seed, wheel_command)


def kinematic_drive(
    name: str,
    vehicle: Vehicle,
    model: Model,
    rims: Series,
    sensors: Sensors = PLAIN,
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

    Raises:
        RequestError: a motion noise that is negative or beyond ``MOST_WALK``, a motion shorter than two references.
    """
    if not all(0.0 <= noise <= most for noise, most in zip(motion_noise, MOST_WALK, strict=True)):
        raise RequestError(
            f"motion noise must be from 0 to {MOST_WALK[0]:g} m and {MOST_WALK[1]:.3g} rad, each for a way of 1 m,"
            f" got {motion_noise[0]:g} and {motion_noise[1]:g}"
        )
    rng = np.random.default_rng(seed)
    t = _reference_times(rims, sensors)
    motion = _motions(model, rims, t[:-1], t[1:], lag)
    spread = np.sqrt(paths_between(rims, t)) * [motion_noise[0], motion_noise[0], motion_noise[1]]
    truth = chain(compose(motion, exp(spread * rng.standard_normal(motion.shape))))
    strayed = truth[:, 2] - np.concatenate([[0.0], np.cumsum(motion[:, 2])])

    def yaw(times: FloatArray) -> FloatArray:
        turned = _motions(model, rims, np.full(len(times), rims.t[0]), times, lag)[:, 2]
        return np.asarray(turned + np.interp(times, t, strayed))

    return _record(name, vehicle, rims, Series(t, truth, "pose"), yaw, sensors, rng, seed)


def _motions(model: Model, rims: Series, start: FloatArray, end: FloatArray, lag: float) -> FloatArray:
    windows = Windows(start, end, np.zeros((len(start), 3)), np.ones(len(start), bool))
    return predict(model, rims, windows, Timing(0.0, lag))


def _reference_times(rims: Series, sensors: Sensors) -> FloatArray:
    t = np.arange(rims.t[0] + MARGIN, rims.t[-1] - MARGIN, 1.0 / sensors.reference_rate)
    if len(t) < 2:
        raise RequestError(f"{rims.t[-1] - rims.t[0]:.2f} s are too short for two references; drive longer")
    return t


def _record(
    name: str,
    vehicle: Vehicle,
    rims: Series,
    truth: Series,
    yaw: Callable[[FloatArray], FloatArray],
    sensors: Sensors,
    rng: np.random.Generator,
    seed: int,
    wheel_command: Series | None = None,
) -> Drive:
    """A drive from rim speeds held, true poses at the reference's times, and the yaw [rad] at any times."""
    n = len(truth)
    stamped = truth.t + sensors.reference_delay + sensors.stamp_sigma * rng.standard_normal(n)
    noise = np.array([sensors.position_sigma, sensors.position_sigma, sensors.yaw_sigma])
    seen = compose(truth.values, [sensors.mount.x, sensors.mount.y, sensors.mount.yaw])
    measured = compose(seen, exp(noise * rng.standard_normal((n, 3))))
    order = np.argsort(stamped)
    order = order[~_lost(truth.t, sensors, rng)[order]]
    return Drive(
        name,
        vehicle,
        _encoders(rims, sensors),
        pose=Series(stamped[order], measured[order], "pose"),
        gyro=_gyro(rims, yaw, sensors, rng) if sensors.gyro_rate > 0.0 else None,
        wheel_command=wheel_command,
        source=f"simulated, seed {seed}",
    )


def _lost(t: FloatArray, sensors: Sensors, rng: np.random.Generator) -> np.ndarray:
    """Which references (n,) are lost: stretches of random length, but never the first or the last."""
    lost = np.zeros(len(t), bool)
    if sensors.lost_share <= 0.0:
        return lost
    if not (sensors.lost_share < 1.0 and sensors.lost_duration > 0.0):
        raise RequestError(f"need lost_share below 1 and lost_duration above 0 s, got {sensors}")
    rate = -np.log1p(-sensors.lost_share) / sensors.lost_duration  # of stretches, which may overlap
    first = t[0] - 10.0 * sensors.lost_duration
    starts = rng.uniform(first, t[-1], rng.poisson(rate * (t[-1] - first)))
    for start, length in zip(starts, rng.exponential(sensors.lost_duration, len(starts)), strict=True):
        lost |= (t >= start) & (t < start + length)
    lost[[0, -1]] = False
    return lost


def _gyro(rims: Series, yaw: Callable[[FloatArray], FloatArray], sensors: Sensors, rng: np.random.Generator) -> Series:
    """Yaw rates, each the mean over one period around its stamp."""
    half = 0.5 / sensors.gyro_rate
    t = np.arange(rims.t[0] + half, rims.t[-1] - half, 2.0 * half)
    rate = (yaw(t + half) - yaw(t - half)) * sensors.gyro_rate
    return Series(t, rate + sensors.gyro_bias + sensors.gyro_sigma * rng.standard_normal(len(t)), "gyro")


def _encoders(rims: Series, sensors: Sensors) -> Series:
    """Rim speeds as an encoder measures them: the rolled distance rounded to whole counts, differentiated."""
    step, rate = sensors.encoder_step, sensors.encoder_rate
    if step == 0.0 and rate == 0.0:
        return rims
    edges = np.append(rims.t, 2.0 * rims.t[-1] - rims.t[-2])
    rolled = np.concatenate([np.zeros((1, 2)), np.cumsum(rims.values * np.diff(edges)[:, None], axis=0)])
    if rate > 0.0:
        t = np.arange(edges[0], edges[-1], 1.0 / rate)
        edges, rolled = t, np.column_stack([np.interp(t, edges, side) for side in rolled.T])
    counted = np.round(rolled / step) * step if step > 0.0 else rolled
    return Series(edges[:-1], np.diff(counted, axis=0) / np.diff(edges)[:, None], "wheels")


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


def controller(vehicle: Vehicle) -> Differential:
    """How the robot's own controller turns v and omega into rim speeds: by its factory or else track width."""
    width = (vehicle.factory_separation or vehicle.track_width) * (vehicle.factory_multiplier or 1.0)
    return Differential(width)


def refuse_fast(vehicle: Vehicle, commands: Series) -> None:
    """Refuse rim speeds (n, 2) [m/s] that a vehicle, or where its limit is unknown any robot, cannot reach.

    Raises:
        RequestError: one of them is beyond ``max_wheel_speed``, or they are not of two sides.
    """
    if commands.values.shape[1] != 2:
        raise RequestError(f"commands need two columns, left and right rim speed, got {commands.values.shape[1]}")
    limit, size = vehicle.max_wheel_speed or FASTEST, np.abs(commands.values)
    if size.max() <= limit * (1.0 + 1e-9):
        return
    at, side = np.unravel_index(size.argmax(), size.shape)
    reached = f"{vehicle.name} reaches {limit} m/s" if vehicle.max_wheel_speed else f"no robot reaches {limit:g} m/s"
    raise RequestError(
        f"the {('left', 'right')[side]} wheels are asked for {commands.values[at, side]:.3f} m/s at"
        f" {commands.t[at]:.2f} s, but {reached}; drive slower or turn less"
    )
