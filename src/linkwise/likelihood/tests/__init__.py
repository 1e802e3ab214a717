"""Score tests: what a held term, a law, a sensor or an input would explain, at its null value."""
