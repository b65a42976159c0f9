"""Damaged bags end in a drive or in one line that says what is wrong: no traceback, no hang, no memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from bag_files import Message, drive_messages, example_drive, write_messages
from skidsteer.io.mcap_writer import write_mcap
from skidsteer.io.tum import write_tum

INPUTS = 2400
PARTS = 4  # side by side, as pytest-xdist has workers
MEMORY_MB = 1000


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Small bags of every kind, with everything that is decoded."""
    folder = tmp_path_factory.mktemp("bags")
    drive = example_drive(0.3)
    messages = drive_messages(drive, "both", "tf")
    transform = messages[-1].value if messages[-1].topic == "/tf" else {}
    messages.append(Message("/tf_static", "tf2_msgs/msg/TFMessage", messages[0].bag_ns, transform))
    for kind in ("rosbag1", "rosbag1-bz2", "rosbag1-lz4", "sqlite3", "mcap", "mcap-zstd", "mcap-message", "mcap-file"):
        write_messages(folder / kind, kind, messages)
    for compression in ("", "lz4", "zstd"):
        write_mcap(folder / f"ours{compression}.mcap", drive, drive.pose, compression)
    write_tum(folder / "trajectory.tum", drive.pose.t, drive.pose.values)  # type: ignore[union-attr]
    return folder


@pytest.mark.parametrize("part", range(PARTS))
def test_damaged_bags_end_in_a_drive_or_one_line(bags: Path, part: int) -> None:
    count = INPUTS // PARTS
    command = [
        sys.executable,
        "-W",
        "error",
        str(Path(__file__).with_name("bag_fuzz.py")),
        str(bags),
        str(part * count),
        str(count),
    ]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr[-2000:]
    result = json.loads(run.stdout)
    assert not result["failures"], "\n".join(result["failures"])
    assert result["peak_mb"] < MEMORY_MB
    # Both ends occur: the damage is neither harmless nor the end of everything.
    assert result["ends"]["drive"] > count / 20
    assert result["ends"]["error"] > count / 20
