"""linkwise identifies nonlinear structures link by link: from a record to the force law of every link.

Names load on first use (PEP 562), so `import linkwise` costs next to nothing and a script pays only for
what it touches.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType

__version__ = "0.1.0"

_HOMES = {
    "errors": [
        "IdentificationError",
        "LawError",
        "LinkwiseError",
        "RecordError",
        "SimulationError",
        "StructureError",
    ],
    "law": ["Law"],
    "structure": ["BASE", "GROUND", "Coefficient", "Link", "Mass", "Structure"],
    "structure_file": ["parse_structure", "read_structure", "write_structure"],
    "equilibria": ["barrier", "equilibria", "modes", "wells"],
    "chains": ["bnes_chain"],
    "excitation": ["Excitation", "Impulse", "Sampled", "TimeFunction"],
    "simulate": ["simulate"],
    "record": ["Record"],
    "files": ["read_record", "write_record"],
    "estimate": ["Estimate"],
    "identify": ["identify"],
    "validate": ["nmse"],
    "answer": ["write_result"],
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME_OF)


class _Lazy(ModuleType):
    """The package's own type: a name is fetched from its home when first asked for.

    Some modules bear the name of their one function (`simulate`, `identify`). The import system binds a
    loaded submodule to its package under that name; here the function is bound instead, whoever imported
    the module and in whatever order.
    """

    def __getattr__(self, name: str) -> object:
        if name not in _HOME_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
        super().__setattr__(name, value)
        return value

    def __setattr__(self, name: str, value: object) -> None:
        if _HOME_OF.get(name) == name and isinstance(value, ModuleType):
            value = getattr(value, name)
        super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted({*_HOME_OF, "__version__"})


sys.modules[__name__].__class__ = _Lazy
