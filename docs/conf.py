"""Sphinx configuration: Markdown pages and executed notebooks through MyST."""

from jaxsph.versions import __version__

project = "jaxsph"
author = "The jaxsph developers"
copyright = "2026, The jaxsph developers"
release = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
nb_execution_mode = "off"  # notebooks are stored executed: what a reader sees is what was run and committed
exclude_patterns = ["_build", "results"]
autodoc_member_order = "bysource"
html_theme = "alabaster"
