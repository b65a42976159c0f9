"""Calibrations and drives that the tests of the report share."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from skidsteer.calibration import Calibration
from skidsteer.drive import Drive, Series
from skidsteer.identify.calibrate import CalibrateOptions, calibrate_with_folds
from skidsteer.identify.holdout import Folds
from skidsteer.samples import P3AT_LAG, P3AT_TRUTH, sample
from skidsteer.se2 import chain
from skidsteer.windows import Timing, Windows, predict

HURT = "</script><script>window.hurt=1</script><img src=x onerror='window.hurt=1'>"
NAMES = (f"a{HURT}", 'b"\'>&<iframe src="https://example.org"></iframe><a href="https://example.org">x</a>\u2028\udc80')


@cache
def lab() -> tuple[Calibration, Drive, Folds | None]:
    """A calibration from two minutes of the sample, held out."""
    drive = sample("p3at-mandow").between(0.0, 120.0)
    calibration, folds = calibrate_with_folds([drive], CalibrateOptions(model="icr"))
    return calibration, drive, folds


def hostile() -> tuple[Calibration, list[Drive]]:
    """A calibration and its two drives, with names that would run if they were not escaped."""
    known, drive, _ = lab()
    names, estimates = list(known.names), dict(known.estimates)
    index = names.index("time_offset")
    names[index] = f"time_offset:{NAMES[0]}"
    estimates = {names[known.names.index(name)]: e for name, e in estimates.items()}
    made = known.provenance
    records = tuple(replace(made.drives[0], name=name, source=name) for name in NAMES)
    calibration = replace(
        known,
        vehicle=replace(known.vehicle, name=NAMES[0]),
        names=tuple(names),
        estimates=estimates,
        provenance=replace(made, drives=records, options={**made.options, "model": NAMES[1]}, software=NAMES[0]),
        warnings=NAMES,
        selected_because=NAMES[0],
        profiles={name: replace(known, profiles={}) for name in NAMES},
    )
    return calibration, [replace(drive.between(0.0, 60.0), name=name, source=name) for name in NAMES]


def long_drive(hours: float, at: float, jump: float) -> Drive:
    """The wheels of the sample over and over, a reference at 10 Hz, and one pose of it that is wrong.

    Args:
        hours: it lasts about.
        at: [s] time of the wrong pose.
        jump: [m] by which it is wrong.
    """
    short = sample("p3at-mandow")
    period = short.span[1] + 0.01
    repeats = int(np.ceil(hours * 3600.0 / period))
    t = np.concatenate([short.wheels.t + k * period for k in range(repeats)])
    wheels = Series(t, np.tile(short.wheels.values, (repeats, 1)), "wheels")
    ends = np.arange(1.0, t[-1], 0.1)
    count = len(ends) - 1
    windows = Windows(ends[:-1], ends[1:], np.zeros((count, 3)), np.ones(count, bool))
    poses = chain(predict(P3AT_TRUTH, wheels, windows, Timing(0.0, P3AT_LAG)))
    poses += np.random.default_rng(1).normal(0.0, [0.01, 0.01, 0.005], poses.shape)
    poses[np.searchsorted(ends, at), 0] += jump
    return Drive("long", short.vehicle, wheels, pose=Series(ends, poses, "pose"))
