"""Whether a diagnosis is right, strictly and as a fair judge would have it.

Rows are what `cases.run` returns. Strict: the first cause, or one the diagnosis itself calls equivalent to it, is the hidden
one. Lenient: for an effect outside the list, a listed one that the truth calls near also counts, and any stage in which the
effect shows. A true cause that is named together with one that is not there counts as right, and is counted again separately.
"""

from typing import Any, NamedTuple

from benchmarks.diagnosis.cases import SHOWS
from benchmarks.diagnosis.comparable import Quantity, quantities

Row = dict[str, Any]
CONFIDENT = 0.9
"""Probability above which a wrong name is a confident one."""


class Judgement(NamedTuple):
    """The judgement on one case.

    Attributes:
        right: by the strict judge.
        lenient: by the fair judge.
        exact: strictly right, by the causes' own names, and nothing else named.
        confident_wrong: whether a wrong name was given with confidence.
        confident_wrong_lenient: the same, with near names allowed.
        not_there: causes named together with a true one although they are not there.
        what: the verdict in words.
        quantities: those of rightly named causes.
    """

    right: bool
    lenient: bool
    exact: bool
    confident_wrong: bool
    confident_wrong_lenient: bool
    not_there: tuple[str, ...]
    what: str
    quantities: list[Quantity]


def judge(row: Row) -> Judgement:
    """Judge our diagnosis of a case."""
    if "ours" not in row:
        return Judgement(False, False, False, False, False, (), "error", [])
    ours, kind, hidden = row["ours"], row["kind"], list(row["hidden"])
    causes = ours["causes"]
    classes = [{c["name"], *c["equivalent_to"]} for c in causes]
    names = [c["name"] for c in causes]
    near = {n for names_near in row["near"].values() for n in names_near}
    wrong = [c for c, known in zip(causes, classes, strict=True) if not known & set(hidden)]
    not_there = tuple(c["name"] for c in wrong) if len(wrong) < len(causes) else ()
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
    return Judgement(right, lenient, exact, confident, confident_lenient, not_there, worded(row), found)


def _both(classes: list[set[str]], hidden: list[str]) -> bool:
    a, b = hidden
    return any(a in x and b in y for i, x in enumerate(classes) for j, y in enumerate(classes) if i != j)


def worded(row: Row) -> str:
    """Return our verdict in a few words."""
    ours = row["ours"]
    if ours["verdict"] == "unknown":
        partly = f", partly {' + '.join(ours['partial'])}" if ours["partial"] else ""
        return f"unknown in {ours['unknown_stage']}{partly}"
    if ours["verdict"] == "effect":
        return " + ".join(c["name"] for c in ours["causes"])
    return str(ours["verdict"])


def peer_right(row: Row, named: list[str]) -> bool:
    """Judge the names a peer gives, the surest first; none means that it finds the model consistent."""
    hidden = set(row["hidden"])
    classes = [set(names.split("|")) for names in named]
    if row["kind"] == "nothing":
        return not named
    if row["kind"] == "singles":
        return bool(classes) and hidden <= classes[0]
    return row["kind"] == "pairs" and _both(classes, sorted(hidden))


def strength(row: Row) -> float:
    """Return how far the least visible of a case's effects stands out of the noise."""
    return min((max(stages.values()) for stages in row["visibility"].values()), default=0.0)
