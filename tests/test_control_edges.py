"""What holds for every controller."""

import math
from dataclasses import replace

import numpy as np
import pytest

from control_loop import PLANT, TURNED, follow
from skidsteer.control import (
    Controller,
    Huskic,
    PathState,
    Pentzer,
    PurePursuit,
    SaturationSpeed,
    Soetanto,
    Wheels,
    huskic,
    path_error,
    pentzer,
    soetanto,
)
from skidsteer.errors import DataError
from skidsteer.models import Icr
from skidsteer.paths import arc, clothoid, lemniscate, line
from skidsteer.se2 import compose

CURVE = clothoid(6.0, -0.5, 0.6, (1.0, -2.0, 0.7))
WHEELS = Wheels(PLANT, 1.2)
STILL, ASKED = np.zeros(3), (0.9, 0.3)


def controllers(wheels: Wheels, icr_x: float) -> dict[str, Controller[PathState]]:
    speed = SaturationSpeed(wheels)
    return {
        "huskic": Huskic(huskic.GAINS["launch"], speed, icr_x),
        "huskic, fed forward": Huskic(huskic.GAINS["header"], speed, icr_x, feed_forward=True),
        "huskic, measured": Huskic(huskic.GAINS["header"], speed, icr_x, measured_omega=True),
        "soetanto": Soetanto(soetanto.GAINS["launch"], 1.0),
        "pentzer": Pentzer(pentzer.GAINS["published"], 1.0, icr_x),
        "pentzer, fed forward": Pentzer(pentzer.GAINS["published"], 1.0, icr_x, feed_forward=True),
        "pure pursuit": PurePursuit(),
    }


ALL = controllers(WHEELS, PLANT.icr_x)
ANY = pytest.mark.parametrize("controller", ALL.values(), ids=ALL)


@ANY
@pytest.mark.parametrize("bad", [(math.nan, 0.0, 0.0), (0.0, 0.0, math.inf), (0.0, 0.0)])
def test_what_is_not_known_is_refused(controller: Controller[PathState], bad: tuple[float, ...]) -> None:
    state, pose = PathState(CURVE, 3.0), CURVE.at(3.0)
    with pytest.raises(DataError, match=r"the pose is .* three finite numbers; stop until it is known again"):
        controller.command(bad, STILL, state)
    with pytest.raises(DataError, match=r"the twist is .* three finite numbers"):
        controller.command(pose, bad, state)
    with pytest.raises(DataError, match="the pose is"):
        controller.advance(state, bad, STILL, 0.02, ASKED)
    with pytest.raises(DataError, match="the twist is"):
        controller.advance(state, pose, bad, 0.02, ASKED)
    with pytest.raises(DataError, match="the pose is"):
        controller.begin(CURVE, bad)


@ANY
def test_no_time_changes_nothing_and_time_does_not_go_back(controller: Controller[PathState]) -> None:
    state, pose = PathState(CURVE, 3.0), compose(CURVE.at(3.0), (0.2, 0.1, 0.1))
    assert controller.advance(state, pose, STILL, 0.0, ASKED) is state
    assert 3.0 < controller.advance(state, pose, STILL, 0.02, ASKED).s < 3.3
    for dt in (-0.02, math.nan):
        with pytest.raises(DataError, match="the time step is"):
            controller.advance(state, pose, STILL, dt, ASKED)


@ANY
def test_driving_is_the_same_in_reverse(controller: Controller[PathState]) -> None:
    """The same robot with its rear taken for its front drives the same curve ahead."""
    name = next(n for n, c in ALL.items() if c is controller)
    other = controllers(Wheels(TURNED, 1.2), -PLANT.icr_x)[name]
    for seed in range(20):
        rng = np.random.default_rng(seed)
        s, error = rng.uniform(0.5, 5.0), rng.uniform([-0.2, -0.5, -3.0], [0.2, 0.5, 3.0])
        pose, v_x, omega = compose(CURVE.at(s), error), *rng.uniform(-1.0, 1.0, 2)
        ahead = other.command(pose, (v_x, 0.0, omega), PathState(CURVE, s))
        turned, back = pose + [0.0, 0.0, math.pi], PathState(CURVE.in_reverse(), s)
        assert controller.command(turned, (-v_x, 0.0, omega), back) == pytest.approx((-ahead[0], ahead[1]), abs=1e-9)
        s_ahead = other.advance(PathState(CURVE, s), pose, (v_x, 0.0, omega), 0.02, ASKED).s
        assert controller.advance(back, turned, (-v_x, 0.0, omega), 0.02, ASKED).s == pytest.approx(s_ahead, abs=1e-9)


@ANY
def test_left_is_the_mirror_of_right(controller: Controller[PathState]) -> None:
    name = next(n for n, c in ALL.items() if c is controller)
    mirrored = Icr(-PLANT.icr_y_right, -PLANT.icr_y_left, PLANT.icr_x, PLANT.alpha_right, PLANT.alpha_left)
    other = controllers(Wheels(mirrored, 1.2), PLANT.icr_x)[name]
    flip, curve = np.array([1.0, -1.0, -1.0]), clothoid(6.0, 0.5, -0.6, (1.0, 2.0, -0.7))
    for seed in range(20):
        rng = np.random.default_rng(seed)
        s, error = rng.uniform(0.5, 5.0), rng.uniform([-0.2, -0.5, -3.0], [0.2, 0.5, 3.0])
        pose, twist = compose(CURVE.at(s), error), rng.uniform(-1.0, 1.0, 3)
        v, omega = controller.command(pose, twist, PathState(CURVE, s))
        mirror = other.command(pose * flip, twist * flip, PathState(curve, s))
        assert mirror == pytest.approx((v, -omega), abs=1e-9)


@ANY
@pytest.mark.parametrize("reverse", [False, True])
def test_it_drives_to_the_end_and_stops_within_the_wheels_limits(
    controller: Controller[PathState], reverse: bool
) -> None:
    path = clothoid(3.0, 0.0, 0.2)
    path = path.in_reverse() if reverse else path
    run = follow(controller, WHEELS, path, path.robot(0.0) + [0.0, 0.1, 0.1], 22.0)
    assert np.abs(run.rims).max() <= 1.2
    assert not run.twists[-1].any()
    assert run.s[-1] == pytest.approx(2.75 if isinstance(controller, PurePursuit) else 3.0, abs=0.03)
    assert np.hypot(*(run.poses[-1] - path.end)[:2]) < (0.35 if isinstance(controller, PurePursuit) else 0.2)
    assert np.all(run.twists[:-1, 0] * (-1.0 if reverse else 1.0) >= 0.0)


@ANY
def test_no_sample_of_a_wild_drive_exceeds_the_wheels(controller: Controller[PathState]) -> None:
    """From 3 m off, facing back, with a leap of the pose by 0.886 m, along the lemniscate."""
    path, slow = lemniscate(6.0), Wheels(PLANT, 0.8)
    run = follow(controller, slow, path, (1.0, 3.0, 3.0), 6.0)
    again = follow(controller, slow, path, run.poses[-1] + [0.886, 0.0, 0.0], 6.0)
    for rims in (run.rims, again.rims):
        assert np.isfinite(rims).all()
        assert np.abs(rims).max() <= 0.8
    assert np.abs(run.rims).max() > 0.4


@ANY
def test_a_path_sharper_than_the_icr_allows_gets_a_command(controller: Controller[PathState]) -> None:
    """icr_x c = 1.4: no heading keeps the origin on it."""
    tight = arc(0.2, 3.0)
    command = controller.command(tight.at(0.1), STILL, PathState(tight, 0.1))
    assert np.isfinite(command).all()


def test_the_error_is_that_of_the_path() -> None:
    for path in (CURVE, CURVE.in_reverse()):
        for seed in range(10):
            s, *pose = np.random.default_rng(seed).uniform([0.0, -3.0, -3.0, -9.0], [6.0, 3.0, 3.0, 9.0])
            error = path_error(PathState(path, s), pose)
            np.testing.assert_allclose(error[:3], path.error(pose, s), atol=1e-12)
            assert error.curvature == path.curvature(s)
            assert error.slope == pytest.approx(1.1 / 6.0)


def test_where_a_path_ends() -> None:
    assert PathState(line(3.0), 2.0).remaining == 1.0
    assert PathState(line(3.0), 3.0).arrived
    assert PathState(lemniscate(3.0), 99.0).remaining == math.inf
    assert PathState.begin(line(3.0), (1.0, 2.0, 0.5)).s == pytest.approx(1.0)


def test_options_are_refused_before_the_drive() -> None:
    with pytest.raises(ValueError, match="need deceleration > 0"):
        replace(ALL["huskic"], deceleration=0.0)
    with pytest.raises(ValueError, match="need lam > 0"):
        replace(huskic.GAINS["header"], lam=math.nan)


def test_where_a_path_crosses_itself_it_begins_on_the_branch_it_heads_along() -> None:
    eight = lemniscate(8.0)
    for s in (0.0, 0.5 * eight.length, eight.length):
        for aside in (-0.03, 0.03):
            began = PathState.begin(eight, compose(eight.at(s), (0.02, aside, 0.1))).s
            assert math.cos((began - s) * 2.0 * math.pi / eight.length) > 0.999
    turned = compose(line(4.0).at(1.0), (0.0, 0.5, 3.0))
    assert PathState.begin(line(4.0), turned).s == pytest.approx(1.0)  # however it faces
    back = lemniscate(8.0).in_reverse()
    assert PathState.begin(back, back.robot(3.0)).s == pytest.approx(3.0)
