"""Answers to the public exam: their form, and the points they get.

An answer names the hidden effects, or the stage of an error that no listed effect explains. Rules:

* nothing hidden: right is the verdict `consistent`;
* one or two listed effects: right is the verdict `effect` with as many causes, each of which has a hidden effect among its
  names. A cause may have several names if the data cannot separate them, at most `MOST_NAMES`;
* an effect outside the list: right is the verdict `unknown` with the stage in which the effect appears.

A wrong name counts as confident from `CONFIDENT` on; a cause without a probability is certain. For effects outside the list,
the names that the truth calls near are not wrong.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import Any, NamedTuple

from .cases import KINDS
from .effects import LISTED, STAGES

VERDICTS = ("consistent", "effect", "unknown")
CONFIDENT = 0.9
MOST_NAMES = 4

SCHEMA: dict[str, Any] = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "Answers to the exam of truth_generator",
    "type": "object",
    "required": ["entrant", "exam", "answers"],
    "properties": {
        "entrant": {"type": "string", "minLength": 1, "description": "name of the method, with its version"},
        "exam": {"type": "string", "description": "the `exam` of exam.json, such as 1-38001"},
        "answers": {
            "type": "object",
            "description": "one answer for each case, by the name of its folder",
            "additionalProperties": {
                "type": "object",
                "required": ["verdict"],
                "additionalProperties": False,
                "properties": {
                    "verdict": {"enum": list(VERDICTS)},
                    "causes": {
                        "type": "array",
                        "maxItems": 8,
                        "description": "for `effect`: the causes, each by its name or by names that cannot be separated",
                        "items": {
                            "type": "object",
                            "required": ["names"],
                            "additionalProperties": False,
                            "properties": {
                                "names": {
                                    "type": "array",
                                    "minItems": 1,
                                    "maxItems": MOST_NAMES,
                                    "items": {"enum": sorted(LISTED)},
                                },
                                "probability": {"type": "number", "minimum": 0, "maximum": 1},
                            },
                        },
                    },
                    "stage": {"enum": [*STAGES, None], "description": "for `unknown`: where the error appears"},
                    "seconds": {"type": "number", "minimum": 0, "description": "time of computation [s]"},
                },
            },
        },
    },
}
"""JSON schema of the answers."""


class Points(NamedTuple):
    """Points of one answer.

    Attributes:
        kind: kind of the case.
        right: whether it is right.
        named: number of causes named.
        confident_wrong: whether a wrong name was given with confidence.
    """

    kind: str
    right: bool
    named: int
    confident_wrong: bool


class Line(NamedTuple):
    """One kind of cases in the score.

    Attributes:
        kind: the kind; "all" for all cases.
        cases: their number.
        right: number of right answers.
        low, high: 95 % interval of the share of right answers, by Wilson.
        confident_wrong: cases in which a wrong name was given with confidence.
    """

    kind: str
    cases: int
    right: int
    low: float
    high: float
    confident_wrong: int


def matched(names: Sequence[str], classes: Sequence[set[str]], hidden: Sequence[str]) -> set[int]:
    """Return the causes that match hidden effects, one for each: as many as possible, exact names first.

    Args:
        names: the first name of each cause.
        classes: all names of each cause.
        hidden: the hidden effects.
    """
    best: tuple[int, int, set[int]] = (0, 0, set())
    for order in permutations([*range(len(names)), *[-1] * len(hidden)], len(hidden)):
        true = {i for i, effect in zip(order, hidden, strict=True) if i >= 0 and effect in classes[i]}
        own = sum(i >= 0 and names[i] == effect for i, effect in zip(order, hidden, strict=True))
        best = max(best, (len(true), own, true), key=lambda found: found[:2])
    return best[2]


def checked(answers: Any) -> dict[str, Any]:
    """Return the content of a file of answers.

    Raises:
        ValueError: it has another form than `SCHEMA`; the message names the place.
    """
    if not isinstance(answers, dict) or not isinstance(answers.get("answers"), dict):
        raise ValueError("the answers are no object with an object `answers`, one entry for each case")  # noqa: TRY004 - content
    for key in ("entrant", "exam"):
        if not isinstance(answers.get(key), str) or not answers[key]:
            raise ValueError(f"`{key}` is {answers.get(key)!r}: a text is expected")
    for case, answer in answers["answers"].items():
        if not isinstance(answer, dict) or answer.get("verdict") not in VERDICTS:
            raise ValueError(f"{case}: the verdict is none of {', '.join(VERDICTS)}")
        if unknown := set(answer) - {"verdict", "causes", "stage", "seconds"}:
            raise ValueError(f"{case}: {', '.join(sorted(unknown))} is not part of an answer")
        if answer.get("stage") not in (*STAGES, None):
            raise ValueError(f"{case}: the stage is {answer['stage']!r}: none of {', '.join(STAGES)}")
        for cause in answer.get("causes", []):
            names = cause.get("names") if isinstance(cause, dict) else None
            if not isinstance(names, list) or not 1 <= len(names) <= MOST_NAMES or set(names) - set(LISTED):
                raise ValueError(f"{case}: a cause has the names {names!r}: 1 to {MOST_NAMES} listed effects are expected")
            probability = cause.get("probability", 1.0)
            if not isinstance(probability, int | float) or not 0.0 <= probability <= 1.0:
                raise ValueError(f"{case}: a probability is {probability!r}: 0 to 1 is expected")
    return answers


def points(answer: Mapping[str, Any] | None, truth: Mapping[str, Any]) -> Points:
    """Return the points of an answer; a case without an answer is wrong.

    Args:
        answer: the answer.
        truth: the case's entry of truth.json.
    """
    kind, hidden = truth["kind"], list(truth["hidden"])
    if answer is None:
        return Points(kind, False, 0, False)
    causes = answer.get("causes", []) if answer["verdict"] == "effect" else []
    classes = [set(cause["names"]) for cause in causes]
    true = matched([cause["names"][0] for cause in causes], classes, hidden)
    fair = set(truth["near"]) if kind == "outside" else set()
    wrong = [cause for i, cause in enumerate(causes) if i not in true and not classes[i] & fair]
    confident = any(cause.get("probability", 1.0) > CONFIDENT for cause in wrong)
    if kind == "nothing":
        right = answer["verdict"] == "consistent"
    elif kind == "outside":
        right = answer["verdict"] == "unknown" and answer.get("stage") == truth["stage"]
    else:
        right = answer["verdict"] == "effect" and len(true) == len(hidden) == len(causes)
    return Points(kind, right, len(causes), confident)


def score(answers: Mapping[str, Any], truth: Mapping[str, Mapping[str, Any]]) -> list[Line]:
    """Return the score of an entrant, by kind and for all cases.

    Args:
        answers: by case.
        truth: by case.
    """
    got = [points(answers.get(case), entry) for case, entry in truth.items()]
    out = []
    for kind in (*KINDS, "all"):
        own = [p for p in got if kind in (p.kind, "all")]
        right = sum(p.right for p in own)
        out.append(Line(kind, len(own), right, *wilson(right, len(own)), sum(p.confident_wrong for p in own)))
    return out


def wilson(right: int, cases: int) -> tuple[float, float]:
    """Return the 95 % interval of a share."""
    if cases == 0:
        return 0.0, 1.0
    z, share = 1.96, right / cases
    middle = (share + z * z / (2 * cases)) / (1.0 + z * z / cases)
    half = z * math.sqrt(share * (1.0 - share) / cases + z * z / (4 * cases * cases)) / (1.0 + z * z / cases)
    return max(middle - half, 0.0), min(middle + half, 1.0)
