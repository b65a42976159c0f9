from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skidsteer.drive import Drive, Series
from skidsteer.identify.alignment import is_turned
from skidsteer.identify.calibrate import CalibrateOptions, calibrate, make_options
from skidsteer.identify.least_squares import FitOptions, fit
from skidsteer.io.drives import load_drive
from skidsteer.metrics import window_errors
from skidsteer.models import Differential, Icr, Linear
from skidsteer.prediction import Uncertainty
from skidsteer.se2 import compose, wrap
from skidsteer.simulate import Sensors, kinematic_drive, rims_from_manoeuvres
from skidsteer.vehicle import preset
from skidsteer.windows import Mount, Timing, increment_windows

P3AT = preset("pioneer-p3at")
TRUTH = Icr(0.26, -0.31, -0.02, 0.95, 0.92)
TURNED = np.radians(-3.0)


def drive_of(yaw: float, seed: int = 0) -> Drive:
    """Two minutes of straights and turns, seen by a sensor at the origin that is turned by ``yaw``."""
    rows = np.array([[6.0, 0.5, 0.0], [6.0, 0.3, 0.6], [5.0, -0.5, 0.0], [6.0, 0.3, -0.6], [4.0, 0.0, 0.8]] * 4)
    rims = rims_from_manoeuvres(rows, Differential(P3AT.track_width))
    drive = kinematic_drive("d", P3AT, TRUTH, rims, Sensors(5.0, 0.01, 0.005), 0.08, (0.02, 0.02), seed)
    assert drive.pose is not None
    return replace(drive, pose=Series(drive.pose.t, compose(drive.pose.values, [0.0, 0.0, yaw])))


@given(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6))
def test_body_undoes_seen(x: list[float]) -> None:
    mount, motion = Mount(*x[:3]), np.array([x[3:]])
    again = mount.body(mount.seen(motion))
    assert_allclose(again[:, :2], motion[:, :2], atol=1e-12)
    assert_allclose(wrap(again[:, 2] - motion[:, 2]), 0.0, atol=1e-12)


def test_a_turned_sensor_is_told_from_a_straight_one() -> None:
    assert is_turned([drive_of(TURNED)], FitOptions())
    assert not any(is_turned([drive_of(0.0, seed)], FitOptions()) for seed in range(2))
    assert not is_turned([drive_of(TURNED)], FitOptions(mount=Mount(0.0, 0.0, TURNED)))
    assert not is_turned([drive_of(TURNED)], FitOptions(mount=None))


def test_the_yaw_of_the_sensor_is_found_with_its_sigma() -> None:
    windows = [increment_windows(drive_of(TURNED))]
    found = fit(Icr.nominal(P3AT), [drive_of(TURNED)], windows, FitOptions(align=True))
    yaw, sigma = found.named("mount_yaw")
    assert abs(yaw - TURNED) < 3.0 * sigma < np.radians(1.0)
    assert found.named("mount_x") == (0.0, 0.0)
    for name, truth in zip(("icr_y_left", "icr_y_right", "icr_x"), TRUTH.theta[:3], strict=True):
        value, sigma = found.named(name)
        assert abs(value - truth) < 3.5 * sigma


def test_a_model_that_crabs_leaves_the_sensor_as_it_is() -> None:
    """A free v_y explains a turned sensor just as well."""
    drive = drive_of(TURNED)
    found = fit(Linear.nominal(P3AT), [drive], [increment_windows(drive)], FitOptions(align=True))
    assert found.named("mount_yaw") == (0.0, 0.0)


def test_calibrate_estimates_the_yaw_where_the_drive_shows_it() -> None:
    found = calibrate(drive_of(TURNED), options=CalibrateOptions(model="icr"))
    assert found.mount.yaw == pytest.approx(TURNED, abs=np.radians(0.7))
    assert any(w.startswith("the reference's sensor is turned by -") for w in found.warnings)
    straight = calibrate(drive_of(0.0), options=CalibrateOptions(model="icr"))
    assert straight.mount == Mount()
    assert "mount_yaw" not in straight.names
    assert not any("turned" in w for w in straight.warnings)


@pytest.mark.parametrize(("words", "align"), [(None, None), ("free", None), ("0.1,0", None), ("0.1,0,0", False)])
def test_a_yaw_that_is_given_is_kept(words: str | None, align: bool | None) -> None:
    assert make_options(mount=words).align is align


def test_squared_distances_do_not_depend_on_where_the_sensor_sits() -> None:
    drive, mount = drive_of(0.0), Mount(0.4, -0.2, 0.7)
    assert drive.pose is not None
    at = [mount.x, mount.y, mount.yaw]
    other = replace(drive, pose=Series(drive.pose.t, compose(drive.pose.values, at)))
    found = fit(Icr.nominal(P3AT), [drive], [increment_windows(drive)])
    errors: list[Uncertainty] = [found.uncertainty(0)]
    here, there = (
        window_errors(found.model, d, Timing(0.0, 0.08), mount=m, uncertainty=errors[0])
        for d, m in ((drive, None), (other, mount))
    )
    assert_allclose(there.squared, here.squared, rtol=1e-9)


def test_a_real_drive_with_a_turned_marker(real: Callable[[str], Path]) -> None:
    """The motion capture of the indoor Husky: correcting 2 deg lowers held-out errors."""
    drive = load_drive(real("husky-mocap"))
    turned, straight = (calibrate(drive, options=CalibrateOptions(model="icr", align=a)) for a in (None, False))
    assert turned.estimates["mount_yaw"].value == pytest.approx(np.radians(-1.9), abs=np.radians(0.6))
    assert turned.held_out["icr"].translation_m.median < straight.held_out["icr"].translation_m.median
