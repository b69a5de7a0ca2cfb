"""Assessment of the modes: the named cause, and the size with its interval, against the hidden change.

A name is right if the first cause, or one that the package calls equivalent to it, is the true effect. A size is judged if one
is told for the true effect. Sizes are changes: relative for factors, otherwise in SI units. Without baselines, a diagnosis may
also name what distinguishes every stranger from the model, and leave a remainder unexplained.
"""

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

from benchmarks.common import Quantity
from benchmarks.rows import Row

INTERVAL = 1.96
"""Half width of a 95 % interval in standard errors."""

OWN = frozenset((
    "valve_hysteresis", "valve_second_order", "valve_bandwidth_shift", "valve_dead_zone", "command_delay",
    "supply_pressure_droop", "entrained_air", "turbulent_leakage", "coulomb_asymmetry",
))  # fmt: skip
"""Effects that every stranger may have from the beginning, as far as its identified rig file lacks them."""

Verdict = Literal["right", "wrong", "missed", "quiet", "false alarm", "error"]


class Change(NamedTuple):
    """How the package calls a hidden change.

    Attributes:
        effects: names of the effects that are right; the first has the size.
        parameters: parameters of that effect, any of which is the size.
        path: coefficient in a rig file; empty if no coefficient has this size.
        reading: coefficient of the monitor; empty if it has none.
        relative: whether the size is a factor less 1.
        beside: a coefficient that shares the change if the spool is not recorded.
    """

    effects: tuple[str, ...]
    parameters: tuple[str, ...]
    path: str = ""
    reading: str = ""
    relative: bool = False
    beside: str = ""


CHANGES: Mapping[str, Change] = {
    "leakage": Change(("internal_leakage_shift",), ("added",), "plant.leakage_coefficient", "leakage_coefficient"),
    "bulk_modulus": Change(("bulk_modulus_shift",), ("factor",), "plant.bulk_modulus", "bulk_modulus", relative=True),
    "coulomb": Change(("coulomb_shift",), ("offset",), "friction.coulomb_force", "coulomb_force"),
    "viscous": Change(("viscous_shift",), ("added",), "friction.viscous_coefficient", "viscous_coefficient"),
    "mass": Change(("mass_shift",), ("factor",), "plant.moving_mass", "moving_mass", relative=True),
    "flow_gain": Change(
        ("valve_gain_shift",), ("flow_gain", "gain"), "plant.discharge_coefficient", "discharge_coefficient", True,
        "plant.valve_gain",
    ),
    "valve_null": Change(("valve_null_bias",), ("command", "opening"), "effects.valve_null_bias.command", "valve_null"),
    # Where the supply pressure is not recorded, a change of it has nearly the effect of one of the flow gain.
    "supply_pressure": Change(
        ("supply_pressure_shift", "supply_pressure_droop", "valve_gain_shift"), ("factor",), "plant.supply_pressure", "", True
    ),
    "pressure_gain": Change(("pressure_sensor_gain",), ("gain",), "", "pressure_sensor_gain", relative=True),
    "pressure_bias": Change(("pressure_sensor_bias",), ("bias",), "", "pressure_sensor_bias"),
    "spring": Change(("spring_rate_shift",), ("added",), "plant.spring_stiffness", "spring_stiffness"),
}  # fmt: skip
"""Hidden changes by kind."""


class Judgement(NamedTuple):
    """The judgement on one stranger in one mode.

    Attributes:
        verdict: the name, or the absence of one, against the truth.
        visible: whether the change is above the size that the mode says it would have seen; None if it does not say.
        size: the size told for the true effect; None if it tells none.
        why_not: why there is none.
        words: the answer in words.
    """

    verdict: Verdict
    visible: bool | None
    size: Quantity | None
    why_not: str
    words: str


def judge(row: Row, mode: str) -> Judgement | None:
    """Judge a mode's answer; None if it was not run."""
    given = row.get(mode)
    if given is None:
        return None
    if "error" in given:
        return Judgement("error", None, None, given["error"].strip().splitlines()[-1], "error")
    if mode == "identify":
        return _identified(row, given)
    if mode == "monitor":
        return _named(row, [c for change in given["changes"][:1] for c in change["causes"]], *_stage(given["changes"]), None)
    unknown = given["unknown_stage"] if given["verdict"] in ("unknown", "partial") else None
    if mode == "alone":
        changes = [c for c in given["causes"] if c["name"] not in OWN]
        return _named(row, changes, "effect" if changes else "consistent", None, given["power"])
    return _named(row, given["causes"], given["verdict"], unknown, given["power"])


def _stage(changes: list[dict[str, Any]]) -> tuple[str, str | None]:
    if not changes:
        return "quiet", None
    return ("effect", None) if changes[0]["causes"] else ("unknown", changes[0]["stage"])


def _named(
    row: Row, causes: list[dict[str, Any]], verdict: str, unknown: str | None, power: Mapping[str, Any] | None
) -> Judgement:
    words = " + ".join(f"{c['name']} {_sizes(c)} p={c['probability']:.2g}" for c in causes) or verdict
    words += f" (unknown in {unknown})" if unknown else ""
    alarm = bool(causes) or verdict in ("unknown", "partial", "effect")
    if not row["kind"]:
        return Judgement("false alarm" if alarm else "quiet", None, None, "", words)
    change, true = CHANGES[row["kind"]], row["size"]
    visible = None
    if power is not None and change.effects[0] in power:
        parameter, smallest = power[change.effects[0]]
        visible = parameter in change.parameters and abs(true) >= abs(smallest)
    if not alarm:
        return Judgement("missed", visible, None, verdict, words)
    first = {causes[0]["name"], *causes[0]["equivalent_to"]} if causes else set[str]()
    right = bool(first & set(change.effects))
    size = None
    for cause in causes[:1]:
        if cause["name"] == change.effects[0]:
            told = [cause["parameters"][name] for name in change.parameters if name in cause["parameters"]]
            size = Quantity(row["kind"], true, told[0][0] - (1.0 if change.relative else 0.0), told[0][1]) if told else None
    return Judgement("right" if right else "wrong", visible, size, "" if size else "named otherwise", words)


def _sizes(cause: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value:.3g}±{std:.1g}" for name, (value, std) in cause["parameters"].items())


def _identified(row: Row, given: Mapping[str, Any]) -> Judgement | None:
    """Judge the difference of two identifications: an alarm is a difference beyond five standard errors."""
    beyond = []
    for change in CHANGES.values():
        told = difference(row, change) if change.path else None
        if told is not None and abs(told[0]) > 5.0 * told[1]:
            beyond.append((abs(told[0]) / told[1], change.path.rpartition(".")[2], told))
    beyond.sort(reverse=True)
    words = ", ".join(f"{name} {value:.3g}±{std:.1g}" for _, name, (value, std) in beyond[:3]) or "no difference"
    if not row["kind"]:
        return Judgement("false alarm" if beyond else "quiet", None, None, "", words)
    change = CHANGES[row["kind"]]
    if not change.path:
        return None
    told = difference(row, change)
    right = bool(beyond) and beyond[0][1] == change.path.rpartition(".")[2]
    verdict: Verdict = "right" if right else "wrong" if beyond else "missed"
    if told is None:
        why = next(
            (
                given[w]["not_identifiable"][change.path]
                for w in ("before", "after")
                if change.path in given[w]["not_identifiable"]
            ),
            "",
        )
        return Judgement(verdict, None, None, why or "not told", words)
    return Judgement(verdict, None, Quantity(row["kind"], row["size"], *told), "", words)


def difference(row: Row, change: Change) -> tuple[float, float] | None:
    """Return the change of a coefficient between two identifications with its standard error; None if one does not tell it."""
    if "spool_m" in row["signals"]:
        change = change._replace(beside="")
    before, after = (_value(row["identify"][when], change) for when in ("before", "after"))
    if before is None or after is None:
        return None
    if not change.relative:
        return after[0] - before[0], math.hypot(after[1], before[1])
    ratio = after[0] / before[0]
    return ratio - 1.0, ratio * math.hypot(after[1] / after[0], before[1] / before[0])


def _value(given: Mapping[str, Any], change: Change) -> tuple[float, float] | None:
    known = {**given["absent"], **given["estimates"]}
    # A coefficient that is not significant is absent from the rig: its value is 0 there.
    own = known.get(change.path)
    if own is None:
        return None
    other = known.get(change.beside)
    if other is None:
        return float(own[0]), float(own[1])
    return own[0] * other[0], own[0] * other[0] * math.hypot(own[1] / own[0], other[1] / other[0])


def reading(row: Row) -> Quantity | None:
    """Return the change in the monitor's table of coefficients since the identification before; None if it tells none."""
    change = CHANGES.get(row["kind"])
    monitor, identified = row.get("monitor", {}), row.get("identify", {})
    if change is None or "readings" not in monitor or "before" not in identified or change.reading not in monitor["readings"]:
        return None
    value, std, why_not = monitor["readings"][change.reading]
    if why_not or std is None:
        return None
    if not change.path:
        return Quantity(row["kind"], row["size"], value - (1.0 if change.relative else 0.0), std)
    before = _value(identified["before"], change._replace(beside=""))
    if before is None:
        return None
    if change.relative:
        ratio = value / before[0]
        return Quantity(row["kind"], row["size"], ratio - 1.0, ratio * math.hypot(std / value, before[1] / before[0]))
    return Quantity(row["kind"], row["size"], value - before[0], math.hypot(std, before[1]))


ABSOLUTE: Mapping[str, tuple[str, str]] = {
    "mass": ("plant.moving_mass", "moving_mass"),
    "spring": ("plant.spring_stiffness", "spring_stiffness"),
    "coulomb": ("friction.coulomb_force", "coulomb_force"),
}
"""Coefficients whose values are those of the true rig, by the truth's names: path in a rig file, reading of the monitor."""


def absolutes(row: Row) -> list[tuple[str, str, Quantity]]:
    """Return source, coefficient and size of each value that can be compared with the truth as it is."""
    out = []
    for name, (path, told) in ABSOLUTE.items():
        if name == "spring" and row["true"]["before"]["counterpart"]:
            continue
        for when in ("before", "after"):
            estimate = row.get("identify", {}).get(when, {}).get("estimates", {}).get(path)
            if estimate and row["true"][when][name]:
                out.append(("identify", name, Quantity(name, row["true"][when][name], *estimate)))
        value, std, why_not = row.get("monitor", {}).get("readings", {}).get(told, (0.0, None, "not told"))
        if not why_not and std is not None and row["true"]["after"][name]:
            out.append(("monitor", name, Quantity(name, row["true"]["after"][name], value, std)))
    return out


def unchanged(row: Row) -> list[tuple[str, float]]:
    """Return the difference, in standard errors, of each coefficient that did not change between two identifications."""
    given = row.get("identify", {})
    if "before" not in given:
        return []
    own = CHANGES[row["kind"]].path if row["kind"] else ""
    if row["kind"] in ("pressure_gain", "pressure_bias"):
        # Every coefficient of the forces follows the sensor.
        return []
    out = []
    for change in CHANGES.values():
        if change.path and change.path != own:
            told = difference(row, change)
            if told is not None:
                out.append((change.path, told[0] / told[1] if told[1] else math.inf))
    return out
