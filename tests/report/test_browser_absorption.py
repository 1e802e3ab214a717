"""The pages of `absorb` in a browser without a network: figures are shown, the console stays silent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from browser import CHROMIUM, show

import linkwise as lw

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")


@pytest.mark.parametrize("kind", ["comparison", "map"])
def test_page_renders_without_a_word_on_the_console(kind: str, tmp_path: Path) -> None:
    options: dict[str, Any] = {"duration": 0.5, "rate": 500.0, "release": {"v:m1": 1.0}}
    chain = lw.bnes_chain(2)
    if kind == "map":
        over = {"nes1.alpha": [-150.0, -100.0], "nes1.beta": [5e5, 1e6]}
        folder = lw.report.write_absorption_map(
            lw.absorption.absorption_map(chain, over, **options), tmp_path / "map"
        )
    else:
        folder = lw.report.write_absorption(lw.absorb(chain, **options), tmp_path / "absorbed")
    page = show(folder / "report.html", tmp_path)
    assert page.console == ()
    assert page.shades > 50  # an empty page has one
    assert page.body.count("<img") == {"comparison": 3, "map": 1}[kind]
