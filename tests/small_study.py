"""A study that takes seconds, for the tests of everything that runs studies."""

from pathlib import Path

TEXT = """
snr_db = [40, 20]
first_seed = 1000
cycles = {cycles}
quick = 1

[[structure]]
bnes = 2
release = {{ "v:m1" = 1.0 }}
duration = 0.5
rate = 1000.0

[[structure]]
bnes = 4
release = {{ "v:m1" = 3.0 }}
scatter = 1e-10
duration = 0.5
rate = 1000.0

[[method]]
kind = "weak"

[[method]]
kind = "monomial"
name = "classical, states"
convention = "states"

[[method]]
kind = "ml"
"""

# Two springs that push: it diverges within the record.
DIVERGING = """
[[structure]]
name = "pushed away"
toml = '''
[[mass]]
name = "m1"
mass = 1.0

[[link]]
name = "push"
between = ["m1", "ground"]
law = "k*d + k3*d**3"
coefficients = { k = -1e4, k3 = -1e8 }
'''
release = { "x:m1" = 0.01 }
duration = 5.0
rate = 100.0
"""


def small(folder: Path, *, cycles: int = 2, more: str = "") -> Path:
    """The study as a file in `folder`, with `more` tables."""
    path = folder / "small.toml"
    path.write_text(TEXT.format(cycles=cycles) + more, encoding="utf-8")
    return path
