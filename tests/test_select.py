"""Which of several models is taken, from errors made up by hand."""

import numpy as np
import pytest

from skidsteer.identify.holdout import Folds, HeldOutErrors
from skidsteer.identify.select import compare_errors, excess, select
from skidsteer.metrics import WindowErrors
from skidsteer.se2 import FloatArray

BLOCK = np.repeat(np.arange(6), 4)
BASE = np.tile([0.01, 0.02, 0.03, 0.2], 6)


def errors(translation: FloatArray) -> WindowErrors:
    """The yaw errs by 0.01 rad in each window, whatever the model."""
    t, nan = np.arange(len(translation), dtype=float), np.full(len(translation), np.nan)
    return WindowErrors(t, t + 1.0, translation, np.full(len(t), 0.01), nan, nan, nan, nan)


def held_out(translation: FloatArray) -> HeldOutErrors:
    return HeldOutErrors(errors(translation), BLOCK, Folds((), ()))  # type: ignore[arg-type]


def test_excess_by_hand() -> None:
    """Twice in half of the blocks, half in the others: equal in the mean of logs; the mean square grows by 17 / 8."""
    of = BASE * np.where(BLOCK % 2 == 0, 2.0, 0.5)
    found = excess(of, BASE, BLOCK)
    assert found is not None
    assert found.share == pytest.approx(0.0, abs=1e-12)
    assert found.p_worse == pytest.approx(0.5)
    assert found.rms == pytest.approx(np.sqrt(17.0 / 8.0) - 1.0)
    assert found.low < 0.0 < found.high


def scattered(small: float, large: float) -> FloatArray:
    """Errors of a freer model: small ones are less, but by shares too different to prove it; large ones by a factor."""
    factor = np.where(BLOCK % 2 == 0, 0.2, 1.7) * small
    return BASE * np.where(BASE > 0.1, large, factor)


@pytest.mark.parametrize(("large", "chosen"), [(1.3, "icr"), (0.8, "scheduled_icr")])
def test_an_unproven_gain_counts_only_where_the_mean_square_falls_too(large: float, chosen: str) -> None:
    freer = scattered(0.85, large)
    comparison = compare_errors(errors(BASE), errors(freer), BLOCK)
    assert comparison.translation is not None
    assert not comparison.surely_worse
    assert comparison.translation.share > 0.2
    assert comparison.worse == (chosen == "scheduled_icr")
    assert select({"icr": held_out(BASE), "scheduled_icr": held_out(freer)}).name == chosen


def test_a_proven_gain_counts_whatever_the_mean_square_does() -> None:
    freer = BASE * np.where(BASE > 0.1, 1.1, 0.5)
    assert compare_errors(errors(BASE), errors(freer), BLOCK).surely_worse
    assert select({"icr": held_out(BASE), "scheduled_icr": held_out(freer)}).name == "scheduled_icr"
