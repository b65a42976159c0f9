"""Round a rectangular obstacle on two straights and two half circles: Giannoccaro 2015, section V, with any model.

The frame is that of the robot at its start, at the beginning of the first straight. The obstacle is placed where the
expected course is symmetric about it: half a lap is a rotation by half a turn about a point, the obstacle's centre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.stats import f as fisher
from scipy.stats import t as student

from skidsteer.drive import Series
from skidsteer.errors import RequestError
from skidsteer.plan.driver import Driver
from skidsteer.plan.outline import Rectangle, footprint, gap, gap_slope
from skidsteer.plan.slip_table import SlipTable
from skidsteer.plan.stretches import REST, Stretch, commands, poses_of, stretch
from skidsteer.prediction import Forecast, forecast
from skidsteer.se2 import FloatArray, compose, rotate
from skidsteer.simulate import controller

SURE = 0.95
SPACING = 0.1  # [s] between the poses that are checked, at most
TRIES = 20  # of radii
CLOSE = 1e-4  # [m] tolerance of the clearance
MOST_LAPS = 100
LONGEST = 3600.0  # [s] of a plan


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be driven.

    Raises:
        RequestError: an impossible number.
    """

    obstacle: Rectangle  # the straights run along its longer side
    clearance: float  # [m] between the outline of the robot and the obstacle
    speed: float  # [m/s] on the straights
    curve_speed: float | None = None  # [m/s] on the arcs; None: the same
    radius: float | None = None  # [m] of the arcs; None: the least that keeps the clearance
    side: str = "left"  # to which the robot turns; the obstacle lies on it
    laps: int = 1

    def __post_init__(self) -> None:
        numbers = {
            "--clearance": self.clearance,
            "--speed": self.speed,
            "--curve-speed": self.curve_speed,
            "--radius": self.radius,
        }
        for name, value in numbers.items():
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise RequestError(f"{name} must be above 0, got {value:g}")
        if self.side not in ("left", "right"):
            raise RequestError(f"--direction must be left or right, got '{self.side}'")
        if not 1 <= self.laps <= MOST_LAPS:
            raise RequestError(f"--laps must be from 1 to {MOST_LAPS}, got {self.laps}")

    @property
    def straight(self) -> float:
        """Length [m] of the straights."""
        return max(self.obstacle.length, self.obstacle.width)

    @property
    def breadth(self) -> float:
        """Width [m] of the obstacle across them."""
        return min(self.obstacle.length, self.obstacle.width)


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A course round an obstacle, and its forecast."""

    driver: Driver
    request: Request
    robot: Rectangle
    stretches: tuple[Stretch, ...]  # of all laps
    place: FloatArray  # pose (3,) of the obstacle, its x along the straights
    expected: Forecast = field(repr=False)

    @property
    def obstacle(self) -> Rectangle:
        """Its longer side along the straights."""
        return Rectangle(self.request.straight, self.request.breadth, "obstacle")

    @property
    def radius(self) -> float:
        """[m] of the arcs as requested."""
        arc = self.stretches[1]
        return abs(arc.v / arc.omega)

    @property
    def rims(self) -> Series:
        """Rim speeds (n, 2) [m/s] to command."""
        return commands(self.stretches)

    @property
    def commands(self) -> Series:
        """Speeds v [m/s] and omega [rad/s] (n, 2) for which the robot's own controller commands these rim speeds."""
        rims = self.rims
        return Series(rims.t, controller(self.driver.vehicle).twist(*rims.values.T)[:, [0, 2]], "commands")

    @property
    def starts(self) -> FloatArray:
        """When each stretch begins (n,) [s]."""
        return REST + np.cumsum([0.0, *(s.duration for s in self.stretches)])[:-1]

    @property
    def gaps(self) -> FloatArray:
        """Expected distance (n,) [m] between outline and obstacle, at each expected pose."""
        return gap(self.robot, self.expected.path.values, self.obstacle, self.place)

    @property
    def sure_gap(self) -> float:
        """Distance [m] that is kept with probability ``SURE`` at the pose where that is least."""
        return float((self.gaps - self._margin(self.expected.covariances)).min())

    def _margin(self, covariances: FloatArray) -> FloatArray:
        """By how much (n,) [m] the outline may come nearer."""
        slope = gap_slope(self.robot, self.expected.path.values, self.obstacle, self.place)
        variance = self.driver.regions.scale * np.einsum("ni,nij,nj->n", slope, covariances, slope)
        return np.asarray(np.sqrt(variance) * student.ppf(SURE, self.driver.regions.dof))

    @property
    def end(self) -> FloatArray:
        """Expected end pose (3,), lag and rounding included; yaw unwrapped."""
        return np.array(self.expected.path.values[-1])

    @property
    def end_sigmas(self) -> FloatArray:
        """Standard deviations (3,) of the end: ahead and to the left [m], in the end's own frame, and yaw [rad]."""
        return np.sqrt(self.driver.regions.scale * np.diag(self.expected.covariances[-1]))

    @property
    def end_ellipse(self) -> FloatArray:
        """Points (n, 2) [m] on the border of the region that holds ``SURE`` of all ends."""
        regions = self.driver.regions
        reach = math.sqrt(2.0 * regions.scale * fisher.ppf(SURE, 2, regions.dof))
        angle = np.linspace(0.0, 2.0 * np.pi, 73)
        circle = np.column_stack([np.cos(angle), np.sin(angle)])
        root = np.linalg.cholesky(self.expected.covariances[-1][:2, :2] + 1e-18 * np.eye(2))
        return np.asarray(self.end[:2] + rotate(self.end[2], reach * circle @ root.T))

    @property
    def misses(self) -> FloatArray:
        """By how much (3,) the rounded commands miss the start at the end, without lag: ahead, left [m], yaw [rad].

        0 without rounding, unless the model does not drive straight.
        """
        turned = 2.0 * np.pi * self.request.laps * (1.0 if self.request.side == "left" else -1.0)
        return np.asarray(poses_of(self.stretches)[-1] - [0.0, 0.0, turned])

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings for the user."""
        keeps = self.sure_gap
        notes = []
        if keeps <= 0.0:
            notes.append(
                f"1 robot in {round(1.0 / (1.0 - SURE))} may touch the obstacle: the uncertainty takes all of the"
                " clearance; give more of it, drive fewer laps, or calibrate better"
            )
        if isinstance(self.driver.model, SlipTable):
            notes.append("circle runs tell neither lag nor noise: what is said of the uncertainty is assumed")
        return tuple(notes)


def circumnavigate(driver: Driver, request: Request, robot: Rectangle | None = None) -> Plan:
    """Plan a course round an obstacle.

    Args:
        driver: the robot and its model.
        request: what is to be driven.
        robot: its outline; None: the outer edges of its wheels.

    Raises:
        RequestError: a radius that does not keep the clearance, speeds or arcs that the robot cannot drive, or a
            calibration that leaves too much open to keep clear at all.
    """
    robot = robot or footprint(driver.vehicle)
    plan_at = partial(_plan, driver, request, robot)
    if request.radius is not None:
        plan = plan_at(request.radius)
        if (left := float(plan.gaps.min())) < request.clearance - CLOSE:
            raise RequestError(
                f"arcs of {request.radius:g} m leave {max(left, 0.0):.3f} m between the outline of {robot.length:g} x"
                f" {robot.width:g} m and the obstacle, and --clearance asks for {request.clearance:g} m; give a"
                f" --radius of at least {math.ceil(100.0 * (request.radius + request.clearance - left)) / 100.0:g} m"
            )
    else:
        plan = _narrowest(plan_at, request, robot)
    _refuse_open(plan)
    return plan


def _narrowest(plan_at: partial[Plan], request: Request, robot: Rectangle) -> Plan:
    """The plan with the least radius that keeps the clearance, to ``CLOSE`` or to what integers allow."""
    radius = 0.5 * (request.breadth + robot.width) + request.clearance
    for _ in range(TRIES):
        plan = plan_at(radius)
        short = request.clearance - float(plan.gaps.min())
        if short <= CLOSE:
            return plan
        radius += max(short, CLOSE)
    raise RequestError(f"no radius up to {radius:.2f} m keeps {request.clearance:g} m off the obstacle; give --radius")


def _plan(driver: Driver, request: Request, robot: Rectangle, radius: float) -> Plan:
    make = partial(stretch, model=driver.model, vehicle=driver.vehicle, encoding=driver.encoding)
    turn = 1.0 if request.side == "left" else -1.0
    v = request.curve_speed or request.speed
    straight = make("straight", v=request.speed, omega=0.0, amount=request.straight)
    arc = make("arc", v=v, omega=turn * v / radius, amount=np.pi)
    lap = [replace(s, name=n) for s, n in zip((straight, arc, straight, arc), ("AB", "BC", "CD", "DA"), strict=True)]
    stretches = tuple(lap) * request.laps
    if (lasts := sum(s.duration for s in stretches)) > LONGEST:
        raise RequestError(
            f"the course would take {lasts:.3g} s; drive faster, or fewer --laps (at most {LONGEST:g} s)"
        )
    rims = commands(stretches)
    t = np.linspace(0.0, rims.t[-1], math.ceil(rims.t[-1] / SPACING) + 1)
    expected = forecast(driver.model, rims, t, driver.lag, driver.uncertainty, driver.regions.turning)
    return Plan(driver, request, robot, stretches, _place(straight, arc), expected)


def _place(straight: Stretch, arc: Stretch) -> FloatArray:
    """Pose (3,) of the centre of symmetry of the course, as if its straights were straight."""
    along = float(np.arctan2(straight.twist[1], straight.twist[0]))
    ahead = straight.amount * np.array([np.cos(along), np.sin(along), 0.0])
    half = compose(ahead, arc.motion)
    return np.array([0.5 * half[0], 0.5 * half[1], along])


def _refuse_open(plan: Plan) -> None:
    """Refuse a calibration whose undetermined parameters alone use up the clearance."""
    if plan.driver.open and (plan.gaps - plan._margin(plan.expected.of_parameters)).min() <= 0.0:
        raise RequestError(
            f"the calibration does not determine {', '.join(plan.driver.open)}: by that alone the robot may run into"
            " the obstacle; calibrate from a drive with straights and turns both ways, or from circles like these arcs"
        )
