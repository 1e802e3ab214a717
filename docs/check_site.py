"""Checks a built site as a reader without a network meets it: `python docs/check_site.py docs/site`.

Every local link leads to a file that is there, and to an anchor in it; nothing is loaded from elsewhere.
"""

from __future__ import annotations

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag, urlsplit

LOADED = {
    ("script", "src"),
    ("img", "src"),
    ("link", "href"),
    ("iframe", "src"),
    ("source", "src"),
    ("video", "src"),
}
UNLOADED = {
    "canonical",
    "next",
    "prev",
    "search",
    "index",
    "author",
    "license",
}  # relations that load nothing
IN_STYLES = re.compile(r"""url\(\s*["']?([^"')]+)|@import\s+["']([^"']+)""")


class Page(HTMLParser):
    """The anchors, links and loaded files of one page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors = {""}
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect what a tag names, links to and loads."""
        given = dict(attrs)
        self.anchors.update(filter(None, (given.get("id"), given.get("name"))))
        if tag == "a" and given.get("href"):
            self.links.append(str(given["href"]))
        relations = set((given.get("rel") or "").split())
        if tag != "link" or not relations & UNLOADED:
            self.loaded += [value for key, value in attrs if value and (tag, key) in LOADED]


def is_remote(target: str) -> bool:
    """Whether a target lies outside the site."""
    return bool(urlsplit(target).scheme or urlsplit(target).netloc)


def fault(path: Path, target: str, pages: dict[Path, Page]) -> str:
    """What is wrong with a local target in the file `path`, or nothing."""
    name, anchor = urldefrag(target)
    file = (path.parent / unquote(urlsplit(name).path)).resolve() if urlsplit(name).path else path
    file = file / "index.html" if file.is_dir() else file
    if not file.exists():
        return f'{path}: "{target}" is not there'
    if file in pages and unquote(anchor) not in pages[file].anchors:
        return f'{path}: "{target}" has no such anchor'
    return ""


def faults(site: Path) -> list[str]:
    """All that is wrong in the site."""
    paths = [
        path.resolve() for path in site.rglob("*.html") if "_static" not in path.parts
    ]  # there are templates
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in paths}
    if not pages:
        return [f"{site} holds no page"]
    found = []
    for path, page in pages.items():
        found += [
            f"{path}: loads {target}" for target in page.loaded if is_remote(target) and target[:5] != "data:"
        ]
        local = [target for target in page.links + page.loaded if not is_remote(target)]
        found += [fault(path, target, pages) for target in local]
    for path in site.rglob("*.css"):
        targets = [one or other for one, other in IN_STYLES.findall(path.read_text(encoding="utf-8"))]
        found += [
            f"{path}: loads {target}" for target in targets if is_remote(target) and target[:5] != "data:"
        ]
    return sorted({text for text in found if text})


if __name__ == "__main__":
    wrong = faults(Path(sys.argv[1]))
    print("\n".join(wrong), file=sys.stderr, end="\n" if wrong else "")
    sys.exit(bool(wrong))
