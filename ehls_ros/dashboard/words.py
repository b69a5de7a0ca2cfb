"""Foreign texts cut to a displayable length: any participant of the graph may send texts of any length."""

from collections.abc import Iterable, Mapping

NAME = 100
"""Maximum length of a name [characters]."""

SENTENCE = 500
"""Maximum length of a message or value [characters]."""

FIGURES = 100
"""Maximum number of values of a node."""


def line(text: str, longest: int = SENTENCE) -> str:
    """Return a text as one line of limited length, with unprintable characters replaced.

    Args:
        text: the text.
        longest: maximum number of characters kept.
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
