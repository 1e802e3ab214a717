"""Code on pages that runs while the page is built, so that every number below it was printed by it.

Blocks of one page share their names and a folder that is empty at first. A block that fails fails the build, and so does one
that should fail and does not::

    ```{run}                     Python; what it prints and the figures that it opens stand below it
    :raises: RecordError         it must raise this, and the message stands below it
    :hide:                       run it and show only what comes of it
    ```
    ```{command}                 lines that begin with "linkwise"
    :exit: 3                     the exit code of the last one (0 if not given)
    ```
    ```{shown} unknown.toml      a file that blocks before have written, or that the block writes
    ```
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import figure_style
import matplotlib.pyplot as plt
from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

from linkwise.cli import run

IMAGES = "generated"  # folder of the figures below docs


@dataclass
class Session:
    """What the blocks of a page share."""

    names: dict[str, Any]
    folder: TemporaryDirectory[str] = field(default_factory=TemporaryDirectory)
    figures: int = 0

    @contextlib.contextmanager
    def printing(self) -> Iterator[io.StringIO]:
        """Work in the session's folder and collect what is printed."""
        printed = io.StringIO()
        with (
            contextlib.chdir(self.folder.name),
            contextlib.redirect_stdout(printed),
            contextlib.redirect_stderr(printed),
        ):
            yield printed


def literal(text: str, language: str, *classes: str) -> nodes.Node:
    """A block of code or of output."""
    block = nodes.literal_block(text, text, classes=list(classes))
    block["language"] = language
    return block


class Executed(SphinxDirective):
    """A block that runs in the session of its page."""

    has_content = True

    @property
    def session(self) -> Session:
        """The session of this page."""
        if "executed" not in self.env.temp_data:
            names = {"__name__": "__main__", "__file__": str(self.env.doc2path(self.env.docname))}
            self.env.temp_data["executed"] = Session(names)
        found: Session = self.env.temp_data["executed"]
        return found

    def fail(self, why: str) -> Exception:
        """An error that names the page and the line, and ends the build, so that no page with it is kept."""
        return ExtensionError(f"{self.get_location()}: {why}\n\n" + "\n".join(self.content))


class Run(Executed):
    """Python code."""

    option_spec: ClassVar[dict[str, Callable[[str], Any]]] = {
        "raises": directives.unchanged_required,
        "hide": directives.flag,
    }

    def run(self) -> list[nodes.Node]:
        """Execute the code; the code, what it printed and its figures."""
        code = "\n".join(self.content)
        figure_style.reset(None, "")
        with self.session.printing() as printed:
            raised = self.executed(code)
        expected = self.options.get("raises")
        if (type(raised).__name__ if raised else None) != expected:
            raise self.fail(f"expected {expected or 'no error'}, got {raised!r} from:")
        text = printed.getvalue() + (f"{expected}: {raised}" if raised else "")
        shown = [] if "hide" in self.options else [literal(code, "python")]
        output = [literal(text.rstrip(), "text", "output")] if text.strip() else []
        return [*shown, *output, *self.figures()]

    def executed(self, code: str) -> Exception | None:
        """Execute the code; the error that it ends with."""
        try:
            exec(compile(code, f"{self.env.docname}.md", "exec"), self.session.names)
        except Exception as error:  # shown on the page, or it fails the build
            return error
        return None

    def figures(self) -> list[nodes.Node]:
        """The open figures as images, which closes them."""
        folder = Path(self.env.srcdir) / IMAGES
        folder.mkdir(exist_ok=True)
        images: list[nodes.Node] = []
        for number in plt.get_fignums():
            self.session.figures += 1
            name = f"{self.env.docname.replace('/', '-')}-{self.session.figures}.png"
            figure = plt.figure(number)
            figure.savefig(folder / name)
            titles = [axes.get_title() or axes.get_ylabel() for axes in figure.axes]
            images.append(nodes.image(uri=f"/{IMAGES}/{name}", alt="; ".join(filter(None, titles))))
        plt.close("all")
        return images


class Command(Executed):
    """Commands of linkwise."""

    option_spec: ClassVar[dict[str, Callable[[str], Any]]] = {
        "exit": directives.nonnegative_int,
        "quiet": directives.flag,
    }

    def run(self) -> list[nodes.Node]:
        """Run the commands one by one; the commands and what they printed."""
        text = "\n".join(self.content)
        commands = [shlex.split(line) for line in re.sub(r"\\\n\s*", "", text).splitlines()]
        if not commands or any(words[:1] != ["linkwise"] for words in commands):
            raise self.fail("these are not all commands of linkwise:")
        with self.session.printing() as printed:
            codes = [run(words[1:]) for words in commands]
        if codes != [0] * (len(codes) - 1) + [self.options.get("exit", 0)]:
            raise self.fail(f"exit codes {codes} and the output\n\n{printed.getvalue()}\n\nfrom:")
        output = "" if "quiet" in self.options else printed.getvalue().rstrip()
        return [literal(text, "sh"), *([literal(output, "text", "output")] if output else [])]


class Shown(Executed):
    """A file of the session's folder: written from the block, or shown as it is if the block is empty."""

    required_arguments = 1
    option_spec: ClassVar[dict[str, Callable[[str], Any]]] = {"lines": directives.positive_int}

    def run(self) -> list[nodes.Node]:
        """The file, under its name."""
        path = Path(self.session.folder.name, self.arguments[0])
        if self.content:
            path.write_text("\n".join(self.content) + "\n", encoding="utf-8")
        if not path.is_file():
            raise self.fail(f"no block before has written {path.name}")
        lines = path.read_text(encoding="utf-8").splitlines()
        limit = self.options.get("lines", len(lines))
        text = "\n".join([*lines[:limit], *(["..."] if limit < len(lines) else [])])
        caption = nodes.caption("", "", nodes.literal(path.name, path.name))
        language = {".toml": "toml", ".json": "json"}.get(path.suffix, "text")
        return [
            nodes.container(
                "", caption, literal(text, language), literal_block=True, classes=["literal-block-wrapper"]
            )
        ]


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the three directives."""
    os.environ["COLUMNS"] = "100"  # the width of tables that commands print
    app.add_directive("run", Run)
    app.add_directive("command", Command)
    app.add_directive("shown", Shown)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
