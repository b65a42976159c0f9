"""Files: the only place with other units, time stamps in nanoseconds and foreign names."""
