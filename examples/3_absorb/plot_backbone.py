"""
Frequency and damping over amplitude
====================================

The frequency of a structure with a cubic link moves with its amplitude. Its backbone follows free vibration
without the damping; phase resonance is what a shaker under phase control finds of the damped structure.
"""

import matplotlib.pyplot as plt

import linkwise as lw

rig = lw.rig(
    masses={"frame": 2.0, "sink": 0.2},
    links={"leaf": "frame - ground: k*d + c*v", "nes": "sink - frame: alpha*d + beta*d**3 + c*v"},
    known={"leaf.k": 3000.0, "leaf.c": 1.6, "nes.alpha": 150.0, "nes.beta": 4e5, "nes.c": 0.05},
)
free = lw.backbone(rig, 1, to_amplitude={"x:sink": 0.02})
forced = lw.backbone(rig, 1, to_amplitude={"x:sink": 0.02}, force="sink")
print(forced)

# %%
# The two nearly agree, since damping is small:

fig, (amplitude, damping) = plt.subplots(2, 1, sharex=True)
lw.plot.backbone(free, "x:sink", ax=amplitude)
amplitude.plot(forced.hz, 1e3 * forced.amplitude[:, 1], ":", label="phase resonance")
amplitude.legend()
damping.plot(free.hz, 100 * free.damping)
damping.plot(forced.hz, 100 * forced.damping, ":")
damping.set(xlabel="frequency, Hz", ylabel="damping, %")
amplitude.set_xlabel("")
