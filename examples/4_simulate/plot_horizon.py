"""
How long a chaotic motion can be predicted
==========================================

Two runs of the same structure, released alike but for one part in a billion. After a while they
have nothing in common; a simulation estimates when rounding errors alone cause that.
"""

import matplotlib.pyplot as plt
import numpy as np

import linkwise as lw

chain = lw.bnes_chain(6)
one = lw.simulate(chain, release={"v:m1": 3.0}, duration=1.5, rate=1000.0)
other = lw.simulate(chain, release={"v:m1": 3.0 * (1 + 1e-9)}, duration=1.5, rate=1000.0)
print(f"rounding spoils the motion after {one.simulated.horizon:.2f} s")

# %%
# Nothing is wrong with either: this is why linkwise never compares a long simulation with a
# record, but looks at short pieces.

fig, (motion, apart) = plt.subplots(2, 1, sharex=True)
for run, label in ((one, "released at 3 m/s"), (other, "a billionth faster")):
    motion.plot(run.time, 1e3 * run.channel("x:m2"), linewidth=0.8, label=label)
motion.set(ylabel="m2, mm")
motion.legend(ncols=2, loc="upper right")
gap = np.abs(one.channel("x:m2") - other.channel("x:m2"))
apart.semilogy(one.time[1:], 1e3 * gap[1:], linewidth=0.6, color="C2")
apart.axvline(one.simulated.horizon, color="k", linewidth=0.8, label="horizon of rounding")
apart.set(xlabel="time, s", ylabel="difference, mm")
apart.legend()
