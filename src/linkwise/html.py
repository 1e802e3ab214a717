"""What a notebook shows of a result: the single dispatch by which results describe themselves in HTML."""

from __future__ import annotations

from functools import singledispatch
from html import escape
from typing import TYPE_CHECKING, Any

from linkwise.verdict import Verdict, is_trusted

_GOOD, _BAD, _NEUTRAL = "#1a7f37", "#b42318", "#57606a"


class NotebookView:
    """A result that a notebook shows as HTML rather than as its `repr`."""

    def _repr_html_(self) -> str:
        return as_html(self)


class JudgedView(NotebookView):
    """The same for an answer: a result with `verdicts`, which say whether it can be trusted."""

    if TYPE_CHECKING:  # a field or a property of the answer

        @property
        def verdicts(self) -> tuple[Verdict, ...]:
            """What can be said of the answer, the most important first."""

    @property
    def trusted(self) -> bool:
        """Whether no verdict forbids trust."""
        return is_trusted(self.verdicts)

    def _judgement(self) -> dict[str, Any]:
        """The part of `to_dict` that all answers share."""
        return {"verdicts": [verdict.name for verdict in self.verdicts], "trusted": self.trusted}


@singledispatch
def as_html(result: object) -> str:
    """`result` as a self-contained piece of HTML that needs neither scripts nor style sheets.

    Parameters
    ----------
    result : object
        Shown by its printed text; a package registers another renderer beside the type where the text is not enough.

    Returns
    -------
    str
        A `div` in which every character of the text is escaped.

    Examples
    --------
    >>> import linkwise as lw
    >>> "2 masses, 2 links" in lw.bnes_chain(2)._repr_html_()
    True
    """
    return text_html(str(result))


@as_html.register
def _judged(result: JudgedView) -> str:
    return text_html(str(result), result.trusted)


def text_html(text: str, trusted: bool | None = None) -> str:
    """`text` with its first line as the heading: green where it can be trusted, red where not, grey without a claim."""
    colour = _NEUTRAL if trusted is None else _GOOD if trusted else _BAD
    first, _, rest = text.partition("\n")
    body = f'<pre style="margin: 0.4em 0 0 0">{escape(rest)}</pre>' if rest else ""
    return (
        f'<div style="border-left: 4px solid {colour}; padding: 0.3em 0.8em; overflow-x: auto">'
        f"<strong>{escape(first)}</strong>{body}</div>"
    )
