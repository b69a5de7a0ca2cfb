"""What others say is cut down to what a page can show: whoever is on the graph may send texts of any length and kind."""

from collections.abc import Iterable, Mapping

NAME = 100
"""Characters of a name that are shown."""

SENTENCE = 500
"""Characters of a sentence or value that are shown."""

FIGURES = 100
"""Figures of a node that are shown."""


def line(text: str, longest: int = SENTENCE) -> str:
    """Return a text as one line that is not too long: what cannot be printed is replaced, the rest left out.

    Args:
        text: what was said.
        longest: characters that are kept.
    """
    kept = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text[:longest])
    return kept if len(text) <= longest else f"{kept}…"


def figures(pairs: Iterable[tuple[str, str]]) -> Mapping[str, str]:
    """Return figures by name, as many as are shown."""
    kept: dict[str, str] = {}
    for name, value in pairs:
        if len(kept) == FIGURES:
            break
        kept[line(name, NAME)] = line(value)
    return kept
