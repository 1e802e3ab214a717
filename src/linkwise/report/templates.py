"""The templates of all pages: they escape what they print and miss nothing silently."""

from __future__ import annotations

from jinja2 import Environment, PackageLoader, StrictUndefined

from linkwise.display import format_duration, format_error

TEMPLATES = Environment(
    loader=PackageLoader("linkwise", "report"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
TEMPLATES.filters |= {"duration": format_duration, "two_digits": format_error}
