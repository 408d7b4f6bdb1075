"""The site of the documentation: `make docs` builds it into out/docs. Nothing is fetched from other hosts."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "docs/_ext")]

project = "rx90_emulator"
copyright = "the rx90_emulator contributors, Apache-2.0"  # noqa: A001 - the name that Sphinx reads
version = release = "0.1.0"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinxarg.ext",
    "sphinx_copybutton",
    "api_text",
    "command_parsers",
    "schemas",
    "mathml",
]
exclude_patterns = ["_ext", "_build"]

myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath", "deflist"]
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_output_stderr = "remove"
nb_ipywidgets_js: dict[str, dict[str, str]] = {}  # of another host, and no notebook has widgets

default_role = "code"
nitpicky = True
# of NumPy and others, whose inventories are on other hosts
nitpick_ignore_regex = [(r"py:.*", r".*")]
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
autodoc_default_options = {
    "members": True,
    "imported-members": True,
    "exclude-members": "__init__,__new__",
}
napoleon_use_ivar = True
python_maximum_signature_line_length = 88

copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True

html_math_renderer = "mathml"
html_theme = "furo"
html_title = "rx90_emulator"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {"top_of_page_buttons": []}
