"""The evidence for memory in words, and as rows of a table."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from linkwise.discovery.memory_evidence import MemoryEvidence

MEMORY_HEAD = ("memory", "law", "over no memory", "over other links", "over other laws")


def memory_sentence(evidence: MemoryEvidence) -> str:
    """What was found of one law."""
    if not evidence.kept:
        return f"{evidence.law} in {evidence.link} explains the records as well."
    if evidence.certain:
        return f"{evidence.link} has memory: {evidence.law}."
    return f"{evidence.link} may have memory, which is in doubt: {evidence.law}."


def memory_rows(memory: Sequence[MemoryEvidence]) -> list[tuple[str, ...]]:
    """By how much the criterion rises without memory, with it in another link, and with another law."""
    margins = [
        (
            evidence.link,
            evidence.law,
            *map(_rough, (evidence.over_none, evidence.over_links, evidence.over_laws)),
        )
        for evidence in memory
    ]
    return [MEMORY_HEAD, *margins]


def _rough(value: float) -> str:
    """A number to three digits."""
    if value == inf:
        return "none tried"
    return f"{value:.3g}" if abs(value) < 1e4 else f"{value:.1e}"
