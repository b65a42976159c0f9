import math

import pytest
from numpy import float32, int64

from skidsteer.errors import RequestError
from skidsteer.vehicle import PRESETS, Vehicle, preset

NUMBERS = (
    "track_width",
    "wheel_radius",
    "wheels",
    "wheel_base",
    "mass",
    "ticks_per_revolution",
    "max_wheel_speed",
    "factory_separation",
    "factory_multiplier",
)


def vehicle(**changes: object) -> Vehicle:
    return Vehicle(**{"name": "mine", "track_width": 0.5, "wheel_radius": 0.1} | changes)


@pytest.mark.parametrize("field", NUMBERS)
@pytest.mark.parametrize("value", [0, -0.1, math.nan, math.inf, "0.5", True])
def test_refuses_what_is_no_positive_number(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"vehicle {field} must be a positive number, got {value}"):
        vehicle(**{field: value})


def test_takes_numpy_numbers_and_unknown_fields() -> None:
    assert vehicle(track_width=float32(0.5), wheels=int64(6)).wheels == 6
    assert vehicle().mass is None


def test_refuses_one_wheel() -> None:
    with pytest.raises(ValueError, match="vehicle wheels must be at least 2, got 1"):
        vehicle(wheels=1)


def test_presets_are_those_the_documentation_names() -> None:
    names = "husky-a200 jackal panther pioneer-p3at rover-4wd1 scout-2.0 summit-xl warthog"
    assert sorted(PRESETS) == names.split()


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_preset_has_credible_measures(name: str) -> None:
    robot = preset(name)
    assert robot.name == name
    assert robot.source
    assert robot.wheels == 4
    assert 0.05 < robot.wheel_radius < 0.35
    assert 2 * robot.wheel_radius < robot.track_width < 1.2
    if robot.wheel_base is not None:
        # neighbouring wheels must not touch
        assert 2 * robot.wheel_radius < robot.wheel_base < 1.5
    if robot.mass is not None:
        assert 5 < robot.mass < 300
    if robot.max_wheel_speed is not None:
        assert 0.5 < robot.max_wheel_speed <= 5


@pytest.mark.parametrize("name", ["pioneer-p3at", "husky-a200", "jackal", "warthog", "panther"])
def test_factory_setting_is_wider_than_the_track(name: str) -> None:
    robot = preset(name)
    assert robot.factory_separation is not None
    assert robot.factory_multiplier is not None
    # the slip of a skid-steer turn: 1.3 to 2 times the track
    assert 1.3 < robot.factory_separation * robot.factory_multiplier / robot.track_width < 2.0


def test_encoder_presets_follow_from_their_sources() -> None:
    husky, panther = preset("husky-a200"), preset("panther")
    assert husky.ticks_per_revolution == pytest.approx(78_000 * 2 * math.pi * husky.wheel_radius, rel=1e-5)
    assert panther.ticks_per_revolution == pytest.approx(1600 * 30.08)


def test_fastest_wheel_of_the_pioneer_turns_once_a_second() -> None:
    pioneer = preset("pioneer-p3at")
    assert pioneer.max_wheel_speed == pytest.approx(2 * math.pi * pioneer.wheel_radius, abs=0.005)


@pytest.mark.parametrize("name", ["clearpath-husky-a200", "Husky-A200", "husky-a200"])
def test_preset_is_found_by_the_makers_name(name: str) -> None:
    assert preset(name) is PRESETS["husky-a200"]


def test_unknown_preset_lists_those_there_are() -> None:
    with pytest.raises(RequestError, match=r"no vehicle preset 'husky'; there are: husky-a200, jackal, .*warthog, or"):
        preset("husky")
