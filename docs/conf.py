"""The documentation site; `make docs` builds it into build/docs/.

Sphinx, as in ROS's rosdoc2, with MyST, so that the pages are the repository's Markdown files. The site loads nothing external.
"""

import os
import sys
from pathlib import Path

from ehls_ros import __version__
from ehls_ros.sources import sources_digest

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "ehls_ros"
copyright = "ehls_ros maintainers"  # noqa: A001 - Sphinx's name for it
version = release = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "mathml",
    "notebooks",
    "reference_pages",
    "source_links",
]
exclude_patterns = ["pictures"]

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
myst_url_schemes = ["http", "https", "source"]

# Notebooks are executed, and again once the package has changed; their figures are drawn by a plotly.js within the page.
nb_execution_mode = "cache"
nb_execution_cache_path = str(Path(__file__).parent.parent / "build" / "notebooks" / sources_digest("")[:12])
nb_execution_in_temp = True
nb_execution_show_tb = True
nb_execution_timeout = 600
nb_merge_streams = True
os.environ["PLOTLY_RENDERER"] = "notebook"

autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"  # a record's fields are told once
autodoc_member_order = "bysource"

copybutton_selector = "div:not(.highlight-text) > div.highlight > pre"  # output is not for copying
copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True

html_theme = "furo"
html_theme_options = {"dark_css_variables": {"sd-color-card-border": "#4a4e54"}}
html_title = f"ehls_ros {__version__}"
html_math_renderer = "mathml"
html_copy_source = False
