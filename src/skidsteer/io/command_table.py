"""A planned drive as files: the commands to play, the path to expect, and a picture of it."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from skidsteer.drive import Series
from skidsteer.io.atomic import write_text
from skidsteer.se2 import FloatArray

TIGHTEST = 50.0  # [1/m] curvature beyond which a robot turns on the spot
PIXELS = 720.0  # of the longer side of a picture
HUES = (210, 30, 130, 0, 280, 180, 60, 330)  # of the strokes of a picture, one after the other


def write_commands(path: str | os.PathLike[str], commands: Series, rims: FloatArray) -> None:
    """Write ``t, v, omega, v_left, v_right``: what to command from t on [s; m/s, rad/s], and the rim speeds it makes.

    Args:
        path: of the CSV file.
        commands: (n, 2) v and omega for the robot's controller.
        rims: (n, 2) rim speeds [m/s] that it turns them into.

    Raises:
        DataError: the file cannot be written.
    """
    _write_csv(path, ("t", "v", "omega", "v_left", "v_right"), np.column_stack([commands.t, commands.values, rims]))


def write_path(path: str | os.PathLike[str], poses: Series) -> None:
    """Write ``t, s, x, y, yaw, curvature`` of poses (n, 3).

    s [m] is the distance covered, curvature [1/m] the yaw turned for each metre of it, empty where the robot rests or
    turns on the spot.

    Raises:
        DataError: the file cannot be written.
    """
    step = np.hypot(*np.diff(poses.values[:, :2], axis=0, append=poses.values[-1:, :2]).T)
    turn = np.diff(poses.values[:, 2], append=poses.values[-1, 2])
    moves = step > np.maximum(np.abs(turn) / TIGHTEST, 1e-6)
    curvature = np.divide(turn, step, out=np.full(len(step), np.nan), where=moves)
    s = np.concatenate([[0.0], np.cumsum(step[:-1])])
    _write_csv(path, ("t", "s", "x", "y", "yaw", "curvature"), np.column_stack([poses.t, s, poses.values, curvature]))


def _write_csv(path: str | os.PathLike[str], names: Sequence[str], rows: FloatArray) -> None:
    lines = (",".join("" if np.isnan(cell) else f"{round(float(cell), 6) + 0.0:.9g}" for cell in row) for row in rows)
    write_text(path, "\n".join([",".join(names), *lines]) + "\n")


def write_picture(
    path: str | os.PathLike[str], strokes: Sequence[FloatArray], area: tuple[float, float], radius: float
) -> None:
    """Write an SVG picture of paths within an area.

    Args:
        path: of the file.
        strokes: of each stretch the positions (n, 2) [m]; x points to the right.
        area: [m] along x and y, about the origin.
        radius: [m] of the robot, drawn at the origin.

    Raises:
        DataError: the file cannot be written.
    """
    scale, edge = PIXELS / max(area), 12.0
    width, height = (scale * side + 2.0 * edge for side in area)

    def place(point: FloatArray) -> str:
        return f"{0.5 * width + scale * point[0]:.1f},{0.5 * height - scale * point[1]:.1f}"

    lines = [
        f'<polyline points="{" ".join(map(place, stroke))}" stroke="hsl({HUES[i % len(HUES)]},70%,45%)"/>'
        for i, stroke in enumerate(strokes)
    ]
    middle = f'cx="{0.5 * width:.1f}" cy="{0.5 * height:.1f}"'
    write_text(
        path,
        "\n".join(
            [
                f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" fill="none">',
                f'<rect width="{width:.0f}" height="{height:.0f}" fill="white"/>',
                f'<rect x="{edge}" y="{edge}" width="{width - 2 * edge:.1f}" height="{height - 2 * edge:.1f}"'
                ' stroke="#888"/>',
                f'<circle {middle} r="{scale * radius:.1f}" stroke="#888" stroke-dasharray="4"/>',
                f'<text x="{edge + 6}" y="{edge + 18}" font-family="sans-serif" font-size="14" fill="#444">'
                f"{area[0]:g} x {area[1]:g} m</text>",
                '<g stroke-width="1.5" stroke-linejoin="round">',
                *lines,
                "</g>",
                "</svg>",
                "",
            ]
        ),
    )
