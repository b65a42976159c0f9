"""What came of a closed loop: every sample of it, and the figures it is judged by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skidsteer.paths import Path
from skidsteer.se2 import FloatArray
from skidsteer.simulate import Motion


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """N samples, one for each time the controller was asked; what was sent holds from its sample to the next."""

    path: Path
    t: FloatArray  # (n,) [s]
    states: FloatArray  # (n, 8) true pose, twist, rim speeds, on the ground
    placed: FloatArray  # (n, 3) true pose in the map of the localization, where the path lies
    seen: FloatArray  # (n, 3) pose told to the controller; NaN: none came
    commanded: FloatArray  # (n, 2) v [m/s], omega [rad/s] of the controller
    sent: FloatArray  # (n, 2) [m/s] rim speeds asked for
    s: FloatArray  # (n,) [m] of the nearest point of the path, lap after lap
    cross_track: FloatArray  # (n,) [m] to the left of it
    heading_error: FloatArray  # (n,) [rad] of the direction of driving, to the left of the tangent there
    power: FloatArray  # (n, 3) [W] see ``Motion``
    outcome: str
    reason: str

    @property
    def done(self) -> bool:
        """Whether the robot drove what it should."""
        return self.outcome in ("arrived", "laps done")

    @property
    def motion(self) -> Motion:
        """The true motion, for what sensors record of it."""
        return Motion(self.t, self.states[:, :3], self.states[:, 3:6], self.states[:, 6:], self.power)


@dataclass(frozen=True, slots=True)
class Summary:
    """Figures of a run. Cross-track errors are of the true pose, SI units."""

    outcome: str
    reason: str
    duration: float  # [s]
    way: float  # [m] of path
    laps: float  # of a closed path; 0 otherwise
    mean: float  # [m] of the absolute cross-track error
    largest: float  # [m]
    rms: float  # [m]
    heading_rms: float  # [rad]
    speed: float  # [m/s] mean, of the origin
    fastest: float  # [m/s] rim speed sent
    effort: float  # [m/s^2] RMS of the change of the rim speeds sent, over the time of a sample
    energy: float | None  # [J] that the rims put in; None: the plant does not tell


def summarize(run: Run, after: float = 0.0) -> Summary:
    """Figures of a run, of what came after a time [s]."""
    kept = run.t >= min(after, run.t[-1])
    t, off = run.t[kept], np.abs(run.cross_track[kept])
    way, sent = run.s[kept][-1] - run.s[kept][0], run.sent[kept]
    dt = np.diff(t)
    change = np.diff(sent, axis=0) / dt[:, None]
    power = run.power[kept][1:, 0]
    return Summary(
        run.outcome,
        run.reason,
        float(t[-1] - t[0]),
        float(way),
        float(way / run.path.length) if run.path.closed else 0.0,
        float(off.mean()),
        float(off.max()),
        float(np.sqrt(np.mean(off**2))),
        float(np.sqrt(np.mean(run.heading_error[kept] ** 2))),
        float(np.hypot(*run.states[kept][:, 3:5].T).mean()),
        float(np.abs(sent).max()),
        float(np.sqrt(np.mean(change**2))) if len(change) else 0.0,
        float(power @ dt) if np.isfinite(power).all() else None,
    )
