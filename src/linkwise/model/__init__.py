"""Structures: laws, coefficients, links, masses, excitations, and the structure file."""

from linkwise.model import notebook as notebook
