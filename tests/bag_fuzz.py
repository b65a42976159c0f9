"""Damages small bags at random and reads them, in a process with little memory. Run by ``test_io_bag_fuzz.py``.

Usage: python tests/bag_fuzz.py FOLDER FIRST COUNT

Damage number n is made from seed n, so that a failure can be repeated alone. Prints one JSON document: how the
readings ended, the largest memory and the longest time, and the failures with their seeds.
"""

from __future__ import annotations

import json
import resource
import shutil
import signal
import struct
import sys
import time
import traceback
from collections import Counter
from pathlib import Path
from types import FrameType

import numpy as np

from skidsteer.drive import Drive
from skidsteer.errors import SkidSteerError
from skidsteer.io.bag import list_bag, read_bag
from skidsteer.io.tum import read_tum
from skidsteer.vehicle import Vehicle

MEMORY = 1 << 30  # bytes of address space
SECONDS = 5
VEHICLE = Vehicle("fuzzed", 0.6, 0.15, ticks_per_revolution=1000)
ABSURD = [0, 1, 0x7F, 0xFF, 0x7FFF_FFFF, 0xFFFF_FFFF, 2**40, 2**62, 2**63 - 1, 2**64 - 1]


def main() -> None:
    folder, first, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    bags = sorted(path for path in folder.iterdir() if not path.name.startswith("damaged"))
    for bag in bags:  # imports what reading imports before the limit is set
        assert read(bag) == "drive"
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    signal.signal(signal.SIGALRM, _too_late)
    ends: Counter[str] = Counter()
    failures, longest = [], 0.0
    for seed in range(first, first + count):
        start = time.perf_counter()
        end = attempt(bags[seed % len(bags)], folder / "damaged", seed)
        longest = max(longest, time.perf_counter() - start)
        ends[end.splitlines()[0]] += 1
        if end not in ("drive", "error"):
            failures.append(f"seed {seed}, {bags[seed % len(bags)].name}: {end}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    json.dump({"ends": ends, "longest_s": longest, "peak_mb": peak, "failures": failures[:5]}, sys.stdout)


def attempt(bag: Path, place: Path, seed: int) -> str:
    """Damage a copy of a bag, read it, and say how that ended: "drive", "error", or what must not happen."""
    path = damaged(bag, place, np.random.default_rng(seed))
    signal.alarm(SECONDS)
    try:
        return read(path)
    except BaseException:
        return traceback.format_exc(limit=-3)
    finally:
        signal.alarm(0)


def read(path: Path) -> str:
    end = "drive"
    for reader in (read_tum,) if path.suffix == ".tum" else (list_bag, _read_bag):
        try:
            found = reader(path)
            assert not isinstance(found, Drive) or np.isfinite(found.wheels.values).all()
        except SkidSteerError as error:
            end = "error"
            message = str(error)
            assert message.isprintable(), f"not one line: {message!r}"
            assert 20 < len(message) < 2000, f"too long or too short: {message!r}"
    return end


def _read_bag(path: Path) -> Drive:
    return read_bag(path, VEHICLE)


def damaged(bag: Path, place: Path, rng: np.random.Generator) -> Path:
    """A copy of a bag, one of its files damaged."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    path = place / bag.name
    if bag.is_dir():
        shutil.copytree(bag, path)
        file = rng.choice(sorted(map(str, path.iterdir())))
        Path(file).write_bytes(mutated(Path(file).read_bytes(), rng))
    else:
        path.write_bytes(mutated(bag.read_bytes(), rng))
    return path


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """One to eight damages of the kinds that happen, and of those that someone would try."""
    raw = bytearray(data)
    for _ in range(int(rng.choice([1, 1, 1, 2, 4, 8]))):
        if not raw:
            break
        at, size = int(rng.integers(len(raw))), int(rng.choice([1, 2, 4, 8, 64, 512]))
        match rng.integers(8):
            case 0:
                raw[at] ^= 1 << int(rng.integers(8))
            case 1:
                raw[at : at + size] = rng.bytes(size)
            case 2:
                del raw[at:]
            case 3:
                del raw[at : at + size]
            case 4:
                raw[at:at] = raw[at : at + size] * int(rng.integers(1, 4))
            case 5:
                raw[at : at + 8] = struct.pack("<Q", ABSURD[int(rng.integers(len(ABSURD)))])
            case 6:
                raw[at : at + 4] = struct.pack("<I", ABSURD[int(rng.integers(6))])
            case _:
                raw[at : at + size] = bytes(size)
    return bytes(raw)


def _too_late(number: int, frame: FrameType | None) -> None:
    del number, frame
    raise TimeoutError(f"no end after {SECONDS} s")


if __name__ == "__main__":
    main()
