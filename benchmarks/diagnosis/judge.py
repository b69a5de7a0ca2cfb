"""Assessment of a diagnosis, by a strict and by a lenient judge.

Rows are those returned by `running.run`. Strict: the first cause, or one the diagnosis itself calls equivalent to it, is the
hidden one. Lenient: for an effect outside the list, a listed one that the truth calls near also counts, and any stage in which
the effect shows. A true cause named together with an absent one counts as wrong, for either judge. Where a recording cannot
be diagnosed, right is the refusal that says why.
"""

from typing import NamedTuple

from benchmarks.common import Quantity
from benchmarks.diagnosis.cases import SHOWS
from benchmarks.diagnosis.comparable import quantities
from benchmarks.diagnosis.single_rod import side_of
from benchmarks.rows import Row
from ehls_ros.physics.effects import EFFECTS
from truth_generator.scoring import CONFIDENT, matched

NAMED = ("effect", "partial")
"""Verdicts that name causes."""

REASONS = {"swapped_pressure_sensors": "swapped"}
"""Text in the refusal of a recording with such an effect."""


class Judgement(NamedTuple):
    """The judgement on one case.

    Attributes:
        right: by the strict judge.
        lenient: by the lenient judge.
        first: whether the first causes are right, regardless of further names.
        exact: strictly right, by the causes' exact names, and with no other name.
        confident_wrong: whether a wrong name was given with confidence.
        confident_wrong_lenient: the same, with near names allowed.
        not_there: absent causes named together with a true one.
        what: the verdict in words.
        quantities: those of rightly named causes.
        beliefs: probability of each named cause, its equivalents included, and whether one of them is hidden.
        sides: of each rightly named effect with a side, whether that is right.
    """

    right: bool
    lenient: bool
    first: bool
    exact: bool
    confident_wrong: bool
    confident_wrong_lenient: bool
    not_there: tuple[str, ...]
    what: str
    quantities: list[Quantity]
    beliefs: tuple[tuple[float, bool], ...] = ()
    sides: tuple[bool, ...] = ()


def judge(row: Row) -> Judgement:
    """Judge our diagnosis of a case."""
    if "ours" not in row:
        right = any(name in REASONS and REASONS[name] in row.get("refused", "") for name in row.get("hidden", {}))
        return Judgement(right, right, right, right, False, False, (), "refused" if right else "error", [])
    ours, kind, hidden = row["ours"], row["kind"], list(row["hidden"])
    causes = ours["causes"]
    classes = [{c["name"], *c["equivalent_to"]} for c in causes]
    names = [c["name"] for c in causes]
    near = {n for names_near in row["near"].values() for n in names_near}
    true = matched(names, classes, hidden)
    wrong = [c for i, c in enumerate(causes) if i not in true]
    not_there = tuple(c["name"] for c in wrong) if true else ()
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
        first = right = exact = verdict == "consistent"
        # To judge nothing, with the reason, is no alarm.
        lenient = verdict in ("consistent", "insufficient")
    elif kind in ("singles", "pairs"):
        first = verdict in NAMED and (hidden[0] in classes[0] if kind == "singles" else len(true) == len(hidden))
        right = lenient = first and not not_there
        exact = sorted(names) == sorted(hidden)
    else:
        stages = row["visibility"][hidden[0]]
        # A listed effect may explain most of an unlisted one: it may be named, but not as certain.
        unexplained = verdict == "unknown" or (verdict == "partial" and not confident)
        first = right = unexplained and ours["unknown_stage"] == row["appears_in"][hidden[0]]
        exact = right and verdict == "unknown"
        shows = {stage for stage, seen in stages.items() if seen >= SHOWS}
        lenient = (
            right
            or (unexplained and ours["unknown_stage"] in shows)
            or (verdict == "effect" and bool(near) and set(names) <= near)
        )
    beliefs = tuple((min(1.0, c["probability"] * (1 + len(c["equivalent_to"]))), i in true) for i, c in enumerate(causes))
    sides = tuple(
        cause["side"] == side
        for name in hidden
        if (side := side_of(name, row["hidden"])) is not None
        for cause in [c for i, c in enumerate(causes) if i in true and name in classes[i]][:1]
    )
    return Judgement(right, lenient, first, exact, confident, confident_lenient, not_there, worded(row), found, beliefs, sides)


def closed_off(row: Row) -> float | None:
    """Return the deviation of the error fraction explained by the causes from its true share; None if none is named rightly."""
    if not judge(row).first or row.get("share") is None or row["ours"]["gain"] is None:
        return None
    return float(row["ours"]["gain"]["closed_fraction"] - row["share"])


def worded(row: Row) -> str:
    """Return our verdict in a few words."""
    ours = row["ours"]
    if ours["verdict"] == "unknown":
        partly = f", partly {' + '.join(ours['partial'])}" if ours["partial"] else ""
        return f"unknown in {ours['unknown_stage']}{partly}"
    if ours["verdict"] == "partial":
        return f"{' + '.join(c['name'] for c in ours['causes'])}, and more"
    if ours["verdict"] == "effect":
        return " + ".join(c["name"] for c in ours["causes"])
    return str(ours["verdict"])


def peer_right(row: Row, named: list[str]) -> bool:
    """Judge the names a peer gives, the surest first; an empty list means that it finds the model consistent."""
    if row["kind"] == "outside":
        return False
    hidden = sorted(row["hidden"])
    return len(named) == len(hidden) == len(matched(named, [set(names.split("|")) for names in named], hidden))


def below_power(row: Row) -> bool:
    """Return whether all that is named is right, and each hidden effect not named is rightly said not to be seen.

    It is below the size said to be detectable, or shows only in stages of which the answer says why they are not judged.
    """
    if row.get("ours", {}).get("verdict") not in ("consistent", "effect", "insufficient"):
        return False
    causes = row["ours"]["causes"]
    classes = [{c["name"], *c["equivalent_to"]} for c in causes]
    if len(matched([c["name"] for c in causes], classes, list(row["hidden"]))) < len(causes):
        return False
    missed = [name for name in row["hidden"] if not any(name in names for names in classes)]
    return all(_below(row, name) or _not_judged(row, name) for name in missed)


def _not_judged(row: Row, name: str) -> bool:
    told = {text.partition(":")[0] for text in row["ours"]["missing"]}
    return {stage for stage, seen in row["visibility"].get(name, {}).items() if seen >= SHOWS} <= told


def _below(row: Row, name: str) -> bool:
    # Told are changes, and compared are values.
    neutral = EFFECTS.load(name).Parameters()._asdict() if name in EFFECTS.names() else {}
    told = [(p, size) for effect, p, size in row["ours"].get("sensitivities", ()) if effect == name]
    detectable = {p: [neutral[p] + size, 0.0] for p, size in told}
    if name not in row["natural"] or not detectable:
        return False
    return any(abs(q.true) < abs(q.value) for q in quantities(name, row["natural"][name], detectable))


def strength(row: Row) -> float:
    """Return the visibility of a case's least visible effect, relative to the noise."""
    return min((max(stages.values()) for stages in row["visibility"].values()), default=0.0)
