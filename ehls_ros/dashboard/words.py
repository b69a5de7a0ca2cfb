"""Foreign texts cut to what a page can show: any participant of the graph may send texts of any length."""

from collections.abc import Iterable, Mapping

NAME = 100
"""Most characters of a name."""

SENTENCE = 500
"""Most characters of a message or value."""

FIGURES = 100
"""Most values of a node."""


def line(text: str, longest: int = SENTENCE) -> str:
    """Return a text as one line of limited length, with unprintable characters replaced.

    Args:
        text: the text.
        longest: most characters kept.
    """
    kept = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text[:longest])
    return kept if len(text) <= longest else f"{kept}…"


def figures(pairs: Iterable[tuple[str, str]]) -> Mapping[str, str]:
    """Return the values by name, at most :data:`FIGURES` of them."""
    kept: dict[str, str] = {}
    for name, value in pairs:
        if len(kept) == FIGURES:
            break
        kept[line(name, NAME)] = line(value)
    return kept
