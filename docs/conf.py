"""How Sphinx builds the pages of this folder: `make docs`."""

from __future__ import annotations

from typing import Any

from twinmatch import __version__, reporting

project = "twinmatch"
author = "The twinmatch authors"
copyright = author
version = release = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = f"twinmatch {version}"

# Headings can be linked to as on a forge.
myst_heading_anchors = 3
# The notebook was executed when it was written, and a test compares.
nb_execution_mode = "off"

autodoc_default_options = {"members": True, "imported-members": True, "member-order": "bysource"}
autodoc_typehints = "description"
autodoc_class_signature = "separated"
# Docstrings write code between single backticks.
default_role = "literal"


def _escape_bars(*arguments: Any) -> None:
    """Let |u| in a docstring be a magnitude, not a substitution."""
    lines: list[str] = arguments[-1]
    for number, line in enumerate(lines):
        parts = line.split("`")  # every other one is code
        parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
        lines[number] = "`".join(parts)


for _name in reporting.__all__:  # which it fetches when they are used; autodoc only looks at what is there
    setattr(reporting, _name, getattr(reporting, _name))


def setup(app: Any) -> None:
    """Hook into Sphinx."""
    app.connect("autodoc-process-docstring", _escape_bars)
