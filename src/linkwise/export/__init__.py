"""Answers for other programs: one format a file, of a structure with its coefficients, errors and covariance."""
