"""Outputs of notebooks load nothing external, and wide ones scroll by themselves instead of the page.

Plotly's HTML asks for MathJax, which no figure here needs.
"""

import re
from pathlib import Path
from typing import Any

from docutils import nodes

EXTERNAL = re.compile(r'<script[^>]*\bsrc="https?://[^>]*></script>')


def setup(app: Any) -> dict[str, bool]:
    """Look at each page once its outputs are chosen, and add the style of outputs."""
    app.connect("doctree-resolved", without_external)
    app.connect(
        "builder-inited", lambda app: app.config.html_static_path.append(str(Path(__file__).with_name("notebooks_static")))
    )
    app.add_css_file("notebooks.css")
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def without_external(app: Any, tree: nodes.document, page: str) -> None:
    """Remove external scripts from outputs."""
    for raw in tree.findall(nodes.raw):
        if "<script" in raw.astext():
            raw[:] = [nodes.Text(EXTERNAL.sub("", raw.astext()))]
