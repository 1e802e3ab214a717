"""Multiple shooting: segments of the motion, their sensitivities, and annealed Gauss-Newton steps on both."""
