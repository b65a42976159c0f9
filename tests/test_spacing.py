"""Which reference poses a fit takes: all, or only some where the errors between neighbours last."""

from collections.abc import Callable
from pathlib import Path

import pytest

from noisy_drives import TRUE_NOISE, simulated
from skidsteer.identify.least_squares import FitOptions, fit
from skidsteer.identify.spacing import CANDIDATES, choose_spacing, spread
from skidsteer.io.drives import load_drive
from skidsteer.models import Icr
from skidsteer.windows import increment_windows


def test_all_poses_are_taken_where_the_noise_is_as_modelled() -> None:
    assert choose_spacing([simulated(TRUE_NOISE, 3)], FitOptions()) == 0.0


@pytest.mark.parametrize("name", ["warthog-asphalt", "warthog-grass-b"])
def test_where_errors_last_the_most_certain_estimate_is_taken(name: str, real: Callable[[str], Path]) -> None:
    drive = load_drive(real(name))
    fits = {s: fit(Icr.nominal(drive.vehicle), [drive], [increment_windows(drive, s)]) for s in (0.0, *CANDIDATES)}
    chosen = choose_spacing([drive], FitOptions())
    assert fits[0.0].inflated > 1.0
    assert chosen > 0.0
    assert all(spread(fits[chosen]) <= spread(found) for found in fits.values())
