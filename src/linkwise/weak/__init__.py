"""Weak-form regression link by link (METHODS section 4)."""
