"""The page "If it refuses" names every cause and no other, and options that there are."""

import re
from pathlib import Path

from linkwise.cli.identify import identify
from linkwise.estimates.causes import CAUSE_KINDS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "if-it-refuses.md"


def test_every_cause_has_a_line() -> None:
    rows = re.findall(r"^\| (`.*?`) \| .+ \| .+ \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    named = [kind for row in rows for kind in re.findall("`(.*?)`", row)]
    assert sorted(named) == sorted(CAUSE_KINDS)


def test_what_to_do_is_right_usage() -> None:
    typed = re.findall(r"`(--[a-z-]+)", PAGE.read_text(encoding="utf-8"))
    assert len(typed) > 10 and set(typed) <= {name for option in identify.params for name in option.opts}
