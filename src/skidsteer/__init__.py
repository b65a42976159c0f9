"""Calibrated motion models for skid-steer robots."""
