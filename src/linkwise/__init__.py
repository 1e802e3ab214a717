"""linkwise identifies nonlinear structures link by link: from a record to the force law of every link.

Names load on first use (PEP 562), so `import linkwise` costs next to nothing and a script pays only for
what it touches. `__init__.pyi` beside this file lists them.
"""

from __future__ import annotations

from linkwise import plot as plot
from linkwise.registry import lazy_names

__version__ = "0.2.0"

__all__, __getattr__ = lazy_names(__name__, f"{__file__}i")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
