import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from skidsteer import cli
from skidsteer.drive import Drive, Series
from skidsteer.errors import DataError, RequestError
from skidsteer.io.commands import parse_manoeuvres, read_commands
from skidsteer.io.drives import load_drive
from skidsteer.plants import PLANTS, plant, usual_sensors
from skidsteer.simulate import Sensors, controller, refuse_fast
from skidsteer.terramechanics.dynamics import move
from skidsteer.terramechanics.robot import robot
from skidsteer.terramechanics.steady_turn import steady_turn
from skidsteer.terramechanics.terrain import TERRAINS, Area, Ground, parse_ground
from skidsteer.vehicle import Vehicle, preset

P3AT = preset("pioneer-p3at")
LAB = Ground(TERRAINS["lab"])
TURN = "3,0.3,0.4:2,0,0"


def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *words: str) -> str:
    """What the command line says on an error, or on success."""
    monkeypatch.setattr(sys, "argv", ["skidsteer", "simulate", *words])
    with pytest.raises(SystemExit) as left:
        cli.main()
    captured = capsys.readouterr()
    return captured.out if left.value.code in (0, None) else captured.err


def poses(drive: Drive) -> Series:
    assert drive.pose is not None
    return drive.pose


# Plants


@pytest.mark.parametrize("name", list(PLANTS))
def test_every_plant_turns_left_and_says_what_it_was_asked(name: str) -> None:
    if name == "mujoco":
        pytest.importorskip("mujoco")
    commands = parse_manoeuvres(TURN, P3AT)
    drive = plant(name)("d", P3AT, LAB, commands, usual_sensors(P3AT), 1)
    assert drive.wheel_command is commands
    assert drive.gyro is not None
    assert 0.3 < poses(drive).values[-1, 2] < 1.5
    assert 0.3 < poses(drive).values[-1, 0] < 0.9
    with pytest.raises(RequestError, match=r"asked for 0.800 m/s at 0.00 s, but pioneer-p3at reaches 0.69"):
        plant(name)("d", P3AT, LAB, Series(np.arange(2.0), np.full((2, 2), 0.8)), Sensors(), 0)


def test_the_terramechanic_plant_is_the_dynamics_on_its_ground() -> None:
    commands = parse_manoeuvres(TURN, P3AT)
    quiet = Sensors(position_sigma=0.0, yaw_sigma=0.0)
    for name in ("lab", "ice"):
        drive = plant("terramechanic")("d", P3AT, Ground(TERRAINS[name]), commands, quiet, 0)
        motion = move(robot(P3AT), TERRAINS[name], commands)
        assert_allclose(poses(drive).values, motion.pose_at(poses(drive).t))


def test_the_kinematic_plant_turns_as_point_contacts_would() -> None:
    commands = Series(np.array([0.0, 4.0]), np.array([[-0.2, 0.3]] * 2))
    quiet = Sensors(position_sigma=0.0, yaw_sigma=0.0)
    pose = poses(plant("kinematic")("d", P3AT, LAB, commands, quiet, 0))
    rate = np.diff(pose.values[-2:, 2])[0] / np.diff(pose.t[-2:])[0]
    assert rate == pytest.approx(0.5 / (0.4 * (1.0 + (0.27 / 0.4) ** 2)))


def test_an_unknown_plant_lists_those_there_are() -> None:
    with pytest.raises(RequestError, match=r"^no plant 'gazebo'; there are: kinematic, terramechanic, mujoco$"):
        plant("gazebo")


def test_sensors_count_as_the_vehicle_does() -> None:
    husky = preset("husky-a200")
    assert usual_sensors(husky).encoder_step == pytest.approx(2.0 * np.pi * 0.1651 / 80_913.0)
    assert usual_sensors(P3AT).encoder_step == 0.0


# Commands


def test_the_controller_uses_the_factory_width() -> None:
    assert_allclose(controller(P3AT).wheel_speeds(0.3, 0.5), [0.3 - 0.5 * 0.3, 0.3 + 0.5 * 0.3])
    assert controller(Vehicle("v", 0.5, 0.1)).track_width == 0.5
    assert controller(preset("warthog")).track_width == pytest.approx(1.5 * 1.125)


def test_commands_from_a_file(tmp_path: Path) -> None:
    body, rims = tmp_path / "body.csv", tmp_path / "rims.csv"
    body.write_text("t,v,omega\n0,0.3,0.5\n1,0.2,0\n")
    rims.write_text("t,v,omega,v_left,v_right\n0,9,9,0.1,0.2\n0.5,9,9,0.3,0.4\n")
    assert_allclose(read_commands(body, P3AT).values, [[0.15, 0.45], [0.2, 0.2]])
    assert_allclose(read_commands(body, P3AT).t, [0.0, 1.0])
    assert_allclose(read_commands(rims, P3AT).values, [[0.1, 0.2], [0.3, 0.4]])
    rims.write_text("t,left\n0,1\n")
    with pytest.raises(DataError, match="no column 'v_left'"):
        read_commands(rims, P3AT)


def test_manoeuvres_in_one_line() -> None:
    rims = parse_manoeuvres(" 2,0.3,0.5: 1.5,-0.2,0 :", P3AT)
    assert rims.t[-1] == pytest.approx(3.5, abs=0.011)
    assert_allclose(rims.values[199], [0.15, 0.45])
    assert_allclose(rims.values[-1], -0.2)


@pytest.mark.parametrize("text", ["", "1,0", "1,0,0:2,0", "0,1,1", "a,b,c", "1,nan,0", "inf,0,0"])
def test_manoeuvres_that_are_none(text: str) -> None:
    with pytest.raises(RequestError, match=r"^manoeuvres '.*': write DURATION,V,OMEGA:\.\.\. in s, m/s, rad/s"):
        parse_manoeuvres(text, P3AT)


def test_manoeuvres_of_more_than_a_day_are_refused() -> None:
    with pytest.raises(RequestError, match=r"1e\+09 s are more than a day; durations are in s"):
        parse_manoeuvres("5e8,0.5,0:5e8,0,1", preset("jackal"))


def test_speeds_within_the_limit_pass() -> None:
    refuse_fast(P3AT, Series(np.arange(2.0), np.full((2, 2), -0.69)))
    refuse_fast(replace(P3AT, max_wheel_speed=None), Series(np.arange(2.0), np.full((2, 2), 19.0)))


def test_speeds_of_no_robot_are_refused() -> None:
    unknown = replace(P3AT, max_wheel_speed=None)
    with pytest.raises(RequestError, match=r"asked for 99.000 m/s at 0.00 s, but no robot reaches 20 m/s"):
        refuse_fast(unknown, Series(np.arange(2.0), np.full((2, 2), 99.0)))


# Grounds in words


def test_grounds_in_words() -> None:
    ground = parse_ground("grass, ice@12.5,lab@20")
    assert ground.everywhere is TERRAINS["grass"]
    assert [area.terrain.name for area in ground.areas] == ["ice", "lab"]
    assert [area.t[0] for area in ground.areas] == [12.5, 20.0]
    assert parse_ground("ice") == Ground(TERRAINS["ice"])
    assert ground.words() == "grass,ice@12.5,lab@20"


def test_grounds_at_places_in_words() -> None:
    ground = parse_ground("grass,ice@6/-1/2.5/1,lab@20")
    assert ground.areas == (Area(TERRAINS["ice"], (2.5, 6.0), (-1.0, 1.0)), Area(TERRAINS["lab"], t=(20.0, np.inf)))
    assert parse_ground(ground.words()) == ground


def test_a_robot_slips_where_the_ice_lies() -> None:
    """On ice at a place ahead the rims slide at once; behind the robot the same ice changes nothing."""
    rims = Series(np.array([0.0, 4.0, 5.0]), np.array([[0.1, 0.6], [0.1, 0.6], [0.0, 0.0]]))
    turned = {
        where: plant("terramechanic")("d", P3AT, parse_ground(f"grass{where}"), rims, usual_sensors(P3AT), 0).gyro
        for where in ("", ",ice@-9/-9/-8/-8", ",ice@-9/-9/9/9")
    }
    rates = [gyro.values[(gyro.t > 2.0) & (gyro.t < 4.0)].mean() for gyro in turned.values() if gyro is not None]
    assert rates[0] == rates[1]
    assert abs(rates[2] - rates[0]) > 0.01


@pytest.mark.parametrize(
    "text",
    [
        *("grass,ice", "grass,ice@x", "grass,ice@5,lab@5", "grass,ice@nan", "lab,ice@inf"),
        *("lab,ice@1/2", "lab,ice@1/2/3/x", "lab,ice@1/2/1/5", "lab,ice@1/2/nan/5", "lab,ice@1/2/3/4/5"),
    ],
)
def test_grounds_whose_times_make_no_sense(text: str) -> None:
    with pytest.raises(RequestError, match=r"write NAME, then NAME@SECONDS for each later one"):
        parse_ground(text)


def test_grounds_that_do_not_exist() -> None:
    for text in ("", "mud", "lab,mud@3"):
        with pytest.raises(RequestError, match=r"^no terrain '"):
            parse_ground(text)


# The command


def test_a_simulated_drive_is_a_drive_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file, out = tmp_path / "c.csv", tmp_path / "new" / "grass"
    file.write_text("t,v_left,v_right\n0,0.2,0.4\n4,0,0\n5,0,0\n")
    words = ("--vehicle", "pioneer-p3at", "--terrain", "grass", "--commands", str(file), "--out", str(out))
    assert run(capsys, monkeypatch, *words, "--seed", "3") == f"written: {out}\n"
    drive = load_drive(out)
    assert drive.vehicle == P3AT
    gyro = drive.gyro
    assert gyro is not None
    steady = steady_turn(robot(P3AT), TERRAINS["grass"], 0.2, 0.4).twist[2]
    assert gyro.values[(gyro.t > 2.0) & (gyro.t < 4.0)].mean() == pytest.approx(steady + 0.002, abs=0.002)
    again = plant("terramechanic")("d", P3AT, parse_ground("grass"), read_commands(file, P3AT), usual_sensors(P3AT), 3)
    assert_array_equal(poses(again).values, poses(drive).values)


def test_what_the_command_refuses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    common = ("--vehicle", "pioneer-p3at", "--out", str(tmp_path / "d"))
    assert "give either --commands FILE or --manoeuvre" in run(capsys, monkeypatch, *common)
    turn = (*common, "--manoeuvre", TURN)
    assert "no plant 'x'" in run(capsys, monkeypatch, *turn, "--plant", "x")
    assert "no terrain 'mud'" in run(capsys, monkeypatch, *turn, "--terrain", "mud")
    fast = run(capsys, monkeypatch, *common, "--manoeuvre", "5,1,0")
    assert fast.startswith("skidsteer: the left wheels are asked for 1.000 m/s")
    assert not (tmp_path / "d").exists()
