"""What is measured in processes of their own: memory, and the time to start."""

from __future__ import annotations

import ctypes
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SAMPLE_BYTES = 3 * 8  # t, v_left, v_right


def peak_memory(what: str) -> float:
    """Additional memory of a fit in a new process, as a multiple of the bytes of the samples."""
    done = subprocess.run([sys.executable, __file__, what], capture_output=True, text=True, check=True)
    return float(json.loads(done.stdout))


def start_times(repeats: int) -> dict[str, float]:
    """Seconds of commands in new processes: on the clock, the fastest; processor time of calibrations."""
    skidsteer = str(Path(sys.executable).with_name("skidsteer"))
    calibrate = [skidsteer, "calibrate", "sample:p3at-lab", "--json"]
    with tempfile.TemporaryDirectory() as cache:
        cold = _seconds(calibrate, {"NUMBA_CACHE_DIR": cache})[1]
        warm = min(_seconds(calibrate, {"NUMBA_CACHE_DIR": cache})[1] for _ in range(2))
    commands = {
        "help": [skidsteer, "--help"],
        "import": [sys.executable, "-c", "import skidsteer"],
        "python": [sys.executable, "-c", "pass"],
    }
    fastest = {name: min(_seconds(command)[0] for _ in range(repeats)) for name, command in commands.items()}
    return fastest | {"cold": cold, "warm": warm}


def _seconds(command: list[str], environment: dict[str, str] | None = None) -> tuple[float, float]:
    """On the clock, and of the processors."""
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, capture_output=True, check=True, env=os.environ | (environment or {}))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.perf_counter() - start, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _additional_memory(what: str) -> float:
    """Bytes by which the resident memory rises above what it is with the drive loaded and the loops compiled."""
    import speed

    run = {"robust": _robust, "squares": _squares}[what]
    run(speed.drive(20_000))
    drive = speed.drive()
    before = _settled()
    run(drive)
    return _peak() - before


def _robust(drive: object) -> None:
    import speed

    speed.robust_fit(drive, speed.increments(drive))


def _squares(drive: object) -> None:
    import speed

    windows = speed.increments(drive)
    cut = speed.steps(drive.wheels, windows, speed.TIMING, slopes=False)
    speed.fit_squares(cut, windows, speed.Icr.nominal(drive.vehicle), speed.Icr.bounds(drive.vehicle))


def _settled() -> float:
    """Resident bytes with freed memory given back, and the peak reset to them."""
    if sys.platform == "linux":
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
    return _peak()


def _peak() -> float:
    if sys.platform == "linux":
        status = Path("/proc/self/status").read_text().split("VmHWM:")[1]
        return 1024.0 * float(status.split()[0])
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


if __name__ == "__main__":
    import speed

    print(json.dumps(_additional_memory(sys.argv[1]) / (SAMPLE_BYTES * speed.SAMPLES)))
