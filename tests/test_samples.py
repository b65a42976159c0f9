"""The samples that the forces of a ground made; the others are tested where their truth is."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from skidsteer.doctor import examine
from skidsteer.drive import Drive, Series
from skidsteer.samples import COM_AHEAD, GROUND_SENSORS, SAMPLES, sample
from skidsteer.simulate import controller
from skidsteer.terramechanics.robot import robot
from skidsteer.terramechanics.steady_turn import steady_turn
from skidsteer.terramechanics.terrain import terrain

ON_GROUND = {"p3at-tiles": 0.3, "warthog-grass": 0.5, "jackal-asphalt": 0.3, "jackal-grass": 0.3}  # a speed [m/s]


@pytest.fixture(scope="module", params=list(ON_GROUND))
def drive(request: pytest.FixtureRequest) -> Drive:
    return sample(request.param)


def gyro_of(drive: Drive) -> Series:
    assert drive.gyro is not None
    return drive.gyro


def test_a_sample_is_itself_and_clean(drive: Drive) -> None:
    assert drive.name in ON_GROUND
    assert drive.source.startswith("simulated")
    assert 120.0 < drive.span[1] - drive.span[0] < 150.0
    assert examine(drive) == ()
    text = SAMPLES[drive.name].text
    assert "simulated" in text or text.startswith("the same commands")


def test_arcs_are_the_steady_turns_of_their_ground(drive: Drive) -> None:
    """The gyro's mean while a robot keeps turning, its bias taken off."""
    vehicle, ground = drive.vehicle, drive.name.partition("-")[2]
    made = robot(vehicle, com_x=COM_AHEAD)
    assert drive.wheel_command is not None
    rate = {"p3at": 0.3, "warthog": 0.3, "jackal": 0.4}[drive.name.partition("-")[0]]
    rims = controller(vehicle).wheel_speeds(ON_GROUND[drive.name], rate)
    kept = np.isclose(drive.wheel_command.values, rims, atol=1e-9).all(axis=1)
    start = drive.wheel_command.t[np.flatnonzero(np.convolve(kept, np.ones(400), "valid") > 399.5)[0]]  # 4 s at 100 Hz
    gyro = gyro_of(drive).between(start + 1.0, start + 3.9)
    assert gyro is not None
    expected = steady_turn(made, terrain(ground), *rims).twist[2]
    noise = GROUND_SENSORS.gyro_sigma / np.sqrt(len(gyro))
    assert gyro.values.mean() - GROUND_SENSORS.gyro_bias == pytest.approx(expected, abs=4.0 * noise + 0.002 * expected)


def test_a_sample_is_the_same_every_time() -> None:
    first, again = sample("jackal-grass"), sample("jackal-grass")
    for a, b in ((first.wheels, again.wheels), (gyro_of(first), gyro_of(again)), (first.pose, again.pose)):
        assert a is not None
        assert b is not None
        assert_array_equal(a.values, b.values)


def test_the_two_grounds_of_the_jackal_differ_in_nothing_else() -> None:
    asphalt, grass = sample("jackal-asphalt"), sample("jackal-grass")
    assert asphalt.wheel_command is not None
    assert grass.wheel_command is not None
    assert_array_equal(asphalt.wheel_command.values, grass.wheel_command.values)
    assert asphalt.vehicle == grass.vehicle
    turned = [np.abs(gyro_of(drive).values - GROUND_SENSORS.gyro_bias).mean() for drive in (asphalt, grass)]
    assert abs(turned[1] / turned[0] - 1.0) > 0.02
