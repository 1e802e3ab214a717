"""Checks of a fit, by which an answer is trusted, widened, or refused."""
