"""Parameters of a ``diff_drive_controller``, which are named and mean the same in ROS 1 and ROS 2, with comments."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, isfinite
from shlex import quote

from skidsteer.calibration import Calibration, HeldOut
from skidsteer.export.covariances import DISTANCE, covariances, gyro_alone
from skidsteer.export.forced import Forced, Measured, force
from skidsteer.export.settings import Settings
from skidsteer.export.yaml_text import comment, mapping, rounded
from skidsteer.models import MatrixModel
from skidsteer.multipliers import Multipliers, Projection

LEAST_ARM = 5e-4  # [m] shorter is the origin itself


@dataclass(frozen=True, slots=True)
class Generation:
    """What sets one generation of ROS apart from the other."""

    export: str  # name of the format
    under: str | None  # key between the controller's name and its parameters
    transform: str  # command that publishes a fixed frame, with places for x, y and the frame
    notes: tuple[str, ...]


def controller_yaml(calibration: Calibration, settings: Settings | None, forced: Forced | None, ros: Generation) -> str:
    """YAML to paste into the parameters of the controller, with comments on what it loses.

    Args:
        calibration: of any model.
        settings: of the robot's software.
        forced: its multipliers, from ``force``; None: those that the calibration knows.
        ros: that it is for.

    Raises:
        RequestError: the model does not move as a differential drive at all.
    """
    settings, forced = settings or Settings(), forced or force(calibration)
    sections = (
        _origin(calibration),
        _factors(calibration, forced),
        _loss(calibration, forced, settings, ros),
        _commands(forced.projection.multipliers),
        _noise(calibration, forced.projection, settings),
        comment(*ros.notes),
    )
    parameters = _parameters(calibration, settings, forced.projection)
    inside = parameters if ros.under is None else {ros.under: parameters}
    return "#\n".join(sections) + mapping({settings.controller: inside})


def _parameters(calibration: Calibration, settings: Settings, projection: Projection) -> dict[str, object]:
    """What the calibration decides; every other parameter of the controller stays as it is."""
    multipliers, vehicle = projection.multipliers, calibration.vehicle
    separation = vehicle.factory_separation or vehicle.track_width
    numbers = {
        "wheel_separation": separation,
        "wheel_radius": vehicle.wheel_radius,
        "wheel_separation_multiplier": multipliers.separation / separation,
        "left_wheel_radius_multiplier": multipliers.left_wheel_radius_multiplier,
        "right_wheel_radius_multiplier": multipliers.right_wheel_radius_multiplier,
        "publish_rate": settings.rate,
    }
    known = covariances(calibration, projection, settings.rate, settings.icr_frame is not None)
    frames = {} if settings.icr_frame is None else {"base_frame_id": settings.icr_frame, "enable_odom_tf": False}
    return {
        **dict(zip(numbers, rounded(numbers.values()), strict=True)),
        "open_loop": False,
        **frames,
        "pose_covariance_diagonal": rounded(known.pose, 3),
        "twist_covariance_diagonal": rounded(known.twist, 3),
    }


def _origin(calibration: Calibration) -> str:
    made = calibration.provenance
    drives = ", ".join(drive.name for drive in made.drives)
    return comment(
        f"diff_drive_controller of {calibration.vehicle.name}: the {calibration.model.NAME} model as multipliers.",
        f"Calibrated from {drives} by {made.software}, {made.created}.",
        *(f"Note: {note}." for note in calibration.warnings),
    )


def _factors(calibration: Calibration, forced: Forced) -> str:
    vehicle, width = calibration.vehicle, calibration.effective_track_width
    sigma = "" if width is None else f", a turn on the spot is known to {100 * width.sigma / width.value:.2g} %"
    shipped = ""
    if vehicle.factory_multiplier is not None and vehicle.factory_separation is not None:
        shipped = f" The robot ships with {vehicle.factory_multiplier:g} on {vehicle.factory_separation:g} m."
    return comment(
        f"The factors lose least of the model, first of its yaw rate, then of its speed, over {forced.motions}."
        " Of separation and its multiplier only the product counts,"
        f" {forced.projection.multipliers.separation:.4g} m{sigma}.{shipped} The rim speeds of the drives were computed"
        " with the wheel_radius below: keep the two together."
    )


def _loss(calibration: Calibration, forced: Forced, settings: Settings, ros: Generation) -> str:
    found = forced.projection
    is_linear, arm = isinstance(calibration.model, MatrixModel), hypot(found.x, found.y)
    if arm < LEAST_ARM and is_linear:
        frame = () if settings.icr_frame is None else _frame(found, settings, ros)
        return comment("Nothing of the model is lost in them.", *_figures(calibration, forced.measured, ros), *frame)
    ahead, sideways = (abs(lever * found.yaw_rate) for lever in (found.y, found.x))
    lost = (
        "What is lost: the controller knows no sideways velocity, no asymmetry, no change with speed. Its odometry is"
        f" that of the point x = {_mm(found.x)} m, y = {_mm(found.y)} m of base_link. Taken for base_link itself it is"
        f" wrong by {ahead:.3f} m/s ahead and {sideways:.3f} m/s sideways at {found.yaw_rate:.2g} rad/s, which adds up"
        f" to {2.0 * arm:.3f} m at most, however far it drives."
    )
    beside = "" if is_linear else " What the model makes of speed is lost beside that."
    return comment(lost + beside, *_figures(calibration, forced.measured, ros), *_frame(found, settings, ros))


def _mm(length: float) -> str:
    """Metres to the millimetre, without a sign at zero."""
    return f"{round(length, 3) + 0.0:.3f}"


def _figures(calibration: Calibration, measured: Measured | None, ros: Generation) -> tuple[str, ...]:
    if measured is None:
        return (
            "The errors that are left were not measured: the calibration does not hold them."
            f" `skidsteer export CALIBRATION DRIVE... --to {ros.export}` measures them on drives.",
        )
    rows = {
        "nominal, no multiplier": measured.nominal,
        "these multipliers": measured.forced,
        f"the {calibration.model.NAME} model": measured.model,
    }
    return (
        f"RMS error over {measured.windows} ({measured.forced.windows} of them):",
        *(f"  {name:<26} {_errors(figures)}" for name, figures in rows.items()),
    )


def _errors(figures: HeldOut) -> str:
    gyro = figures.yaw_gyro_deg
    known = {
        f"{figures.translation_m.rms:7.3f} m": figures.translation_m,
        f"{figures.yaw_deg.rms:7.2f} deg": figures.yaw_deg,
    }
    told = [text for text, spread in known.items() if isfinite(spread.rms)]
    if gyro is not None and isfinite(gyro.rms):
        told.append(f"{gyro.rms:7.2f} deg against the gyro")
    return " ".join(told)


def _frame(found: Projection, settings: Settings, ros: Generation) -> tuple[str, ...]:
    if settings.icr_frame is None:
        return (
            "Nothing of the lever arm is lost where the odometry is of a frame at that point, `--icr-frame NAME`, and"
            " robot_localization brings it to base_link.",
        )
    return (
        f"The odometry is of the frame {settings.icr_frame} at that point. The tree of frames needs it once, and no"
        " odom transform from the controller: robot_localization gives that of base_link.",
        "  " + ros.transform.format(x=f"{found.x:.4f}", y=f"{found.y:.4f}", frame=quote(settings.icr_frame)),
    )


def _commands(multipliers: Multipliers) -> str:
    return comment(
        "Commands are scaled by the same factors: to turn on the spot as asked, the wheels now turn"
        f" {_share(multipliers):.2f} times as fast as without them. Look again at limits of speed and acceleration and"
        " at gains of a path follower that were tuned before."
    )


def _share(multipliers: Multipliers) -> float:
    """Rim speed that a turn on the spot asks for, over that of the nominal differential drive; mean of both sides."""
    left, right = multipliers.left_wheel_radius_multiplier, multipliers.right_wheel_radius_multiplier
    return 0.5 * multipliers.wheel_separation_multiplier * (1.0 / left + 1.0 / right)


def _noise(calibration: Calibration, found: Projection, settings: Settings) -> str:
    noise = calibration.noise
    known = covariances(calibration, found, settings.rate, settings.icr_frame is not None)
    of_arm = settings.icr_frame is None and hypot(found.x, found.y) >= LEAST_ARM
    lost = f" It holds what is lost at {found.yaw_rate:.2g} rad/s, too." if of_arm else ""
    if gyro_alone(calibration):
        lost += (
            " No reference told positions: that part is an assumption. Nor whether wheels or gyro erred in yaw: the"
            f" covariances of yaw take all of it, {noise.gyro:.3g} rad after a second, for an error of the wheels."
        )
    raised = f", times {known.raised:.2g}, as held-out windows show" if calibration.regions else ""
    if calibration.regions and calibration.regions.turning > 0.0:
        lost += (
            f" Turns that are off by {100.0 * calibration.regions.turning:.2g} % all through are in that of the yaw."
        )
    return comment(
        f"Covariances: the motion's error grows by {noise.walk:.3g} m in a metre rolled and {noise.turn:.3g} rad in a"
        f" metre that each side rolls apart, with the root of the distance{raised}. That of the twist is for each of"
        f" {settings.rate:g} messages a second at {found.rim_speed:.2g} m/s of the rims, with errors independent from"
        f" message to message: it goes with rate and speed.{lost} That of the pose is after {DISTANCE:g} m straight on;"
        " the true one grows without end: fuse velocities, not the pose."
    )
