"""The controllers of the path-following study: published gains, what is tuned, and how each is built from numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from skidsteer.control import (
    Controller,
    Huskic,
    HuskicGains,
    Pentzer,
    PentzerGains,
    SaturationSpeed,
    Soetanto,
    SoetantoGains,
    Wheels,
    icr_x_at,
)
from skidsteer.control.huskic import GAINS as HUSKIC
from skidsteer.control.observer import Observer
from skidsteer.control.pentzer import GAINS as PENTZER
from skidsteer.control.predictive import Predictive, PredictiveGains
from skidsteer.control.profile import Limits
from skidsteer.control.pure_pursuit import PRESETS
from skidsteer.control.soetanto import GAINS as SOETANTO
from skidsteer.models import Icr, Model, ScheduledIcr

STEEPEST = 1.2  # [rad] of theta_a, whatever the search asks for
TYPICAL = 0.5  # [1/m] curvature at which a law with one icr_x is told it


@dataclass(frozen=True, slots=True)
class Known:
    """What every controller may know of the robot."""

    model: Model
    max_speed: float  # [m/s] of the rims
    acceleration: float  # [m/s^2] of the rims
    lag: float  # [s]
    delay: float  # [s]

    @property
    def constant(self) -> Model:
        """The model, or the constant ICRs of a scheduled one."""
        return self.model.constant if isinstance(self.model, ScheduledIcr) else self.model

    def icr_x(self, speed: float) -> float:
        """[m] at a speed [m/s]."""
        return self.model.icr_x if isinstance(self.model, Icr) else icr_x_at(self.model, speed, TYPICAL)


Build = Callable[[Mapping[str, float], float, Known], "Controller"]


@dataclass(frozen=True, slots=True)
class Law:
    """A controller: its published sets of gains, and the set from which tuning begins."""

    build: Build  # from gains, the speed asked for [m/s] and what is known
    published: dict[str, dict[str, float]]
    begin: dict[str, float]  # every gain here is tuned, in its logarithm
    constant: bool = False  # its wheels take the constant ICRs of a scheduled model

    def gains(self, name: str) -> tuple[tuple[str, float], ...]:
        return tuple(self.published[name].items())


def _huskic(feed_forward: bool, measured: bool = False) -> Build:
    def build(g: Mapping[str, float], speed: float, known: Known) -> Controller:
        gains = HuskicGains(g["k1"], g["k2"], g["lam"], min(g["theta_a"], STEEPEST))
        drive = SaturationSpeed(Wheels(known.model, known.max_speed), speed)
        return Huskic(gains, drive, known.icr_x(speed), feed_forward, measured, g["approach_length"])

    return build


def _soetanto(g: Mapping[str, float], speed: float, known: Known) -> Controller:
    gains = SoetantoGains(g["k1"], g["k2"], g["gamma"], g.get("b", 0.0), min(g["theta_a"], STEEPEST))
    return Soetanto(gains, speed, approach_length=g["approach_length"])


def _pentzer(feed_forward: bool) -> Build:
    def build(g: Mapping[str, float], speed: float, known: Known) -> Controller:
        return Pentzer(PentzerGains(g["k1"], g["k2"]), speed, known.icr_x(speed), feed_forward)

    return build


def _pursuit(g: Mapping[str, float], speed: float, known: Known) -> Controller:
    near = g["min_lookahead_dist"]
    return replace(
        PRESETS["adaptive"],
        desired_linear_vel=speed,
        lookahead_time=g["lookahead_time"],
        min_lookahead_dist=near,
        max_lookahead_dist=near + g["lookahead_span"],
    )


def _ours(g: Mapping[str, float], speed: float, known: Known) -> Controller:
    gains = PredictiveGains(g["reach"], g["effort"], g["agility"], min(g["theta_a"], STEEPEST))
    limits = Limits(speed, rim_acceleration=known.acceleration)
    observer = Observer(known.lag, known.delay)
    return Predictive(gains, Wheels(known.constant, known.max_speed), limits, observer, scheduled=known.model)


APPROACH = {"theta_a": math.pi / 4.0, "approach_length": 1.0}


def _of(gains: HuskicGains | SoetantoGains | PentzerGains, *names: str) -> dict[str, float]:
    return {name: getattr(gains, name) for name in names}


LYAPUNOV = {name: _of(HUSKIC[name], "k1", "k2", "lam") | APPROACH for name in ("launch", "header")}
SLPINL = {name: _of(SOETANTO[name], "k1", "k2", "gamma", "b") | APPROACH for name in ("launch", "header")}
PBR = {"launch": _of(PENTZER["published"], "k1", "k2")}
NAV2 = PRESETS["adaptive"]
LOOKAHEAD = {
    "lookahead_time": NAV2.lookahead_time,
    "min_lookahead_dist": NAV2.min_lookahead_dist,
    "lookahead_span": NAV2.max_lookahead_dist - NAV2.min_lookahead_dist,
}
OURS = {name: getattr(PredictiveGains(), name) for name in ("reach", "effort", "agility", "theta_a")}
UNBRAKED = {key: value for key, value in SLPINL["launch"].items() if key != "b"}

LAWS: dict[str, Law] = {
    "huskic": Law(_huskic(False), LYAPUNOV, LYAPUNOV["launch"]),
    "huskic measured": Law(_huskic(False, True), LYAPUNOV, LYAPUNOV["launch"]),
    "huskic ff": Law(_huskic(True), LYAPUNOV, LYAPUNOV["launch"]),
    "slpinl": Law(_soetanto, SLPINL, UNBRAKED),
    "pbr": Law(_pentzer(False), PBR, PBR["launch"]),
    "pbr ff": Law(_pentzer(True), PBR, PBR["launch"]),
    "pure pursuit": Law(_pursuit, {"launch": LOOKAHEAD}, LOOKAHEAD),
    "ours": Law(_ours, {"launch": OURS}, OURS, constant=True),
}
NAMES = {
    "huskic": "Huskić",
    "huskic ff": "Huskić + feed-forward",
    "slpinl": "SLPINL",
    "pbr": "PBR",
    "pbr ff": "PBR + feed-forward",
    "pure pursuit": "regulated pure pursuit",
    "ours": "ours (predictive)",
}
