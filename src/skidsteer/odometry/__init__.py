"""Odometry: filters that turn wheel samples, and a reference where there is one, into a pose with its covariance."""
