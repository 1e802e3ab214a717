"""How the documentation is built: `make docs` runs Sphinx on this folder with warnings as errors."""

from __future__ import annotations

import sys
from pathlib import Path
from string import ascii_letters

from numpydoc.xref import DEFAULT_LINKS
from sphinx.util.inspect import TypeAliasForwardRef

import linkwise as lw

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))
from api_reference import FULL  # noqa: E402

for (
    name
) in lw.plot.__all__:  # pictures are shown with the arguments that callers give, which their source has not
    vars(getattr(lw.plot, name)).pop("__wrapped__", None)

project = "linkwise"
author = "The linkwise developers"
copyright = author
version = release = lw.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
    "api_reference",
    "executed",
    "mathml",
]
exclude_patterns = ["examples", "extensions", "generated", "site"]
nitpicky = True

# Pages
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

# Docstrings
default_role = "py:obj"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_type_aliases = dict.fromkeys(("Floats", "Bools", "Indices"), "ndarray")
TypeAliasForwardRef.__repr__ = lambda self: self.name  # what a page shows of an alias inside another type
python_maximum_signature_line_length = 88
autosummary_generate = True
numpydoc_show_class_members = False
numpydoc_xref_param_type = True
numpydoc_xref_aliases = {
    **{name: name for name in DEFAULT_LINKS},  # these point to pages of Python and NumPy
    **{name: f"linkwise.{full}" for name, full in FULL.items()},
}
numpydoc_xref_ignore = {
    "default",
    "of",
    "optional",
    "or",
    "shape",
    "to",
    *ascii_letters,
}  # of shapes, such as (N, p)

# Without a network nothing outside this package can be linked to; names of it that are not public are no links.
nitpick_ignore_regex = [("py:.*", r"(?!linkwise\.).*"), ("py:.*", r"linkwise\.[a-z_]+\..*")]


# Gallery
sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "reset_modules": ("matplotlib", "figure_style.reset"),
    "abort_on_example_error": True,
    "run_stale_examples": True,
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "capture_repr": ("_repr_html_",),
    "thumbnail_size": (400, 200),
    "write_computation_times": False,
    "min_reported_time": 1e9,
    "parallel": True,
    "download_all_examples": False,
}

# Site
html_theme = "pydata_sphinx_theme"
html_math_renderer = "mathml"
html_title = "linkwise"
html_static_path = ["static"]
html_css_files = ["linkwise.css"]
html_sidebars = {
    "index": [],
    "first-hour": [],
    "methods": [],
    "architecture": [],
    "CONTRIBUTING": [],
    "CHANGELOG": [],
}
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "navbar_align": "left",
    "header_links_before_dropdown": 7,
    "navbar_end": ["theme-switcher"],
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
}
html_context = {"default_mode": "auto"}
