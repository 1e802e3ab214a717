"""Numerical integration: from the shape of a structure to a compiled integrator. The only package that imports heyoka."""
