"""How Sphinx builds the pages of this folder: `make docs`."""

from __future__ import annotations

from typing import Any

from twinmatch import __version__

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

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints_format = "short"
autodoc_type_aliases = {"ArrayLike": "ArrayLike", "FloatArray": "FloatArray"}
python_maximum_signature_line_length = 100
# Docstrings write code between single backticks.
default_role = "literal"


def _read_docstring(
    _app: Any, what: str, _name: str, _object: Any, _options: Any, lines: list[str]
) -> None:
    """Let |u| be a magnitude, not a substitution, and a colon in a field's text a colon, not a type."""
    for number, line in enumerate(lines):
        parts = line.split("`")  # every other one is code
        parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
        lines[number] = "`".join(parts)
    if what in {"attribute", "data", "property"}:
        lines[:0] = [
            "..",
            "",
        ]  # an empty comment: napoleon takes the first line up to a colon for a type


def setup(app: Any) -> None:
    """Hook into Sphinx."""
    app.connect(
        "autodoc-process-docstring", _read_docstring, priority=400
    )  # before napoleon
