"""Identify nonlinear structures link by link: from a measured record to the force law of every link, with intervals.

A structure is masses joined by links; what is unknown in it is identified, or the links themselves are discovered:

>>> import linkwise as lw
>>> chain = lw.bnes_chain(2)  # or lw.read_structure("structure.toml")
>>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(30.0, seed=1)
>>> fit = lw.identify(record, chain.unknown("nes"))  # or of lw.read_record("run.csv")
>>> print(fit)
bistable chain of 2 masses: ml, converged, can be trusted
The laws explain the record to within its noise. (4002 samples, chi-square 1.00..., ... s)
...
nes1 (m2 - m1): alpha*d + beta*d**3 + c*v
                   value  std. error           95 % interval  unit
  alpha          -100.3...        0.48       -101.2... to -99.4...  N/m
...
>>> found = lw.discover(record, {"m1": 1.0, "m2": 0.01})
>>> [link.law.text for link in found.structure.links]
['k*d + c*v', 'k*d + k3*d**3 + c*v']
>>> other = lw.simulate(chain, release={"v:m1": 1.2}, duration=2.0, rate=1000.0).with_noise(30.0, seed=2)
>>> print(lw.validate(other, fit))
The prediction agrees with the record: noise and the errors of the answer explain what is left.
...

What else there is lies in packages: `lw.plot` draws any of these results, `lw.report` writes them into folders, `lw.sindy` has
the paper's method, `lw.analysis` wells and modes; `lw.model`, `lw.records`, `lw.estimates` and others the parts of these.
"""

from __future__ import annotations

from linkwise.registry import lazy_names

__version__ = "0.2.0"

# on first use, so that `import linkwise` costs next to nothing; `__init__.pyi` beside this file lists the names
__all__, __getattr__, __dir__ = lazy_names(__name__, f"{__file__}i")
