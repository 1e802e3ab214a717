"""
A mass without a sensor
=======================

The motion of a mass without a sensor is a hidden state, and is estimated together with the laws.
The search then needs starting values, such as those of the drawing.
"""

import matplotlib.pyplot as plt

import linkwise as lw

chain = lw.bnes_chain(2)
record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0)
record = record.with_noise(40.0, seed=1)
unknown = chain.unknown("nes")

drawing = {"nes1.alpha": -80.0, "nes1.beta": 8e5, "nes1.c": 0.03}
both = lw.identify(record, unknown)
one = lw.identify(record.select(["x:m2"]), unknown, starts=drawing)
for name, fit in (("both sensors", both), ("m2 alone", one)):
    beta = fit.coefficient("nes1.beta")
    print(f"{name}: beta = {beta.value:.0f} +- {beta.standard_error:.0f} N/m^3")

# %%
# The motion of the mass that was hidden, as the fit has it, beside what its sensor would have
# shown. The first link holds m1 to the ground, so its elongation is the displacement of m1.

time, hidden = one.motion.time, one.motion.d[:, 0]
first = time < 0.3

fig, ax = plt.subplots()
ax.plot(time[first], 1e3 * record.channel("x:m1")[first], color="0.7", linewidth=4, label="m1, not used")
ax.plot(time[first], 1e3 * hidden[first], "k:", label="m1, found")
ax.set(xlabel="time, s", ylabel="displacement, mm")
ax.legend(ncols=2)
