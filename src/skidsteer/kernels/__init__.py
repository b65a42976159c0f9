"""The compiled loops (Numba), and nothing else. Arrays in, arrays out; every caller checks its arguments first."""
