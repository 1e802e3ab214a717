"""
Which terms does a link need?
=============================

Give the terms that the hardware may have as candidates. The path shows the value of each: the
misfit without it, and the criterion, which rises again with terms that only explain noise.
"""

import linkwise as lw

rig = lw.parse_structure("""
name = "slider"

[[mass]]
name = "block"
mass = 0.3

[[link]]
name = "spring"
between = ["block", "ground"]
law = "k*d + k3*d**3 + F*tanh(v/0.01)"
coefficients = { k = 500.0, k3 = 1e5, F = 0.1 }
""")
record = lw.simulate(rig, release={"x:block": 0.03}, duration=3.0, rate=500.0)
record = record.with_noise(30.0, seed=1)

terms = "d, v, d**2, d**3, v*abs(v), tanh(v/0.01)"
found = lw.discover(record, {"block": 0.3}, terms=terms)

# %%
# Each point is the best law of its size; that with the smallest criterion is chosen:

ax = lw.plot.path(found)
print(f"chosen: {found.structure.links[0].law.text}")
