"""Waypoints of a path: from a CSV file, or from a plan (``nav_msgs/Path``) in a bag."""

from __future__ import annotations

import os

import numpy as np

from skidsteer.errors import DataError, RequestError
from skidsteer.io.csv_table import numbers, read_table
from skidsteer.io.layout import Block, Decoder, LayoutError
from skidsteer.io.messages import definitions_of
from skidsteer.io.open_bag import is_bag, open_bag
from skidsteer.io.raw import BagTopic, Source, shown
from skidsteer.paths import Path, spline
from skidsteer.se2 import FloatArray

PLAN = "nav_msgs/msg/Path"
CLOSE = 0.01  # [m] between first and last waypoint, within which the path is closed
APART = 0.25  # [m] at least, between waypoints of a plan: a planner's points are denser than its curve is smooth


def read_path(path: str | os.PathLike[str], closed: bool = False, topic: str | None = None) -> Path:
    """A spline through waypoints; closed if asked, or where the last one is the first.

    Args:
        path: CSV file with columns ``x, y`` [m], or a bag.
        closed: go on from the last waypoint to the first.
        topic: of the plan in a bag, whose last message is taken; None: the only one.

    Raises:
        DataError: the file cannot be used, or no curve goes through its points.
        RequestError: several plans in a bag, or none of that topic.
    """
    points = _plan(path, topic) if is_bag(path) else numbers(read_table(path), ("x", "y"))
    meets = len(points) > 3 and float(np.hypot(*(points[-1] - points[0]))) < CLOSE
    try:
        return spline(points[:-1] if meets else points, closed or meets)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def _plan(path: str | os.PathLike[str], topic: str | None) -> FloatArray:
    """Waypoints (n, 2) [m] of the last plan of a topic."""
    last: FloatArray | None = None
    with open_bag(path) as source:
        wanted = _topic(path, source, topic)
        decoder = Decoder(definitions_of(wanted), wanted.type, wanted.encoding)
        latest = -1
        for _, raw in source.read([wanted]):
            for block in decoder.blocks(raw):
                stamps = raw.bag_ns[block.rows]
                if len(stamps) and stamps.max() >= latest:
                    latest, last = int(stamps.max()), _points(block, int(stamps.argmax()))
    if last is None or not np.isfinite(last).all():
        why = f" ({decoder.problem})" if decoder.problem else ""
        raise DataError(f"{path}: {shown(wanted.name)} has no plan with finite points{why}; record one, or write a CSV")
    return spaced(last)


def _topic(path: str | os.PathLike[str], source: Source, topic: str | None) -> BagTopic:
    plans = [t for t in source.topics if t.type == PLAN]
    there = ", ".join(shown(t.name) for t in plans) or "none"
    found = [t for t in plans if topic is None or t.name == topic]
    if len(found) != 1:
        which = f"topic {topic} with" if topic else "one topic with"
        raise RequestError(f"{path}: need {which} {PLAN}; there are: {there}")
    return found[0]


def _points(block: Block, row: int) -> FloatArray:
    """Waypoints (n, 2) of one message of a block."""
    count = sum(name.endswith("].pose.position.x") for name in block.layout.fields)
    try:
        columns = [block.column(f"poses[{i}].pose.position.{axis}")[row] for i in range(count) for axis in "xy"]
    except LayoutError:
        return np.full((1, 2), np.nan)
    return np.array(columns, dtype=float).reshape(-1, 2)


def spaced(points: FloatArray, apart: float = APART) -> FloatArray:
    """Of waypoints (n, 2) those at least ``apart`` [m] from the one kept before; the first and the last always."""
    kept = [0] if len(points) else []
    for i in range(1, len(points)):
        if np.hypot(*(points[i] - points[kept[-1]])) >= apart:
            kept.append(i)
    if kept and kept[-1] != len(points) - 1:
        kept = [*kept[: max(len(kept) - 1, 1)], len(points) - 1]
    return points[kept]
