"""How Sphinx builds these pages; `python -m sphinx -W docs docs/build/html` does."""

import sys
from pathlib import Path

import jax

import softcal_jax

jax.config.update("jax_enable_x64", True)  # project files are loaded for their messages
sys.path.insert(0, str(Path(__file__).parent / "_ext"))
sys.path.insert(0, str(Path(__file__).parents[1]))  # benchmarks

project = "softcal_jax"
author = "The softcal_jax maintainers"
version = release = softcal_jax.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx-mathjax-offline",  # a copy of MathJax within the pages
    "from_code",
    "messages",
    "records",
]
exclude_patterns = ["build", "_ext"]

# Pages need no network: no widgets, no fonts, no scripts from elsewhere.
nb_ipywidgets_js = {}
nb_execution_mode = "off"  # shown with the outputs that are committed
myst_enable_extensions = ["attrs_block", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
# With MathJax 3, which `sphinx-mathjax-offline` carries.
mathjax3_config = {"tex": {"macros": {"hat": [r"\widehat{#1}", 1]}}}

# Docstrings: names in `backticks` are links where they are names of the package.
default_role = "py:obj"
toc_object_entries_show_parents = "hide"
autodoc_default_options = {
    "imported-members": True
}  # a package offers its modules' names
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
nitpick_ignore_regex = [
    ("py:obj", ".*"),  # backticks hold formulas and arguments, too
    ("py:.*", r"(?!softcal_jax).*"),  # pages of other packages are not at hand
    ("py:class", r"softcal_jax(\.\w+)*\._.*"),  # types that no package offers
]

html_theme = "pydata_sphinx_theme"
html_title = "softcal_jax"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "header_links_before_dropdown": 6,
    "navigation_with_keys": False,
    "show_prev_next": True,
    # The plots of the records take the whole width.
    "secondary_sidebar_items": {"**": ["page-toc"], "evidence/records": []},
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_context = {"default_mode": "auto"}
copyright = "The softcal_jax maintainers, Apache-2.0"
