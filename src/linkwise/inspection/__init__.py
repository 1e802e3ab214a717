"""Inspection of a record before any model: what each channel holds, and what is wrong with it."""
