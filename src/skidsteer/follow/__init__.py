"""A controller drives a robot along a path: the closed loop, what its sensors do, and what came of it."""

from skidsteer.follow.loop import Ends, follow
from skidsteer.follow.run import Run, Summary, summarize
from skidsteer.follow.sensing import Jump, Sensing

__all__ = ["Ends", "Jump", "Run", "Sensing", "Summary", "follow", "summarize"]
