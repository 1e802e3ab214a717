"""What it takes to add one of each kind of thing: how many new files, and how many lines elsewhere.

Each test adds something from outside the package, in modules of its own and through the registry of its kind, counts both, and
then uses the new thing as any user would. Nothing else is patched, so nothing else needed touching.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import linkwise as lw
from linkwise.expression.functions import FUNCTIONS, LawFunction
from linkwise.registry import Registry


class Places:
    """What a test adds: `files` are new modules, `lines` are entries in registries."""

    def __init__(self, folder: Path, undo: ExitStack) -> None:
        self.files, self.lines = 0, 0
        self._folder, self._undo = folder, undo

    def file(self, name: str, text: str) -> None:
        """Write a module that can be imported as `name`."""
        (self._folder / f"{name}.py").write_text(text, encoding="utf-8")
        self._undo.callback(sys.modules.pop, name, None)
        self.files += 1

    def line(self, registry: Registry[Any], name: str, entry: object) -> None:
        """Register something for the time of the test."""
        self._undo.enter_context(registry.temporarily(name, entry))
        self.lines += 1


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Places]:
    folder = tmp_path / "added"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    with ExitStack() as undo:
        yield Places(folder, undo)


SPRING = """
[[mass]]
name = "m1"
mass = 1.0

[[link]]
name = "spring"
between = ["m1", "ground"]
law = "F*atan(d/s) + c*v"
coefficients = {coefficients}
"""


def test_a_function_of_laws_is_one_entry(places: Places) -> None:
    arctangent = LawFunction(
        value=np.arctan, derivatives=("1/(1 + x**2)",), antiderivative="x*atan(x) - 0.5*log(1 + x**2)"
    )
    places.line(FUNCTIONS, "atan", arctangent)
    assert (places.files, places.lines) == (0, 1)

    true = lw.parse_structure(SPRING.format(coefficients="{ F = 20.0, s = 0.02, c = 0.5 }"))
    assert true.link("spring").law.units == {"F": "N", "s": "m", "c": "N s/m"}
    record = lw.simulate(true, release={"v:m1": 1.0}, duration=2.0, rate=500.0)
    truth = record.simulated
    assert truth is not None
    put_in = truth.energy.put_in.max()
    assert abs(truth.energy.residual).max() < 1e-12 * put_in  # energies are those of the antiderivative
    asked = lw.parse_structure(
        SPRING.format(coefficients='{ F = { start = 10.0 }, s = 0.02, c = "unknown" }')
    )
    fit = lw.identify(record.with_noise(40.0, seed=1), asked)
    assert fit.trusted
    found = fit.coefficient("spring.F")
    assert found.standard_error is not None
    assert abs(found.value - 20.0) < 4.0 * found.standard_error  # 1 of 16 000 is further off
