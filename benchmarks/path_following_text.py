"""Words of docs/path-following.md; every number in it comes from the runs."""

HEAD = """# Path following

Written by `make studies` (`benchmarks/path_following.py`); nothing here is edited by hand. Everything is simulated.
"""

ASSUMED = """A Summit XL ({mass:g} kg; its centre of mass in the middle) drives the lemniscate of Huskić 2017 (five laps
are 110.77 m, least radius 1.41 m), two laps unless said otherwise, from rest on its beginning. Wheels lag by 0.1 s,
poses come 60 ms late, wheel speeds and gyro at once; the controller runs at 50 Hz. No rim is asked for more than
{rims:g} m/s, nor for a change of more than {acceleration:g} m/s^2, whoever asks. Errors are those of the true pose,
across the path, of the whole run. A run fails where it is more than 1 m off, or takes three times as long as asked for.

Every controller believes the constant ICRs that `skidsteer calibrate` finds on a slow drive (up to 0.45 m/s) in the
same plant on the same terrain. Huskić's, SLPINL and PBR are the laws of the paper, corrected (docs/reproduction.md);
published gains are those with which their authors launch them. Their published limits of the yaw rate (0.5 and
0.6 rad/s) are lifted: on these curves they would slow the robot to 0.7 m/s. SLPINL as published slows down on curves
(b = 0.2); tuned it does not. Regulated pure pursuit has Nav2's defaults with the lookahead that scales with speed;
published, its regulation by curvature is off, as no curve of these paths would call for it. Ours knows beside the ICRs
the lag of the wheels, the delay of the poses and the limits of rim speed and acceleration; `published` are its
defaults. Of the slip it estimates what differs from the ICRs while it drives.

Cells are mean / largest error [cm] and, in brackets, the mean speed along the path [m/s], so that nobody wins by
crawling; a run that fails tells how, and after which share of the way."""

DELAYED = """Ours tuned; of each other law the better of published and tuned gains. 0.1 s of lag, 60 ms of delay."""

TUNED = """
## Tuning

The same search for every controller: cross-entropy over the logarithms of its gains, {sets} sets of gains, {runs}
closed loops of one lap ({speeds} m/s, 0.1 s of lag, 60 ms of delay), once on the terramechanic plant on grass and
once in MuJoCo. What it makes small is the mean of the mean errors; a run that fails counts 1 m, and up to 1 m more for
the way that is left: gains that arrive at 2 m/s are preferred to those that follow more closely at 1 m/s. Gains found
on grass are used on the other terrains of the terramechanic plant, too."""

MAIN = """
## Error over speed"""

WAY = """Tuned gains. Effort is the RMS rate of the rim speeds asked for; energy is what the rims put in (the engine
MuJoCo does not tell it)."""

GRID = """
## Lag and delay

Tuned gains (for 0.1 s of lag and 60 ms of delay), one lap; ours is told the true lag and delay."""

MISMATCH = """
## ICRs of another ground

1.5 m/s, on vinyl. The kinematic plant has the ICRs that the authors publish for a corridor, with its lag of 0.1 s; the
controller believes those, or the published ones of coarse gravel or of grass. The terramechanic plant is on `tiles`,
and the controller believes the ICRs calibrated there, on `gravel` or on `grass`."""

LEAP = """
## A leap of the localization

At half of the way the pose leaps by 0.886 m to the left, and stays there. Told is the way until the robot stays within
10 cm of the path, which has leapt as seen from the ground, and the mean speed of the run."""

ERRED = """
## Ours, told a wrong lag and delay

Both wrong by 30 %."""

SCHEDULED = """
## Scheduled ICRs for all

The controllers believe a `scheduled_icr` calibrated on a drive up to 2 m/s; laws with one icr_x take that of the speed
asked for at a curvature of 0.5 1/m; ours drives by its constant part and begins with the slip that it tells. Gains as
tuned with constant ICRs. Compare with the tables above."""

NOISY = """
## Noise

White noise of 1 cm and 0.01 rad on each pose (at 50 Hz), 0.01 m/s on each rim speed and 0.01 rad/s on the gyro; gains
as tuned without noise, for which ours takes the poses at their word."""
