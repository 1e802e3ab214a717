"""Modes of linear structures from measured responses to forces."""
