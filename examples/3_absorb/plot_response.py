"""
Response of a sink at four levels
=================================

What a bistable sink does under a harmonic force depends on the level: small motion in a well,
chaotic crossings, and large motion from well to well on a branch of its own.
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(2)
response = lw.respond(chain, force={"m1": 1.0}, levels=[0.3, 1.0, 3.0, 6.0], hz=(25.0, 29.0), starts=0)
print(response)

# %%
# Circles are folds, where the motion jumps; unstable motion is dotted.

fig, axes = plt.subplots(layout="constrained")
lw.plot.response(response, "x:m2", legend=False, ax=axes)
fig.legend(loc="outside lower center", ncols=4)

# %%
# The branch on which the sink crosses from well to well begins and ends in folds of its own:

for level in response.levels:
    for branch in level.branches:
        if branch.amplitude[:, 1].max() > 0.02:
            print(f"{level.size:g} N: from {branch.hz.min():.1f} to {branch.hz.max():.1f} Hz")
