"""Maximum likelihood on the raw record: fits by multiple shooting, their judgement, and the answer."""
