"""Measured and simulated data: channels on one time axis."""
