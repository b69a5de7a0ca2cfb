"""Formulas as MathML, which browsers render natively: no scripts, no external fonts."""

import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging

logger = logging.getLogger(__name__)

UNDER = re.compile(
    r"<munderover>\s*(?P<base><mi>[^<]*</mi>)\s*(?P<index><mi>[^<]*</mi>)\s*(?P<accent><mo [^>]*>[^<]</mo>)\s*</munderover>"
)
"""The converter's output for a letter with accent and index, with the index below the letter."""

INDEXED = r"<msub><mover>\g<base>\g<accent></mover>\g<index></msub>"
ACCENT = ' accent="true"'
"""Without a mathematical font, browsers draw an element so marked into the letter instead of above it."""

DOTS = str.maketrans({"˙": ".", "¨": ".."})


def setup(app: Any) -> dict[str, bool]:
    """Register the renderer under the name ``mathml``."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def inline(translator: Any, node: nodes.math) -> None:
    """Write an inline formula."""
    translator.body.append(mathml(node, as_block=False))
    raise nodes.SkipNode


def block(translator: Any, node: nodes.math_block) -> None:
    """Write a displayed formula."""
    # Without the padding the theme gives each formula a scroll bar.
    translator.body.append(f'<div style="padding: 0.5em 0">{mathml(node, as_block=True)}</div>\n')
    raise nodes.SkipNode


def mathml(node: nodes.Element, *, as_block: bool) -> str:
    """Return a formula's MathML; warn and return nothing if it cannot be parsed."""
    try:
        return UNDER.sub(INDEXED, tex2mathml(node.astext(), as_block=as_block)).replace(ACCENT, "").translate(DOTS)
    except MathError as error:
        logger.warning("formula cannot be parsed: %s", error, location=node)
        return ""
