from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from noisy_drives import P3AT, TRUE_NOISE, TRUTH, ones, residuals_of, simulated, slipping, spoiled, true_residuals
from skidsteer.drive import Drive, Series
from skidsteer.identify import problem
from skidsteer.identify.least_squares import fit
from skidsteer.models import Icr
from skidsteer.noise import fit_noise
from skidsteer.outliers import EPISODE, reweigh, temper
from skidsteer.se2 import between, compose
from skidsteer.windows import increment_windows


@pytest.mark.parametrize("change", [[0.4, 0.0, 0.0], [0.0, -0.4, 0.0], [0.0, 0.0, 0.4], [0.3, 0.3, -0.3]])
def test_a_single_wrong_pose_is_an_outlier_of_the_pose(change: list[float]) -> None:
    weights = reweigh([spoiled(np.array(change), 300, 301)], TRUE_NOISE)[0]
    assert weights.end[299] < 0.05  # window 299 ends with pose 300
    # its neighbours share the blame a little; nothing else does, and nothing as much
    far = np.abs(np.arange(len(weights.end)) - 299) > 4
    assert (weights.end[far] > 0.5).all()
    assert (weights.motion[far] > 0.5).all()
    assert np.delete(weights.end, 299).min() > 3.0 * weights.end[299]
    assert weights.motion.min() > 3.0 * weights.end[299]
    assert (weights.start == 1.0).all()


@pytest.mark.parametrize("change", [[0.8, 0.0, 0.0], [0.0, -0.8, 0.0], [0.1, 0.1, 0.1]])
def test_a_jump_of_the_reference_is_an_outlier_of_the_motion(change: list[float]) -> None:
    weights = reweigh([spoiled(np.array(change), 301, 10**6, globally=True)], TRUE_NOISE)[0]
    assert weights.motion[300] < 0.1  # window 300 leads from pose 300 to pose 301
    assert np.argmin(weights.motion) == 300
    assert weights.end.min() > weights.motion[300]
    far = np.abs(np.arange(len(weights.motion)) - 300) > 20
    assert (weights.motion[far] > 0.5).all()
    assert (weights.end[far] > 0.5).all()


def test_a_wrong_first_pose_is_found() -> None:
    weights = reweigh([spoiled(np.array([0.4, 0.0, 0.0]), 0, 1)], TRUE_NOISE)[0]
    assert weights.start[0] < 0.05
    assert (weights.start[1:] == 1.0).all()
    assert (weights.end > 0.5).all()


def test_noise_alone_is_hardly_ever_an_outlier() -> None:
    """By chance one pose in a thousand; none by much."""
    parts = [true_residuals(seed) for seed in range(5)]
    for part, weights in zip(parts, reweigh(parts, TRUE_NOISE), strict=True):
        assert len(weights.end) == len(part.residual)
        for share in (weights.start, weights.end, weights.motion):
            assert ((share > 0.0) & (share <= 1.0)).all()
            assert (share < 1.0).mean() < 0.004
            assert (share > 0.5).all()


def test_weights_fall_with_the_squared_distance() -> None:
    shares = [reweigh([spoiled(np.array([d, 0.0, 0.0]), 300, 301)], TRUE_NOISE)[0].end[299] for d in (0.4, 0.8)]
    assert shares[0] / shares[1] == pytest.approx(4.0, rel=0.2)


@pytest.mark.parametrize("step", [[0.0, 0.0, 0.05], [0.03, 0.0, -0.03], [0.03, -0.03, 0.0]])
def test_an_episode_of_slip_is_found_by_its_sum(step: list[float]) -> None:
    """A side that spins for 3 s: no motion is odd by itself, all of them together are."""
    part, first, last = slipping(np.array(step), 300, 315), 300, 315
    weights = reweigh([part], TRUE_NOISE)[0]
    assert np.median(weights.motion[first:last]) < 0.5
    assert (weights.motion < 0.7).sum() <= 2 * (last - first)
    quiet = replace(part, windows=replace(part.windows, joined=np.zeros(len(part.residual), bool)))
    alone = reweigh([quiet], TRUE_NOISE)[0]  # each motion for itself
    assert np.median(alone.motion[first:last]) == 1.0


def test_errors_that_all_episodes_share_make_none_odd() -> None:
    """A model that is wrong everywhere is no reason to leave out what drives most."""
    part = slipping(np.array([0.0, 0.0, 0.02]), 0, 1229)
    weights = reweigh([part], fit_noise([part], TRUE_NOISE, [ones(part)]))[0]
    assert (weights.motion < 1.0).mean() < 0.03  # 0.08 if each were held against the noise alone


# Heavy tails


def dragging(seed: int) -> Drive:
    """A drive that loses a share of its turn, of each episode its own: mostly about 2 %, of one in five 5 to 40 %."""
    drive, rng = simulated(TRUE_NOISE, seed), np.random.default_rng(seed)
    assert drive.pose is not None
    t, pose = drive.pose.t, drive.pose.values
    lost = np.where(rng.random(1000) < 0.2, rng.uniform(0.05, 0.4, 1000), 0.02 + 0.02 * rng.standard_normal(1000))
    motion = between(pose[:-1], pose[1:])
    motion[:, 2] *= 1.0 - lost[((t[:-1] - t[0]) // EPISODE).astype(int)]
    moved = [pose[0]]
    for step in motion:
        moved.append(compose(moved[-1], step))
    return replace(drive, pose=Series(t, np.array(moved)))


def test_gaussian_episodes_keep_their_weight() -> None:
    parts = [true_residuals(seed) for seed in range(5)]
    for known, tempered in zip(reweigh(parts, TRUE_NOISE), temper(parts, TRUE_NOISE), strict=True):
        assert_array_equal(tempered.motion, known.motion)
        assert_array_equal(tempered.end, known.end)
        assert_array_equal(tempered.start, known.start)


def test_few_episodes_do_not_tell_how_heavy_their_tails_are() -> None:
    """Of two minutes they would prove it, but the estimate does not follow so few; of four it does."""
    part = residuals_of(dragging(0))
    for seconds, followed in ((120.0, False), (240.0, True)):
        some = part.windows.start < part.windows.start[0] + seconds
        short = replace(
            part,
            windows=part.windows.where(some),
            **{name: getattr(part, name)[some] for name in ("residual", "paths", "start_twist", "end_twist", "gyro")},
            gyro_time=part.gyro_time[some],
        )
        (known,), (weights,) = reweigh([short], TRUE_NOISE), temper([short], TRUE_NOISE)
        assert (weights.motion != known.motion).any() == followed


def test_the_estimate_follows_the_episodes_that_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    """The track width that suits most, not the mean of all."""

    def width(seed: int) -> float:
        drive = dragging(seed)
        found = fit(Icr.nominal(P3AT), [drive], [increment_windows(drive)])
        assert isinstance(found.model, Icr)
        return found.model.icr_y_left - found.model.icr_y_right

    wide = TRUTH.icr_y_left - TRUTH.icr_y_right
    tempered = np.array([width(seed) for seed in range(4)]) / wide - 1.0
    monkeypatch.setattr(problem, "temper", reweigh)
    plain = np.array([width(seed) for seed in range(4)]) / wide - 1.0
    assert (tempered > 0.0).all()
    assert (tempered < plain).all()
    assert tempered.mean() < 0.8 * plain.mean()
