"""Configuration of the documentation site: `make docs` builds it into out/site, warnings being errors."""

from __future__ import annotations

import sys
from importlib.metadata import version as installed
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "Mantis"
author = "The Mantis developers"
copyright = author
version = release = installed("mantis-radiometry")

extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "myst_nb", "mantis_docs"]
exclude_patterns = ["_ext", "_build"]

html_theme = "furo"
html_title = "Mantis"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_math_renderer = "mathml"  # of mantis_docs: formulas need no script and no network

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
# The notebook is stored without outputs, and run whenever the site is built.
nb_execution_mode = "force"
nb_execution_timeout = 120
nb_execution_raise_on_error = True
nb_execution_show_tb = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
smartquotes = False  # which would turn --options into dashes
# In docstrings a bare `name` is code.
default_role = "code"

suppress_warnings = [
    "myst.header",  # pages that studies write may skip a level
]
