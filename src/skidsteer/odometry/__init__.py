"""Odometry: filters that turn wheel samples, and references where there are any, into a pose with its covariance."""
