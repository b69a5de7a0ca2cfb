"""Links to files of the repository point to a copy within the site, at the given line.

A link to a folder points to the list of its files.
"""

import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from docutils import nodes
from pygments import highlight
from pygments.lexers import get_lexer_for_filename
from pygments.lexers.special import TextLexer
from pygments.util import ClassNotFound

ROOT = Path(__file__).resolve().parent.parent.parent
SCHEME = "source:"
LINK = re.compile(r"(?<=\]\()(?P<path>[^)#\s:]+)(?P<fragment>#[^)\s]*)?(?=\))")


def setup(app: Any) -> dict[str, bool]:
    """Mark links when a page is read, resolve them when it is written, and write the copies last."""
    app.connect("source-read", mark)
    app.connect("doctree-resolved", resolve)
    app.connect("html-collect-pages", copies)
    return {"parallel_read_safe": True, "parallel_write_safe": False}


def mark(app: Any, page: str, source: list[str]) -> None:
    """Mark links to files outside the site with their own scheme."""

    def marked(link: re.Match[str]) -> str:
        target = (Path(app.srcdir, page).parent / link["path"]).resolve()
        outside = target.exists() and target.is_relative_to(ROOT) and not target.is_relative_to(app.srcdir)
        return f"{SCHEME}{target.relative_to(ROOT)}{link['fragment'] or ''}" if outside else link[0]

    source[0] = LINK.sub(marked, source[0])


def resolve(app: Any, tree: nodes.document, page: str) -> None:
    """Point the marked links to the copies."""
    for reference in tree.findall(nodes.reference):
        target = reference.get("refuri", "")
        if target.startswith(SCHEME):
            path, _, line = target.removeprefix(SCHEME).partition("#")
            linked(app).add(path)
            anchor = f"#{line.replace('L', 'L-')}" if line else ""
            reference["refuri"] = app.builder.get_relative_uri(page, copy_of(path)) + anchor


def copies(app: Any) -> Iterator[tuple[str, dict[str, str], str]]:
    """Yield a page for each linked file."""
    formatter = app.builder.highlighter.get_formatter(linenos="inline", lineanchors="L", wrapcode=True)
    for path in sorted(linked(app)):
        body = listing(ROOT / path) if (ROOT / path).is_dir() else highlight(*lexed(ROOT / path), formatter)
        yield copy_of(path), {"title": path, "body": f"<h1>{path}</h1>{body}"}, "page.html"


def lexed(path: Path) -> tuple[str, Any]:
    """Return a file's text and its lexer."""
    try:
        return path.read_text(encoding="utf-8"), get_lexer_for_filename(path.name)
    except ClassNotFound:
        return path.read_text(encoding="utf-8"), TextLexer()


def listing(folder: Path) -> str:
    """Return the names of a folder's files."""
    return "".join(f"<p><code>{escape(file.name)}</code></p>" for file in sorted(folder.iterdir()))


def linked(app: Any) -> set[str]:
    """Return the files linked so far."""
    if not hasattr(app.builder, "linked_sources"):
        app.builder.linked_sources = set()
    found: set[str] = app.builder.linked_sources
    return found


def copy_of(path: str) -> str:
    """Return the page name of a file's copy."""
    return f"source/{path}"
