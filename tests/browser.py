"""Pages in a real browser that has no network."""

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.image import imread

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
WITHOUT = ("gpu", "background-networking", "component-update", "sync")
OPTIONS = ["--headless", "--no-sandbox", "--no-first-run", *(f"--disable-{name}" for name in WITHOUT)]
OPTIONS += ["--hide-scrollbars", "--enable-logging=stderr", "--v=0", "--host-resolver-rules=MAP * ~NOTFOUND"]
BUDGETS = (20_000, 100_000, 500_000)
"""Time in ms on the clock of the page, which runs ahead of a busy machine: the next one where pictures were not loaded."""
# What the page is allowed, put into a copy: all that it carries in itself. Asking for anything else is a word on the console,
# which a file or a host that cannot be had is not.
PROBE = """<script>addEventListener("load", () => {
  for (const folded of document.querySelectorAll("details")) folded.open = true;
  for (const image of document.images) image.dataset.width = image.naturalWidth;
  for (const figure of document.querySelectorAll("svg[role=img]"))
    figure.dataset.width = Math.round(figure.getBoundingClientRect().width);
  const texts = [], wrapped = [], range = document.createRange();
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode, drawn = node.parentElement.closest("text");
    if (!node.data.trim() || node.parentElement.closest("script, style")) continue;
    range.selectNodeContents(node);
    for (const box of drawn ? [drawn.getBoundingClientRect()] : range.getClientRects()) {
      const inset = 0.15 * Math.min(box.width, box.height);  // letters are smaller than the box of their font
      texts.push([node.data.trim(), box.left + inset, box.right - inset, box.top + inset, box.bottom - inset]);
      if (!node.parentElement.closest("pre")) wrapped.push(texts.at(-1));  // a file scrolls
    }
  }
  const over = texts.flatMap(([a, l, r, t, b], i) => texts.slice(i + 1).filter(
    ([, left, right, top, bottom]) => left < r && l < right && top < b && t < bottom).map(([other]) => `${a} | ${other}`));
  document.body.dataset.overlaps = over.slice(0, 9).join("; ");
  document.body.dataset.cut = wrapped.filter(([, , right]) => right > innerWidth).map(([text]) => text).slice(0, 9).join("; ");
  document.body.dataset.loaded = "yes";
})</script>"""
LOADED = 'data-loaded="yes"'
ALLOWED = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"


@dataclass(frozen=True)
class Shown:
    """A page after its scripts ran: the document, what stood on the console, how many colours a part of the window shows."""

    document: str
    console: tuple[str, ...]
    shades: int

    @property
    def overlaps(self) -> str:
        """Texts that overlap, two by two."""
        [found] = re.findall(r'<body[^>]* data-overlaps="([^"]*)"', self.document)
        return str(found)

    @property
    def cut(self) -> str:
        """Texts that end beyond the window."""
        [found] = re.findall(r'<body[^>]* data-cut="([^"]*)"', self.document)
        return str(found)

    @property
    def pictures(self) -> list[tuple[str, int]]:
        """What every figure is said to show, and its width in pixels; 0 where it is broken."""
        without = re.sub(r'src="[^"]*"', "", self.document)
        shown = re.findall(r'<(?:img|svg)[^>]* (?:alt|aria-label)="([^"]*)"[^>]* data-width="(\d+)"', without)
        return [(name, int(width)) for name, width in shown]

    @property
    def body(self) -> str:
        """What the reader sees of the document, as markup."""
        return re.sub(r"<script.*?</script>", "", self.document.partition("<body")[2], flags=re.DOTALL)


def show(page: Path, scratch: Path, width: int = 1000) -> Shown:
    """Open a copy of `page` in a fresh profile below `scratch`, in a window of this `width`, without any network."""
    picture, copy = scratch / "window.png", scratch / "copy.html"
    policy = f'<head><meta http-equiv="Content-Security-Policy" content="{ALLOWED}">{PROBE}'
    markup = page.read_text(encoding="utf-8")
    assert "<head>" in markup
    copy.write_text(markup.replace("<head>", policy, 1), encoding="utf-8")
    for budget in BUDGETS:
        own = [f"--user-data-dir={scratch / 'profile'}", f"--virtual-time-budget={budget}"]
        own += [f"--screenshot={picture}", f"--window-size={width},2500", "--dump-dom"]
        command = [str(CHROMIUM), *OPTIONS, *own, copy.absolute().as_uri()]
        run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
        if LOADED in run.stdout:
            break
    assert LOADED in run.stdout, "the pictures of the page are not loaded"
    console = re.findall(r":CONSOLE[:(]\d+\)?\] (.*)", run.stderr)
    colours = np.round(255.0 * imread(picture).reshape(-1, 4)[::7]).astype(np.uint8).view(np.uint32)
    return Shown(run.stdout, tuple(console), len(np.unique(colours)))
