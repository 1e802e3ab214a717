"""Maximum likelihood on the raw record: annealed multiple shooting (METHODS section 5)."""
