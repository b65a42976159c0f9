"""Formats by name, and the files that stand beside a calibration."""

from __future__ import annotations

from collections.abc import Callable

from skidsteer.calibration import Calibration
from skidsteer.errors import RequestError
from skidsteer.export.as_json import as_json
from skidsteer.export.forced import Forced, force
from skidsteer.export.p3at import p3at
from skidsteer.export.robot_localization import robot_localization
from skidsteer.export.ros1_control import ros1_control
from skidsteer.export.ros2_control import ros2_control
from skidsteer.export.settings import Settings

FORMATS: dict[str, tuple[str, Callable[[Calibration, Settings, Forced], str]]] = {  # name: file, how it is made
    "ros2-control": ("ros2_control.yaml", ros2_control),
    "ros1-control": ("ros1_control.yaml", ros1_control),
    "robot-localization": ("ekf.yaml", lambda calibration, settings, _: robot_localization(calibration, settings)),
    "p3at": ("p3at.txt", lambda calibration, _, forced: p3at(calibration, forced)),
    "json": ("model.json", lambda calibration, _, forced: as_json(calibration, forced)),
}


def text(calibration: Calibration, name: str, settings: Settings | None = None, forced: Forced | None = None) -> str:
    """A calibration in one of ``FORMATS``.

    Raises:
        RequestError: no such format; the message lists those there are.
    """
    if name not in FORMATS:
        raise RequestError(f"no format '{name}'; there are: {', '.join(FORMATS)}")
    return FORMATS[name][1](calibration, settings or Settings(), forced or force(calibration))


def texts(calibration: Calibration) -> dict[str, str | None]:
    """The file of every format; None where it does not fit the model, or the robot: integers are of a P3-AT.

    None, too, for ROS 1, which few robots run yet and which is one command away.
    """
    try:
        forced = force(calibration)
    except RequestError:  # a model that no differential drive comes near
        return {file: None for file, _ in FORMATS.values()}
    is_p3at = "p3at" in calibration.vehicle.name.lower().replace("-", "")
    fits = {name: name != "ros1-control" and (name != "p3at" or is_p3at) for name in FORMATS}
    return {FORMATS[n][0]: text(calibration, n, forced=forced) if fit else None for n, fit in fits.items()}
