"""Help that lists what is registered, such as families of terms."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import click


def listing(placeholder: str, lines: Callable[[], Iterable[str]]) -> type[click.Command]:
    """A kind of command in whose help `lines` stand in place of `placeholder`."""

    class Listing(click.Command):
        def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
            listed = "\n      ".join(lines())
            whole = click.Command(self.name, help=(self.help or "").replace(placeholder, listed))
            whole.format_help_text(ctx, formatter)

    return Listing
