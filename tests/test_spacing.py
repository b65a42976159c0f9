"""Which reference poses a fit takes: all, or only some where the errors between neighbours last."""

from collections.abc import Callable
from pathlib import Path

from noisy_drives import TRUE_NOISE, simulated
from skidsteer.identify.least_squares import FitOptions, fit
from skidsteer.identify.spacing import CANDIDATES, GAIN, choose_spacing, spread
from skidsteer.io.drives import load_drive
from skidsteer.models import ScheduledIcr
from skidsteer.windows import increment_windows


def test_all_poses_are_taken_where_the_noise_is_as_modelled() -> None:
    assert choose_spacing([simulated(TRUE_NOISE, 3)], FitOptions()) == 0.0


def test_where_errors_last_a_spacing_is_taken_that_makes_the_estimate_clearly_more_certain(
    real: Callable[[str], Path],
) -> None:
    drive = load_drive(real("warthog-grass-b"))
    fits = {
        s: fit(ScheduledIcr.nominal(drive.vehicle), [drive], [increment_windows(drive, s)]) for s in (0.0, *CANDIDATES)
    }
    chosen = choose_spacing([drive], FitOptions())
    assert fits[0.0].inflated > 1.0
    assert chosen > 0.0
    assert spread(fits[chosen]) < spread(fits[0.0]) - GAIN
