"""Controllers by name, as they are launched: their gains by name, what each is told of the robot."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from skidsteer.control import (
    Controller,
    Huskic,
    Limits,
    Observer,
    Pentzer,
    Predictive,
    PredictiveGains,
    SaturationSpeed,
    Soetanto,
    Wheels,
    icr_x_at,
)
from skidsteer.control import huskic as huskic_law
from skidsteer.control import pentzer as pentzer_law
from skidsteer.control import pure_pursuit as pursuit
from skidsteer.control import soetanto as soetanto_law
from skidsteer.errors import RequestError, named
from skidsteer.models import ScheduledIcr

TYPICAL = 0.5  # [1/m] curvature at which a law with one icr_x is told it


@dataclass(frozen=True, slots=True)
class Known:
    """What a controller may know of its robot."""

    wheels: Wheels
    lag: float = 0.0  # [s] of the wheels
    delay: float = 0.0  # [s] of the poses
    period: float = 0.02  # [s] from command to command
    acceleration: float = math.inf  # [m/s^2] of the rims

    def icr_x(self, speed: float) -> float:
        """[m] ahead of the origin at a speed [m/s]."""
        return icr_x_at(self.wheels.model, min(speed, self.wheels.reachable(TYPICAL)), TYPICAL)


Law = Callable[[float, Known], Controller[Any]]  # of the speed asked for [m/s] and what is known


def _huskic(gains: huskic_law.HuskicGains, feed_forward: bool = False) -> Law:
    return lambda speed, known: Huskic(gains, SaturationSpeed(known.wheels, speed), known.icr_x(speed), feed_forward)


def _soetanto(gains: soetanto_law.SoetantoGains) -> Law:
    return lambda speed, known: Soetanto(gains, speed)


def _pentzer(feed_forward: bool) -> Law:
    gains = pentzer_law.GAINS["published"]
    return lambda speed, known: Pentzer(gains, speed, known.icr_x(speed), feed_forward)


def _pure_pursuit(preset: pursuit.PurePursuit) -> Law:
    return lambda speed, known: replace(preset, desired_linear_vel=speed, controller_frequency=1.0 / known.period)


def _predictive(speed: float, known: Known) -> Predictive:
    usual = Limits(speed)
    limits = replace(usual, rim_acceleration=min(usual.rim_acceleration, known.acceleration))
    model, observer = known.wheels.model, Observer(known.lag, known.delay)
    constant = model.constant if isinstance(model, ScheduledIcr) else model
    wheels = Wheels(constant, known.wheels.max_speed)
    return Predictive(PredictiveGains(), wheels, limits, observer, known.period, model)


LAWS: Mapping[str, Mapping[str, Law]] = {  # by name and gains; the first gains are those it is launched with
    "huskic": {
        "launch": _huskic(huskic_law.GAINS["launch"]),
        "header": _huskic(huskic_law.GAINS["header"]),
        "feed-forward": _huskic(huskic_law.GAINS["launch"], feed_forward=True),
    },
    "soetanto": {name: _soetanto(soetanto_law.GAINS[name]) for name in ("launch", "header")},
    "pentzer": {"published": _pentzer(feed_forward=False), "feed-forward": _pentzer(feed_forward=True)},
    "pure_pursuit": {name: _pure_pursuit(pursuit.PRESETS[name]) for name in ("nav2", "adaptive", "plain")},
    "predictive": {"usual": _predictive},
}


def controller(name: str, gains: str | None, speed: float, known: Known) -> Controller[Any]:
    """The controller of that name.

    Args:
        name: of ``LAWS``.
        gains: of that law; None: as it is launched.
        speed: [m/s] asked for.
        known: of the robot.

    Raises:
        RequestError: no such controller or gains, or a speed that is not above 0.
    """
    sets = named(name, "controller", LAWS)
    if gains is not None and gains not in sets:
        raise RequestError(f"no gains '{gains}' of {name}; there are: {', '.join(sets)}")
    if not 0.0 < speed < float("inf"):
        raise RequestError(
            f"the speed must be above 0 m/s, got {speed}; to drive backwards, follow the path in reverse"
        )
    return sets[gains or next(iter(sets))](speed, known)
