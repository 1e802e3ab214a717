"""linkwise identifies nonlinear structures link by link: from a record to the force law of every link.

Names load on first use (PEP 562), so `import linkwise` costs next to nothing and a script pays only for
what it touches. `__init__.pyi` beside this file lists them.
"""

from __future__ import annotations

import sys
from operator import attrgetter

from linkwise import plot as plot
from linkwise.deprecation import Deprecated
from linkwise.registry import lazy_names

__version__ = "0.2.0"

__all__, _load = lazy_names(__name__, f"{__file__}i")

# Old spellings of public names; they warn and are not listed by dir(). CONTRIBUTING.md says when one may go.
_DEPRECATED = {
    "Classical": Deprecated("PhysicsInformedSindy", since="0.2.0", until="0.4.0"),
    "Known": Deprecated("PartialStructure", since="0.2.0", until="0.4.0"),
    "Knowledge": Deprecated("Posterior", since="0.2.0", until="0.4.0"),
    "foreseen": Deprecated("check_discovery", since="0.2.0", until="0.4.0"),
    "read_known": Deprecated("read_partial_structure", since="0.2.0", until="0.4.0"),
    "read_knowledge": Deprecated("read_posterior", since="0.2.0", until="0.4.0"),
    "truth_beside": Deprecated("align_truth", since="0.2.0", until="0.4.0"),
}


def __getattr__(name: str) -> object:
    if name in _DEPRECATED:
        new = _DEPRECATED[name].new
        _DEPRECATED[name].warn(f"linkwise.{name}", f"linkwise.{new}")
        return attrgetter(new)(sys.modules[__name__])
    return _load(name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
