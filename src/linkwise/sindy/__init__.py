"""Sparse identification of nonlinear dynamics: the paper's methods (METHODS section 3)."""
