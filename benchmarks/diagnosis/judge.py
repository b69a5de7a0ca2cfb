"""Whether a diagnosis is right, strictly and as a fair judge would have it.

Rows are what `cases.run` returns. Strict: the first cause, or one the diagnosis itself calls equivalent to it, is the hidden
one. Lenient: for effects outside the list, the truth names listed ones that come near; for the stage, any in which the effect
shows.
"""

from typing import Any, NamedTuple

from cases import SHOWS
from comparable import Quantity, quantities

Row = dict[str, Any]
CONFIDENT = 0.9
"""Probability beyond which a wrong name is a confident one."""


class Judgement(NamedTuple):
    """A case, judged.

    Attributes:
        right: strictly.
        lenient: by a fair judge.
        exact: strictly, and without the help of equivalent names; for effects, nothing else named beside it.
        confident_wrong: a name that is wrong was given with confidence.
        confident_wrong_lenient: the same, where a near name is not wrong.
        what: the verdict in words.
        quantities: of rightly named causes.
    """

    right: bool
    lenient: bool
    exact: bool
    confident_wrong: bool
    confident_wrong_lenient: bool
    what: str
    quantities: list[Quantity]


def judge(row: Row) -> Judgement:
    """Judge what ours says of a case."""
    if "ours" not in row:
        return Judgement(False, False, False, False, False, "error", [])
    ours, kind, hidden = row["ours"], row["kind"], list(row["hidden"])
    causes = ours["causes"]
    classes = [{c["name"], *c["equivalent_to"]} for c in causes]
    names = [c["name"] for c in causes]
    near = {n for names_near in row["near"].values() for n in names_near}
    wrong = [c for c, known in zip(causes, classes, strict=True) if not known & set(hidden)]
    confident = any(c["probability"] > CONFIDENT for c in wrong)
    confident_lenient = any(c["probability"] > CONFIDENT and c["name"] not in near for c in wrong)
    found = [
        q
        for c in causes
        if c["name"] in hidden and c["name"] in row["natural"]
        for q in quantities(c["name"], row["natural"][c["name"]], c["parameters"])
    ]
    verdict = ours["verdict"]
    if kind == "nothing":
        right = lenient = exact = verdict == "consistent"
    elif kind == "singles":
        right = lenient = verdict == "effect" and hidden[0] in classes[0]
        exact = names == hidden
    elif kind == "pairs":
        right = lenient = verdict == "effect" and _both(classes, hidden)
        exact = sorted(names) == sorted(hidden)
    else:
        stages = row["visibility"][hidden[0]]
        right = exact = verdict == "unknown" and ours["unknown_stage"] == row["appears_in"][hidden[0]]
        shows = {stage for stage, seen in stages.items() if seen >= SHOWS}
        lenient = (
            right
            or (verdict == "unknown" and ours["unknown_stage"] in shows)
            or (verdict == "effect" and bool(near) and set(names) <= near)
        )
    return Judgement(right, lenient, exact, confident, confident_lenient, worded(row), found)


def _both(classes: list[set[str]], hidden: list[str]) -> bool:
    a, b = hidden
    return any(a in x and b in y for i, x in enumerate(classes) for j, y in enumerate(classes) if i != j)


def worded(row: Row) -> str:
    """Return what ours says in a few words."""
    ours = row["ours"]
    if ours["verdict"] == "unknown":
        partly = f", partly {' + '.join(ours['partial'])}" if ours["partial"] else ""
        return f"unknown in {ours['unknown_stage']}{partly}"
    if ours["verdict"] == "effect":
        return " + ".join(c["name"] for c in ours["causes"])
    return str(ours["verdict"])


def peer_right(row: Row, named: list[str]) -> bool:
    """Judge what a peer names, the surest first; it names nothing where it finds the model consistent."""
    hidden = set(row["hidden"])
    classes = [set(names.split("|")) for names in named]
    if row["kind"] == "nothing":
        return not named
    if row["kind"] == "singles":
        return bool(classes) and hidden <= classes[0]
    return row["kind"] == "pairs" and _both(classes, sorted(hidden))


def strength(row: Row) -> float:
    """Return how far the least of a case's effects stands out."""
    return min((max(stages.values()) for stages in row["visibility"].values()), default=0.0)
