"""A plate on the robot, seen by a 2D laser scanner beside the field (Wang 2015, sections 3.2 and 3.3)."""
