"""The documentation site: sphinx-build -W --keep-going -n docs docs/_build."""

import sys
from importlib.metadata import distribution
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]

project = "sim_heating"
author = "the authors of sim_heating"
release = version = distribution("sim-heating").version
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "site_pages"]
exclude_patterns = ["_build", "_ext"]
default_role = "code"
highlight_language = "none"
nitpicky = True
nitpick_ignore_regex = [("py:.*", r".*")]  # annotations name classes that are not public, and have no page

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 80

# MathJax in one file that needs no fonts, so that equations are drawn without a network.
_mathjax = "sphinx-mathjax-offline/static/mathjax/tex-svg.js"
html_static_path = [str(distribution("sphinx-mathjax-offline").locate_file(_mathjax)), "_static"]
mathjax_path = "tex-svg.js"

html_theme = "furo"
html_css_files = ["site.css"]
html_title = f"sim_heating {release}"
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
