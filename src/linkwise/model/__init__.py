"""Structures: laws, coefficients, links, masses, excitations, and the structure file."""
