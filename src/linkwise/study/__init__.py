"""Monte Carlo studies: cases of structure, noise level, method and seed, the store of their rows, and executors."""
