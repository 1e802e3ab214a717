"""What a structure is: laws, coefficients, links, masses, what drives it, and the file that says so."""
