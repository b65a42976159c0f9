"""Properties of the ground, and grounds that differ from place to place or change with time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np

from skidsteer.errors import RequestError, named
from skidsteer.se2 import FloatArray


@dataclass(frozen=True, slots=True)
class Terrain:
    """Parameters of firm ground, Wang 2015, Table 1, after Yu 2010 and Wong 2001, and one of our own.

    ``lateral_shear_modulus`` stands for tyres that are softer sideways than lengthwise. Where it is above
    ``shear_modulus``, wide turns slip less than tight ones; the paper has a single modulus.

    Raises:
        RequestError: friction or shear modulus not above zero, or a negative rolling resistance.
    """

    name: str
    friction: float  # mu_sa: while left and right wheels turn the same way
    friction_opposite: float  # mu_op: while they turn opposite ways
    shear_modulus: float  # [m] K: sliding after which 63 % of the friction is reached
    rolling_resistance: float = 0.0  # share of the load that opposes the motion of a hub, Eq. (22)
    lateral_shear_modulus: float | None = None  # [m] across the wheel; None: the same
    source: str = ""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("name", "source") or value is None:
                continue
            least = 0.0 if field.name == "rolling_resistance" else math.ulp(0.0)
            if not least <= value < math.inf:
                need = "at least 0" if least == 0.0 else "above 0"
                raise RequestError(f"terrain {self.name}: {field.name} must be {need}, got {value}")

    def numbers(self) -> FloatArray:
        """Numbers (5,) in the order of `kernels.ground.drive`."""
        own = (self.friction, self.friction_opposite, self.shear_modulus, self.rolling_resistance)
        return np.array([*own, self.stiffness_ratio])

    @property
    def stiffness_ratio(self) -> float:
        """Shear modulus along over that across the wheel."""
        across = self.lateral_shear_modulus
        return 1.0 if across is None else self.shear_modulus / across


NOON = "friction: Noon 1994, Engineering Analysis of Vehicular Accidents; "
ASSUMED = "shear modulus and rolling resistance assumed"
TERRAINS: dict[str, Terrain] = {
    terrain.name: terrain
    for terrain in (
        Terrain("lab", 0.4437, 0.3093, 0.00054, 0.0371, None, "Wang 2015, Table 1: a tiled floor, numbers of Yu 2010"),
        Terrain("tiles", 0.4437, 0.3093, 0.00054, 0.0, 0.00125, "lab, with two numbers fitted to Wang 2015, Table 3"),
        Terrain("asphalt", 0.65, 0.65, 0.001, 0.04, None, f"{NOON}{ASSUMED}"),
        Terrain("concrete", 0.75, 0.75, 0.001, 0.03, None, f"{NOON}{ASSUMED}"),
        Terrain("grass", 0.45, 0.45, 0.003, 0.08, None, "all assumed; Noon 1994 has 0.2 for a wet, grassy field"),
        Terrain("gravel", 0.35, 0.35, 0.005, 0.06, None, f"{NOON}{ASSUMED}"),
        Terrain("wet-sand", 0.60, 0.60, 0.010, 0.10, None, "all assumed; Wong 2001 has K = 0.01 m for firm sand"),
        Terrain("ice", 0.10, 0.10, 0.001, 0.015, None, f"{NOON}{ASSUMED}"),
    )
}


def terrain(name: str) -> Terrain:
    """The terrain of that name.

    Raises:
        RequestError: no such terrain; the message lists those there are.
    """
    return named(name, "terrain", TERRAINS)


def parse_ground(text: str) -> Ground:
    """A ground from the words of a command line, such as ``grass``, ``grass,ice@12`` or ``grass,ice@2/-1/6/1``.

    Args:
        text: the first terrain, then each with the time [s] from which it lies everywhere, or with the place at which
            it always lies: two corners X0/Y0/X1/Y1 [m] of a rectangle in the frame of the drive. Where several lie at
            once, the last one counts.

    Raises:
        RequestError: no such terrain, a time that is no number or not later than the one before, or a place that has
            no area.
    """
    first, *later = [word.strip() for word in text.split(",")]
    try:
        areas = tuple(_area(*word.partition("@")[::2]) for word in later)
        times = [area.t[0] for area in areas if area.t != ALWAYS]
        if not all(a < b for a, b in pairwise(times)):
            raise ValueError
    except ValueError:
        raise RequestError(
            f"terrain '{text}': write NAME, then NAME@SECONDS for each later one, such as grass,ice@12, or"
            " NAME@X0/Y0/X1/Y1 for one at a place [m], such as grass,ice@2/-1/6/1"
        ) from None
    return Ground(terrain(first), areas)


def _area(name: str, where: str) -> Area:
    """The area of a terrain from a time on, or at a place; a ``ValueError`` if the text gives neither."""
    numbers = [float(word) for word in where.split("/")]
    if not all(map(math.isfinite, numbers)):
        raise ValueError
    if len(numbers) == 1:
        return Area(terrain(name), t=(numbers[0], math.inf))
    x0, y0, x1, y1 = numbers
    x, y = (min(x0, x1), max(x0, x1)), (min(y0, y1), max(y0, y1))
    if not (x[0] < x[1] and y[0] < y[1]):
        raise ValueError
    return Area(terrain(name), x, y)


Range = tuple[float, float]
ALWAYS: Range = (-math.inf, math.inf)


@dataclass(frozen=True, slots=True)
class Area:
    """A rectangle with another terrain, for a time; each range is half-open, without its upper end."""

    terrain: Terrain
    x: Range = ALWAYS  # [m] in the frame of the drive
    y: Range = ALWAYS  # [m]
    t: Range = ALWAYS  # [s]

    def __post_init__(self) -> None:
        for name in ("x", "y", "t"):
            low, high = getattr(self, name)
            if not low < high:
                raise RequestError(f"area of {self.terrain.name}: {name} must begin before it ends, got {low}, {high}")

    def words(self) -> str:
        """The area as text."""
        corners = [self.x[0], self.y[0], self.x[1], self.y[1]]
        if (self.x, self.y) != (ALWAYS, ALWAYS):
            return f"{self.terrain.name}@{'/'.join(f'{corner:g}' for corner in corners)}"
        return f"{self.terrain.name}@{self.t[0]:g}" if self.t[0] > -math.inf else self.terrain.name


@dataclass(frozen=True, slots=True)
class Ground:
    """A terrain everywhere, and areas over it; where several overlap, the last one counts."""

    everywhere: Terrain
    areas: Sequence[Area] = ()

    def words(self) -> str:
        """The ground as text, as ``parse_ground`` reads it; of an area bounded in place and in time only the place."""
        return ",".join([self.everywhere.name, *(area.words() for area in self.areas)])

    def bounds(self) -> FloatArray:
        """From and to in t, x and y (k, 6) of every area, the first of which is everywhere."""
        limits = [[*area.t, *area.x, *area.y] for area in (Area(self.everywhere), *self.areas)]
        return np.array(limits)

    def numbers(self) -> FloatArray:
        """The numbers of their terrains (k, 5)."""
        return np.array([self.everywhere.numbers(), *(area.terrain.numbers() for area in self.areas)])
