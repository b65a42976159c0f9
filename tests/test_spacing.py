"""Which reference poses a fit takes: all, or so few that errors do not outlast them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from noisy_drives import TRUE_NOISE, simulated
from skidsteer.drive import Drive, Series
from skidsteer.identify.least_squares import FitOptions, fit
from skidsteer.identify.spacing import CANDIDATES, choose_spacing
from skidsteer.models import Icr
from skidsteer.windows import increment_windows


def with_lasting_errors(drive: Drive, time_constant: float, sigma: float, seed: int) -> Drive:
    """The drive with wheel speeds that err by a share, a first-order Gauss-Markov process of each side."""
    t, values = drive.wheels.t, drive.wheels.values
    decay = np.exp(-np.median(np.diff(t)) / time_constant)
    white = np.random.default_rng(seed).normal(0.0, sigma * np.sqrt(1.0 - decay**2), values.shape)
    share = lfilter([1.0], [1.0, -decay], white, axis=0)
    return replace(drive, wheels=Series(t, values * (1.0 + share)))


def inflated(drive: Drive, spacing: float) -> float:
    return fit(Icr.nominal(drive.vehicle), [drive], [increment_windows(drive, spacing)]).inflated


def test_all_poses_are_taken_where_the_noise_is_as_modelled() -> None:
    assert choose_spacing([simulated(TRUE_NOISE, 3)], FitOptions()) == 0.0


@pytest.mark.parametrize("seed", [1, 2])
def test_where_errors_last_poses_are_taken_so_far_apart_that_the_noise_explains_them(seed: int) -> None:
    drive = with_lasting_errors(simulated(TRUE_NOISE, seed), time_constant=1.5, sigma=0.15, seed=seed)
    chosen = choose_spacing([drive], FitOptions())
    assert inflated(drive, 0.0) > 1.0
    assert chosen in CANDIDATES
    assert inflated(drive, chosen) == 1.0
