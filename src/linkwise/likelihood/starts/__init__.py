"""Where a maximum-likelihood fit starts: coefficients and states from the record."""
