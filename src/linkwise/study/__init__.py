"""Monte Carlo campaigns: cases of structure, noise, method and seed; a store that loses none; crews that run them."""
