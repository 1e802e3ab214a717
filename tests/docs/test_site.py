"""The check of a built site finds dead links and anchors, and what a page would load from elsewhere."""

from pathlib import Path

import pytest
from commands import python

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "check_site.py"
GOOD = """<link rel="canonical" href="https://example.org/"><link rel="stylesheet" href="style.css">
<h1 id="top">A page</h1><a href="#top">up</a><a href="sub/#part">down</a><a href="https://example.org">out</a>"""


def checked(site: Path, page: str = GOOD, style: str = "a { color: red }") -> tuple[int, str]:
    """The exit code and the messages of the check, for a site of two pages and a style sheet."""
    (site / "sub").mkdir()
    (site / "index.html").write_text(page, encoding="utf-8")
    (site / "sub" / "index.html").write_text('<p id="part">', encoding="utf-8")
    (site / "style.css").write_text(style, encoding="utf-8")
    done = python(str(SCRIPT), str(site))
    return done.returncode, done.stderr


def test_good_site_passes(tmp_path: Path) -> None:
    assert checked(tmp_path) == (0, "")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("sub/#part", "sub/#path", '"sub/#path" has no such anchor'),
        ('"#top"', '"#bottom"', '"#bottom" has no such anchor'),
        ("sub/#part", "sup/", '"sup/" is not there'),
        ("style.css", "styles.css", '"styles.css" is not there'),
        ('"style.css"', '"https://fonts.example.org/a.css"', "loads https://fonts.example.org/a.css"),
        ("<h1", '<script src="//example.org/a.js"></script><h1', "loads //example.org/a.js"),
    ],
)
def test_faults_are_found(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert GOOD.count(old) == 1
    code, message = checked(tmp_path, GOOD.replace(old, new))
    assert code == 1 and expected in message


def test_remote_fonts_of_style_sheets_are_found(tmp_path: Path) -> None:
    code, message = checked(tmp_path, style='@font-face { src: url("https://example.org/a.woff2") }')
    assert code == 1 and "loads https://example.org/a.woff2" in message


def test_empty_site_is_refused(tmp_path: Path) -> None:
    done = python(str(SCRIPT), str(tmp_path))
    assert done.returncode == 1 and "holds no page" in done.stderr
