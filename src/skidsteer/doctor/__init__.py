"""What is wrong with a log, how sure that is, what it does to a calibration, and the cure.

``examine`` finds, ``fix`` cures what can be cured safely. Every test compares sensors with each other (wheels,
reference, gyro) or a sensor with what it can physically be; what a robot, its slip and its delays explain is no fault.
"""

from skidsteer.doctor.cures import fix
from skidsteer.doctor.examination import examine
from skidsteer.doctor.findings import EXCITATION, KINDS, SEVERITIES, Finding

__all__ = ["EXCITATION", "KINDS", "SEVERITIES", "Finding", "examine", "fix"]
