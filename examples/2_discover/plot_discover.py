"""
Who is linked to whom
=====================

A record of four masses and what they weigh, nothing else: which of the ten possible links are
there, and with which terms?
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(4)
record = lw.simulate(chain, release={"v:m1": 3.0}, duration=2.0, rate=1000.0)
record = record.with_noise(30.0, seed=1)

masses = {mass.name: mass.mass.value for mass in chain.masses}
found = lw.discover(record, masses)
print(found)

# %%
# The evidence for every term that was kept, and for those dropped that came nearest. Left of
# the line the decision would be in doubt.

kept = [term for term in found.terms if term.kept]
dropped = [term for term in found.terms if not term.kept]
shown = kept + sorted(dropped, key=lambda term: term.margin)[:5]

fig, ax = plt.subplots(figsize=(6.6, 4.2))
for place, term in enumerate(shown):
    ax.barh(place, term.margin, color="C0" if term.kept else "0.75")
ax.axvline(10.0, color="k", linewidth=0.8)
ax.set_yticks(range(len(shown)), [f"{term.link}: {term.term}" for term in shown])
ax.invert_yaxis()
ax.set(xscale="log", xlim=(1, None), xlabel="margin of the decision")
ax.set_title("kept (blue) and dropped (grey)")
