"""From records and a structure with unknowns to the law of every link."""
