"""Makes the files of "Your first hour": two runs of a rig, as left by a data logger."""

import numpy as np

import linkwise as lw

rig = lw.parse_structure("""
name = "camera on a frame"

[[mass]]
name = "frame"
mass = "2.4 kg"

[[mass]]
name = "camera"
mass = "350 g"

[[link]]
name = "leaf"
between = ["frame", "ground"]
law = "k*d + c*v"
coefficients = { k = "5.2 kN/m", c = 1.1 }

[[link]]
name = "mount"
between = ["camera", "frame"]
law = "k1*d + k3*d**3 + c*v"
coefficients = { k1 = 900.0, k3 = 8e6, c = 0.35 }
""")

for name, speed, seed in (("run1.csv", 0.6, 1), ("run2.csv", 0.45, 2)):
    clean = lw.simulate(rig, release={"v:frame": speed}, duration=8.0, rate=500.0)
    seen = clean.with_noise(30.0, seed=seed)
    lasers = [1e3 * seen.channel("x:frame"), 1e3 * seen.channel("x:camera")]
    with open(name, "w") as file:
        file.write("Time,Laser 1,Laser 2\n")
        np.savetxt(file, np.column_stack([seen.time, *lasers]), "%.4f", ",")
