"""Whole drives through the filters: replay, live, late, back again; whether the covariance is right."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from odometry_drives import ASPHALT, LAG, NOISE, REFERENCE, SAND, Truth, make_filter, simulated, turning, two_grounds
from skidsteer.drive import Series
from skidsteer.errors import DataError, RequestError
from skidsteer.noise import Noise
from skidsteer.odometry.begin import begin
from skidsteer.odometry.icr_filter import IcrFilter
from skidsteer.odometry.log import Log
from skidsteer.odometry.saved_state import load_state, save_state
from skidsteer.odometry.state import FilterState, Pose, YawRate
from skidsteer.odometry.timeline import Timeline
from skidsteer.odometry.trajectory import Trajectory, replay, smooth, stepwise
from skidsteer.se2 import FloatArray, compose, wrap
from skidsteer.windows import Mount

START = np.diag([0.01, 0.01, 0.01]) ** 2


def busy_log(duration: float = 12.0, sees: int = 3) -> Log:
    """Wheels at 25 Hz with a gap, references between their stamps, a gyro with a clock of its own."""
    rng = np.random.default_rng(5)
    truth = simulated(turning(duration, rng, 25.0), ASPHALT.theta, rng, sees=sees)
    keep = (truth.log.wheels.t < 6.0) | (truth.log.wheels.t > 7.5)
    wheels = Series(truth.log.wheels.t[keep], truth.log.wheels.values[keep], "wheels")
    assert truth.log.reference is not None
    seen = Series(truth.log.reference.t + 0.013, truth.log.reference.values, "pose")
    t = np.arange(0.0033, duration - 1.0, 0.037)
    gyro = Series(t, 0.3 * np.sin(t) + 0.02 * rng.standard_normal(len(t)), "gyro")
    return Log(wheels, seen, truth.log.covariance, 0.01, Mount(0.2, 0.1, 0.3), gyro, 1e-2)


@pytest.mark.parametrize("sees", [3, 2])
def test_replay_is_live_to_the_last_bit(sees: int) -> None:
    log, f = busy_log(sees=sees), make_filter(gyro=True)
    start = f.start(float(log.wheels.t[0]), np.zeros(3), START)
    batch, live = replay(f, start, log), stepwise(f, start, log)
    assert 0 < batch.accepted.sum() < len(batch.accepted)  # both kinds of update took place
    assert batch.rates[0] > 200
    for name in ("means", "covariances", "squared", "accepted", "anchored", "seen_t"):
        assert_allclose(getattr(batch, name), getattr(live, name), atol=0.0, err_msg=name)
    assert_allclose(batch.last.memory, live.last.memory, atol=0.0)
    assert batch.rates == live.rates
    assert batch.rate_squared == pytest.approx(live.rate_squared, rel=1e-12)
    assert batch.last.time == live.last.time == log.wheels.t[-1]


def test_a_log_in_two_parts_is_the_log() -> None:
    log, f = busy_log(), make_filter(gyro=True)
    log = replace(log, wheels=Series(log.wheels.t[log.wheels.t < 6.0], log.wheels.values[log.wheels.t < 6.0]))
    start = f.start(0.0, np.zeros(3), START)
    middle = float(log.wheels.t[60])
    parts = [replace(log, wheels=w) for w in (log.wheels.between(0.0, middle), log.wheels.between(middle, 1e3)) if w]
    assert log.reference is not None
    first = replay(f, start, parts[0])
    second = replay(f, first.last, replace(parts[1], reference=log.reference.between(middle + 1e-9, 1e3)))
    assert_allclose(second.last.mean, replay(f, start, log).last.mean, atol=0.0)


def test_what_comes_late_gives_what_comes_in_time() -> None:
    """References half a second late, a gyro 0.2 s late, both in disorder."""
    log, f = busy_log(), make_filter(gyro=True)
    before_gap = log.wheels.t < 6.0
    log = replace(log, wheels=Series(log.wheels.t[before_gap], log.wheels.values[before_gap]))
    start = f.start(float(log.wheels.t[0]), np.zeros(3), START)
    expected = replay(f, start, log).last
    timeline = Timeline(f, start)
    for _, kind, i in arrivals(log):
        timeline = take(timeline, log, kind, i)
    assert_allclose(timeline.now.mean, expected.mean, atol=1e-12)
    assert_allclose(timeline.now.covariance, expected.covariance, atol=1e-12)
    assert len(timeline.past) < 1500


def arrivals(log: Log) -> list[tuple[float, str, int]]:
    """When what comes, in the order of arrival; what the gyro tells last is known after all else."""
    rng = np.random.default_rng(1)
    assert log.reference is not None
    assert log.gyro is not None
    t, gyro, end = log.wheels.t, log.gyro.t, log.wheels.t[-1]
    out = [(float(t[i]), "wheels", i) for i in range(1, len(t))]
    out += [(float(s) + rng.uniform(0.3, 0.6), "pose", k) for k, s in enumerate(log.reference.t) if s <= end]
    out += [(gyro[k] + rng.uniform(0.1, 0.3), "gyro", k) for k in range(1, len(gyro)) if gyro[k] <= end]
    return [*sorted(out), (1e3, "gyro", int(np.searchsorted(gyro, end)))]


def take(timeline: Timeline, log: Log, kind: str, i: int) -> Timeline:
    assert log.reference is not None
    assert log.gyro is not None
    assert log.covariance is not None
    if kind == "wheels":
        left, right = log.wheels.values[i - 1].tolist()
        return timeline.predict((left, right), log.wheels.t[i] - log.wheels.t[i - 1])
    if kind == "pose":
        seen = Pose(log.reference.t[i], log.reference.values[i], log.covariance, log.stamp, log.mount)
        return timeline.update(seen)[0]
    end = min(log.gyro.t[i], timeline.now.time)
    span = end - log.gyro.t[i - 1]
    rate = 0.5 * float(log.gyro.values[i - 1, 0] + log.gyro.values[i, 0])
    after, innovation = timeline.update(YawRate(end, rate, log.gyro_walk / span, span))
    assert innovation.dof >= 1
    return after


def test_a_timeline_refuses_what_it_cannot_place() -> None:
    f = make_filter()
    timeline = Timeline(f, f.start(0.0), horizon=1.0)
    for _ in range(400):
        timeline = timeline.predict((0.4, 0.5), 0.01)
    seen = Pose(4.2, np.zeros(3), np.eye(3))
    with pytest.raises(DataError, match=r"a measurement at 4.200 s lies ahead of the state at 4.000 s"):
        timeline.update(seen)
    with pytest.raises(DataError, match=r"a measurement at 1.000 s is 3.000 s late, and only 1 s are kept"):
        timeline.update(replace(seen, time=1.0))
    assert len(timeline.past) < 300
    assert timeline.predict((0.4, 0.5), 0.0) is timeline
    assert timeline.update(replace(seen, time=3.2))[1].dof == 3


# --- the covariance


def wandering(seed: int, f: IcrFilter, duration: float, **options: int) -> tuple[Truth, FilterState]:
    """A drive whose ground wanders as the filter assumes, from parameters that it is as unsure of as it says."""
    rng = np.random.default_rng(seed)
    rims = turning(duration, rng)
    t = np.arange(0.0, rims.t[-1], 0.2)
    rolled = 0.5 * np.abs(np.diff(np.interp(t, rims.t, np.cumsum(np.abs(rims.values).sum(axis=1) * 0.02))))
    variation = 0.03 * (f.bounds[:, 1] - f.bounds[:, 0])
    walk = np.sqrt(2.0 * rolled / f.options.reach)[:, None] * np.sqrt(variation**2 + np.diag(f.theta_covariance))
    first = np.sqrt(np.diag(f.theta_covariance)) * rng.standard_normal(5)
    theta = ASPHALT.theta + first + np.cumsum(np.vstack([np.zeros(5), walk * rng.standard_normal(walk.shape)]), axis=0)
    truth = simulated(rims, theta, rng, **options)
    return truth, f.start(0.0, truth.poses[0] + np.sqrt(np.diag(START)) * rng.standard_normal(3), START)


def error(track: Trajectory, truth: Truth) -> FloatArray:
    """Estimated less true pose (3,) at the end."""
    true = np.array([np.interp(track.t[-1], truth.t, column) for column in truth.poses.T])
    miss = track.poses[-1] - true
    return np.append(miss[:2], wrap(miss[2]))


@pytest.mark.parametrize("sees", [3, 2])
def test_errors_are_as_large_as_the_filter_says(sees: int) -> None:
    """NIS and NEES over 40 drives lie in their 99.9 % bands: with the reference, and 20 s after it is lost.

    After 60 s, when the yaw has a sigma of 0.2 rad, the median still fits; the tails do not, as nothing is linear then.
    """
    f, nis, pose, theta, lost = make_filter(sigma=0.004), [], [], [], []
    for seed in range(40):
        truth, start = wandering(seed, f, 60.0, sees=sees)
        seen = replay(f, start, truth.before(40.0))
        after = replay(f, start, truth.log.without((40.0, np.inf)))
        nis.append(seen.squared.mean() / sees)
        for track, out in ((seen, pose), (after, lost)):
            miss = error(track, truth)
            out.append(miss @ np.linalg.solve(track.covariances[-1], miss) / 3.0)
        miss = seen.last.mean[3:] - truth.theta[np.searchsorted(truth.t, 40.0) - 1]
        theta.append(miss @ np.linalg.solve(seen.last.covariance[3:, 3:], miss) / 5.0)
    assert abs(np.mean(nis) - 1.0) < 3.3 * np.sqrt(2.0 / (sees * 40 * 200))
    for figures, dof in ((pose, 3), (theta, 5), (lost, 3)):
        assert abs(np.mean(figures) - 1.0) < 3.3 * np.sqrt(2.0 / (dof * 40)), np.mean(figures)


def test_smoothing_is_conditioning_on_everything() -> None:
    """Independent: the joint Gaussian of all states, conditioned on all measurements at once."""
    f = make_filter(gyro=True)
    f = replace(f, theta_covariance=1e-8 * np.eye(5))  # so small that the order of linearising does not matter
    t, count, n = np.linspace(0.0, 1.2, 7), 6, 9
    wheels = Series(t, np.tile([0.4, 0.6], (7, 1)), "wheels")
    start = f.start(0.0, np.zeros(3), 1e-8 * np.eye(3))
    plain = replay(f, start, Log(wheels))
    seen = plain.poses + 1e-4 * np.random.default_rng(0).standard_normal((7, 3))
    rates = np.full(7, (plain.poses[1, 2] - plain.poses[0, 2]) / 0.2) + 1e-3
    log = Log(wheels, Series(t[[2, 5]], seen[[2, 5]]), 1e-8 * np.eye(3), gyro=Series(t, rates), gyro_walk=1e-7)
    smoothed = smooth(f, start, log)
    # States x_0 .. x_6 and turns of the steps, as a linear function of x_0 and the noise of each step
    F, Q = linear(f, start, wheels)
    A = np.zeros((count + 1, n, n + n * count))
    A[0, :, :n] = np.eye(n)
    for k in range(count):
        A[k + 1] = F[k] @ A[k]
        A[k + 1, :, n * (k + 1) : n * (k + 2)] += np.eye(n)
    prior = np.zeros((n + n * count,) * 2)
    prior[:n, :n] = start.covariance
    for k in range(count):
        prior[n * (k + 1) : n * (k + 2), n * (k + 1) : n * (k + 2)] = Q[k]
    H = [A[2, :3], A[5, :3]] + [(A[k + 1, 2:3] - A[k, 2:3]) / 0.2 + A[k, 8:9] for k in range(count)]
    z = [seen[2] - plain.poses[2], seen[5] - plain.poses[5]] + [np.array([1e-3])] * count
    H, z = np.vstack(H), np.concatenate(z)
    R = np.diag([1e-8] * 6 + [1e-7 / 0.2] * count)
    K = prior @ H.T @ np.linalg.inv(H @ prior @ H.T + R)
    mean, P = K @ z, prior - K @ H @ prior
    for k in range(count + 1):
        assert_allclose(smoothed.poses[k] - plain.poses[k], (A[k] @ mean)[:3], atol=3e-7)
        assert_allclose(smoothed.covariances[k], (A[k] @ P @ A[k].T)[:3, :3], rtol=2e-3, atol=1e-12)


def linear(f: IcrFilter, start: FilterState, wheels: Series) -> tuple[list[FloatArray], list[FloatArray]]:
    """Transition and noise of each step, by differences; the bias is told by the step before it wanders."""
    F, Q, state, n = [], [], start, len(start.mean)
    for k in range(len(wheels) - 1):
        speeds, dt = (float(wheels.values[k, 0]), float(wheels.values[k, 1])), float(wheels.t[k + 1] - wheels.t[k])

        def step(mean: FloatArray, covariance: FloatArray, state: FilterState = state, speeds=speeds, dt=dt):  # type: ignore[no-untyped-def]
            shifted = FilterState(f.fingerprint, state.time, mean.copy(), covariance.copy(), state.memory)
            return f.predict(shifted, speeds, dt)

        tiny = 1e-7 * np.eye(n)
        none = 1e-30 * np.eye(n)
        slope = np.array([(step(state.mean + e, none).mean - step(state.mean - e, none).mean) / 2e-7 for e in tiny]).T
        noise = step(state.mean, none).covariance
        F.append(slope)
        Q.append(noise)
        state = step(state.mean, state.covariance)
    return F, Q


@pytest.mark.parametrize("run", [replay, smooth])
def test_a_state_of_another_time_is_refused(run: Callable[..., Trajectory]) -> None:
    truth = simulated(turning(10.0, np.random.default_rng(2)), ASPHALT.theta, np.random.default_rng(3))
    f = make_filter()
    with pytest.raises(DataError, match=r"the state is one at 0\.500000 s, the wheels begin at 0\.000000 s"):
        run(f, f.start(0.5, truth.poses[0], START), truth.log)


def test_smoothing_helps_where_the_reference_was_lost() -> None:
    truth = simulated(turning(60.0, np.random.default_rng(2)), ASPHALT.theta, np.random.default_rng(3))
    f = make_filter()
    log = truth.log.without((20.0, 40.0))
    start = f.start(0.0, truth.poses[0], START)
    forward, both = replay(f, start, log), smooth(f, start, log)
    at = np.searchsorted(forward.t, truth.t[150]) - 1  # 30 s
    sigma = np.sqrt(np.diagonal(forward.covariances[at])), np.sqrt(np.diagonal(both.covariances[at]))
    assert (sigma[1] < 0.8 * sigma[0]).all()
    miss = (
        np.array([[np.interp(t, truth.t, c) for c in truth.poses.T] for t in forward.t[at : at + 1]]) - both.poses[at]
    )
    assert (np.abs(miss[0]) < 4.0 * sigma[1]).all()
    assert_allclose(both.means[-1], forward.means[-1], atol=0.0)
    assert np.linalg.eigvalsh(both.covariances).min() > 0.0


def test_nothing_is_smoothed_over_a_jump_of_the_reference() -> None:
    """The map moves by 5 m after 30 s: what was before stays in the old one."""
    truth = simulated(turning(60.0, np.random.default_rng(2)), ASPHALT.theta, np.random.default_rng(3))
    assert truth.log.reference is not None
    seen = truth.log.reference.values + np.where(truth.log.reference.t[:, None] > 30.0, [5.0, 0.0, 0.0], 0.0)
    log = replace(truth.log, reference=Series(truth.log.reference.t, seen))
    f = make_filter()
    both = smooth(f, f.start(0.0, truth.poses[0], START), log)
    assert both.anchored.sum() == 1
    for until, moved in ((29.0, 0.0), (35.0, 5.0)):
        true = [np.interp(until, truth.t, column) for column in truth.poses.T]
        at = int(np.searchsorted(both.t, until))
        assert_allclose(both.poses[at, :2], [true[0] + moved, true[1]], atol=0.05)


def test_only_the_adaptive_filter_is_smoothed() -> None:
    f = make_filter(adapt=False)
    log = busy_log()
    with pytest.raises(RequestError, match="only the filter 'icr' can be smoothed"):
        smooth(f, f.start(float(log.wheels.t[0])), log)


def test_the_ground_changes_and_the_filter_follows() -> None:
    """From asphalt to sand: the ICRs settle in 30 s of turning, and dead reckoning is good again."""
    deviations, shares = [], []
    for seed in range(6):
        truth = two_grounds(seed)
        tracks = []
        for adapt in (True, False):
            f = make_filter(sigma=0.002, adapt=adapt)
            tracks.append(replay(f, f.start(0.0, truth.poses[0], START), truth.log.without((130.0, np.inf))))
        f = make_filter(sigma=0.002)
        settled = replay(f, f.start(0.0, truth.poses[0], START), truth.before(130.0)).last
        deviations.append((settled.mean[3:6] - SAND.theta[:3]) / np.sqrt(np.diag(settled.covariance)[3:6]))
        lost = truth.t > 130.0
        errors = []
        for track in tracks:
            x, y = (np.interp(truth.t[lost], track.t, track.poses[:, i]) for i in (0, 1))
            errors.append(np.hypot(x - truth.poses[lost, 0], y - truth.poses[lost, 1]).max())
        shares.append(errors[0] / errors[1])
    size = np.abs(deviations)
    assert (size < 2.0).mean() > 0.85, size
    assert size.max() < 3.5
    assert max(shares) < 0.6, shares


def test_covariances_stay_positive_over_many_steps() -> None:
    """A hundred thousand steps: straight on, curves, references that come and go, a position known to 0.1 mm."""
    rims = turning(2000.0, np.random.default_rng(0))
    t = np.concatenate([np.arange(0.1, 100.0, 0.2), np.arange(1500.1, 1501.0, 0.2), np.arange(1900.1, 1990.0, 0.2)])
    f = make_filter(sigma=0.05)
    plain = replay(f, f.start(0.0), Log(rims))
    poses = np.array([np.interp(t, plain.t, c) for c in plain.poses.T]).T
    log = Log(rims, Series(t, poses), np.diag([1e-4, 1e-4, 1e-5]) ** 2)
    track = replay(f, f.start(0.0, np.zeros(3), START), log)
    assert track.accepted.all()
    assert np.linalg.eigvalsh(track.covariances).min() > 0.0
    assert_allclose(track.covariances, np.swapaxes(track.covariances, 1, 2), atol=0.0)
    np.linalg.cholesky(track.last.covariance)


# --- where it begins, and what is saved


def test_it_begins_where_the_first_pose_says() -> None:
    truth = simulated(turning(20.0, np.random.default_rng(2)), ASPHALT.theta, np.random.default_rng(3))
    late = truth.log.without((-1.0, 5.0))
    f = make_filter()
    track = replay(f, begin(f, late, ASPHALT, LAG), late)
    assert track.accepted[:10].all()
    assert np.hypot(*(track.poses[0, :2] - truth.poses[0, :2])) < 0.2
    assert np.hypot(*error(track, truth)[:2]) < 0.05
    np.linalg.cholesky(track.last.covariance)
    assert late.reference is not None
    mount = Mount(0.5, -0.3, 1.0)
    elsewhere = compose(late.reference.values, [0.5, -0.3, 1.0])
    mounted = replace(late, reference=Series(late.reference.t, elsewhere), mount=mount)
    assert_allclose(begin(f, mounted, ASPHALT, LAG).pose, begin(f, late, ASPHALT, LAG).pose, atol=1e-9)
    alone = replace(truth.log, reference=None)
    assert_allclose(begin(f, alone, ASPHALT, LAG).pose, np.zeros(3), atol=0.0)


def test_positions_alone_tell_where_it_heads() -> None:
    """The antenna is off the middle, the frame is turned by 2.5 rad."""
    rng = np.random.default_rng(4)
    truth = simulated(turning(60.0, rng), ASPHALT.theta, rng)
    mount = Mount(0.2, -0.1)
    turned = truth.poses[:, 2] + 2.5
    c, s = np.cos(turned), np.sin(turned)
    x, y = (truth.poses[:, :2] @ [[np.cos(2.5), np.sin(2.5)], [-np.sin(2.5), np.cos(2.5)]]).T
    seen = np.stack([x + 0.2 * c + 0.1 * s, y + 0.2 * s - 0.1 * c], axis=1) + 0.01 * rng.standard_normal((len(x), 2))
    log = Log(truth.log.wheels, Series(truth.t, seen), REFERENCE[:2, :2], mount=mount)
    f = make_filter()
    track = replay(f, begin(f, log, ASPHALT, LAG), log)
    true = [np.interp(track.t[-1], truth.t, column) for column in (x, y, turned)]
    miss = track.poses[-1] - true
    miss[2] = wrap(miss[2])
    assert miss @ np.linalg.solve(track.covariances[-1], miss) < 20.0
    assert np.sqrt(track.covariances[-1, 2, 2]) < 0.03
    assert track.accepted.mean() > 0.98


def test_a_state_is_saved_to_the_last_bit(tmp_path: Path) -> None:
    log, f = busy_log(), make_filter(gyro=True)
    for state in (
        replay(f, f.start(float(log.wheels.t[0]), np.zeros(3), START), log).last,
        f.start(0.1, [0.1, 0.2, 7.0]),
    ):
        save_state(f, state, tmp_path / "state.json")
        again = load_state(make_filter(gyro=True), tmp_path / "state.json")
        assert again.time == state.time
        for name in ("mean", "covariance", "memory"):
            assert getattr(again, name).tobytes() == getattr(state, name).tobytes(), name


def test_states_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    f, path = make_filter(), tmp_path / "state.json"
    save_state(f, f.start(0.0, np.zeros(3), np.eye(3)), path)
    good = json.loads(path.read_text())
    with pytest.raises(RequestError, match="the state belongs to the filter"):
        load_state(make_filter(lag=0.2), path)
    with pytest.raises(RequestError, match="the state belongs to the filter"):
        save_state(make_filter(lag=0.2), f.start(0.0), path)
    wrong = np.array(good["covariance"])
    wrong[0, 0] = -1.0
    cases = [
        ({"covariance": wrong.tolist()}, "not positive definite"),
        ({"covariance": [[1.0, 0.0], [2.0]]}, "the rows of the covariance are not of one length"),
        ({"mean": [0.0] * 3}, "3 means, 8 rows and 23 further numbers do not fit the filter, which has 8 and 23"),
        ({"mean": [None] * 8}, "mean.0"),
        ({"memory": []}, "0 further numbers do not fit"),
        ({"skidsteer_filter_state": 7}, "a state of version 7, this software reads 1"),
        ({"extra": 1}, "extra"),
    ]
    for change, message in cases:
        path.write_text(json.dumps(good | change))
        with pytest.raises(DataError, match=message):
            load_state(f, path)
    path.write_text("nothing")
    with pytest.raises(DataError, match="is not a state of a filter: JSON: Invalid JSON"):
        load_state(f, path)
    with pytest.raises(DataError, match="no such file"):
        load_state(f, tmp_path / "none.json")


def test_a_replay_begins_with_the_wheels() -> None:
    f = make_filter()
    with pytest.raises(DataError, match=r"the state is one at 1.000000 s, the wheels begin at 0.000000 s"):
        replay(f, f.start(1.0), Log(turning(5.0, np.random.default_rng(0))))
    with pytest.raises(RequestError, match="the state belongs to the filter"):
        replay(f, make_filter(lag=0.3).start(0.0), Log(turning(5.0, np.random.default_rng(0))))


def test_the_simulated_noise_is_the_filters() -> None:
    assert NOISE.position == pytest.approx(np.sqrt(REFERENCE[0, 0]))
    assert isinstance(NOISE, Noise)
