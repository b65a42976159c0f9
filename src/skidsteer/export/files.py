"""Formats by name, and the files that stand beside a calibration."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from skidsteer.calibration import Calibration
from skidsteer.errors import RequestError
from skidsteer.export.as_json import as_json
from skidsteer.export.forced import Forced, force
from skidsteer.export.p3at import p3at
from skidsteer.export.robot_localization import robot_localization
from skidsteer.export.ros2_control import ros2_control
from skidsteer.export.settings import Settings
from skidsteer.io.atomic import write_text

FORMATS: dict[str, tuple[str, Callable[[Calibration, Settings, Forced], str]]] = {  # name: file, how it is made
    "ros2-control": ("ros2_control.yaml", ros2_control),
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


def write_all(calibration: Calibration, folder: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Write every format that fits model and robot into a folder that is there; the integers only of a P3-AT.

    Raises:
        DataError: a file cannot be written.
    """
    fitting = [n for n in FORMATS if n != "p3at" or "p3at" in calibration.vehicle.name.lower().replace("-", "")]
    try:
        forced, settings = force(calibration), Settings()
    except RequestError:  # a model that no differential drive comes near
        return ()
    made = {Path(folder) / FORMATS[name][0]: text(calibration, name, settings, forced) for name in fitting}
    for path, content in made.items():
        write_text(path, content)
    return tuple(made)
