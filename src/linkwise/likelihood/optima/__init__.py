"""Other optima of a likelihood: restarts, valleys, hidden wells, profiles."""
