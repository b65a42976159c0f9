"""What is there already where a command is to write: it replaces what skidsteer wrote, and nothing else unasked."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

HEAD = 400  # [bytes] that tell what a file is
_EXPORT = rb"# (diff_drive_controller of |ekf_node of robot_localization for |Pioneer P3-AT: )"
_JSON = rb'\{\s*"(skidsteer_export|vehicle)": '
KINDS = {  # how the files begin that skidsteer writes, by their suffix or, where that says too little, their name
    "calibration.yaml": rb"skidsteer_calibration: \d",
    "commands.csv": rb"t,v,omega,v_left,v_right\n",
    "path.csv": rb"t,s,x,y,yaw,curvature\n",
    "reproduction.md": rb"# Five papers, calculated again\n",
    "export": _EXPORT + rb"|" + _JSON,
    "covariances": rb"t,xx,xy,xyaw,yy,yyaw,yawyaw\n",
    "trajectory": rb"-?\d+\.\d{9} \S+ \S+ 0\.0 0\.0 0\.0 \S+ \S+\n",
    ".yaml": _EXPORT,
    ".txt": _EXPORT,
    ".json": _JSON,
    ".html": rb'(?i:<!doctype html>\s*<html lang="en">\s*<head>\s*<meta charset="utf-8">)',
    ".svg": rb'<svg xmlns="[^"]*" viewBox="0 0 \d+ \d+" fill="none">|<\?xml[^>]*>\s*<!DOCTYPE svg',
    ".png": rb"\x89PNG\r\n\x1a\n.{29}pHYs\x00\x00\x2e\x23",  # 300 dpi
}

Force = Annotated[bool, typer.Option("--force", help="replace what skidsteer did not write, too")]


def spare(path: Path, force: bool, kind: str | None = None) -> None:
    """Refuse to replace a file that does not begin as those that skidsteer writes there; an empty one holds nothing.

    Args:
        path: of the file to write, which need not be there.
        force: refuse nothing.
        kind: one of ``KINDS``; default: by the name.

    Raises:
        DataError: it is there, and something else.
    """
    from skidsteer.errors import DataError

    if force or not path.is_file():
        return
    begins = KINDS.get(kind or path.name) or KINDS.get(path.suffix.lower())
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
    except OSError as error:
        raise DataError(
            f"{path}: is there and cannot be read: {error.strerror or error}; choose another path"
        ) from None
    if head and not (begins and re.match(begins, head, re.DOTALL)):
        raise DataError(
            f"{path}: was not written by skidsteer as it stands; choose another --out, or --force to lose it"
        )


def spare_in(folder: Path, names: Iterable[str], force: bool) -> None:
    """Refuse to replace files of those names in a folder, as ``spare`` does, or a folder that cannot be written to.

    Raises:
        DataError: one of them is something else, or the folder cannot be made or written to.
    """
    from skidsteer.io.atomic import check_folder

    check_folder(folder)
    for name in names:
        spare(folder / name, force)


def spare_drive(folder: Path, force: bool) -> None:
    """Refuse to replace a drive that skidsteer did not write, or a folder that cannot be written to.

    Raises:
        DataError: it holds such a drive or other things, or cannot be made or written to.
    """
    from skidsteer.io.atomic import check_folder
    from skidsteer.io.folder import check_replaceable

    check_replaceable(folder, force)
    check_folder(folder)


def spare_file(path: Path, force: bool, kind: str | None = None) -> None:
    """Refuse to replace a file, as ``spare`` does, or one that cannot be written.

    Raises:
        DataError: it is something else, or cannot be written.
    """
    from skidsteer.io.atomic import check_file

    check_file(path)
    spare(path, force, kind)
