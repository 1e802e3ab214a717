"""
A link on a wing
================

Most of a wing is linear and known by its modes; a joint in it is not. The modes are stated as a
host, here to within half a per cent, and the link at one of its points is identified with them.
"""

import matplotlib.pyplot as plt

import linkwise as lw

TEXT = """
[[host]]
name = "wing"
modes = [
    {{ frequency = {first}, damping = 0.01, shape = {{ tip = 1.0, joint = 0.62 }} }},
    {{ frequency = {second}, damping = 0.01, shape = {{ tip = -1.0, joint = 0.3 }} }},
]

[[link]]
name = "stop"
between = ["wing.tip", "ground"]
law = "k*d + k3*d**3"
coefficients = {{ k = {k}, k3 = {k3} }}
"""
true = lw.parse_structure(TEXT.format(first=5.2, second=21.0, k=200.0, k3=2e6))
record = lw.simulate(
    true,
    forces={"wing.joint": "5*sin(33*t)"},
    release={"v:wing.mode1": 0.3},
    duration=3.0,
    rate=500.0,
    sensors=["a:wing.tip", "a:wing.joint"],
).with_noise(30.0, seed=1)

asked = lw.parse_structure(
    TEXT.format(
        first='{ start = 5.18, sigma = "0.5 %" }',
        second='{ start = 21.1, sigma = "0.5 %" }',
        k='"unknown"',
        k3='"unknown"',
    )
)
fit = lw.identify(record, asked)
print(fit)

# %%
# The force of the stop over its elongation, with its 95 % band, and the truth:

fig, ax = plt.subplots()
lw.plot.force(fit, "stop", truth=true, ax=ax)
