"""Titles and labels that several figures and pages share; nothing here draws."""

from __future__ import annotations

from linkwise.model.structure import Link


def force_title(link: Link) -> str:
    """Name, ends and law of the link."""
    return f"{link.name} ({' – '.join(link.between)}):  {link.law.text}"
