"""The documentation site; `make docs` builds it into build/docs/.

Sphinx, as in ROS's rosdoc2, with MyST, so that the pages are the repository's Markdown files. The site loads nothing external.
"""

import sys
from pathlib import Path

from ehls_ros import __version__

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "ehls_ros"
copyright = "ehls_ros maintainers"  # noqa: A001 - Sphinx's name for it
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "mathml",
    "reference_pages",
    "source_links",
]
exclude_patterns = ["pictures"]

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
myst_url_schemes = ["http", "https", "source"]

autodoc_typehints = "description"
autodoc_member_order = "bysource"

copybutton_selector = "div:not(.highlight-text) > div.highlight > pre"  # output is not for copying
copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True

html_theme = "furo"
html_theme_options = {"dark_css_variables": {"sd-color-card-border": "#4a4e54"}}
html_title = f"ehls_ros {__version__}"
html_math_renderer = "mathml"
html_copy_source = False
