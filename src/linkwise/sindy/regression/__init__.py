"""Coefficients from equations: one regressor a file, all on one Gram matrix."""
