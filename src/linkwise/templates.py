"""Texts of templates, which lie in the packages that fill them and miss nothing silently."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from linkwise.display import format_duration, format_error
from linkwise.registry import lazy_module

if TYPE_CHECKING:
    import jinja2
else:  # who wants numbers alone does not wait for it
    jinja2 = lazy_module("jinja2")


def filled(package: str, template: str, **parts: Any) -> str:
    """What a template of a package makes of its parts, without a new line at its end.

    HTML and XML are escaped; other languages are escaped by their templates.
    """
    return _templates(package).get_template(template).render(parts)


@cache
def _templates(package: str) -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("linkwise", package),
        autoescape=jinja2.select_autoescape(["html.jinja", "xml.jinja"]),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"duration": format_duration, "two_digits": format_error}
    return environment
