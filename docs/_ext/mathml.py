"""Formulas as MathML by latex2mathml, which browsers render natively: no scripts, no external fonts."""

from typing import Any

from docutils import nodes
from latex2mathml.converter import convert


def setup(app: Any) -> dict[str, bool]:
    """Register the renderer under the name ``mathml``."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def inline(translator: Any, node: nodes.math) -> None:
    """Write an inline formula."""
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def block(translator: Any, node: nodes.math_block) -> None:
    """Write a displayed formula; one wider than the page scrolls by itself."""
    formula = convert(node.astext(), display="block")
    translator.body.append(f'<div style="padding: 0.5em 0; overflow-x: auto">{formula}</div>\n')
    raise nodes.SkipNode
