"""Findings of an identification, in words and in numbers rounded to their standard errors."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.estimate import Estimate
from ehls_ros.identification.elements import EVIDENCE
from ehls_ros.identification.result import Identification
from ehls_ros.identification.stribeck import StaticFriction
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import Rig
from ehls_ros.report.page import MISSING_NUMBER, listed, number
from ehls_ros.report.plot import Unit
from ehls_ros.report.quantities import as_shown, fixed_point, unit_text, written
from ehls_ros.schema import declarations

TOGETHER = 1.2
"""Ratio of the travels at which elements start to slip, below which they act as one."""

STRONG = 0.9
"""Correlation above which a pair is named."""

NOISY = 3.0
"""Ratio of residuals to the sensor's noise above which noise does not explain them."""

SYMBOLS = {
    "coulomb_force": "Fc",
    "static_force": "Fs",
    "stribeck_velocity": "Vs",
    "stribeck_exponent": "δ",
    "viscous_coefficient": "σf",
    "attraction_rate": "C",
    "element_stiffness": "k",
    "element_weight": "α",
    "presliding_stiffness": "σ0",
    "softening_exponent": "i",
    "spring_stiffness": "ks",
    "viscous_damping": "B0",
    "moving_mass": "m0",
    "gravity": "g",
}
READABLE = {"m/s": Unit("mm/s", 1e3), "N s/m": Unit("N s/mm", 1e-3), "N/m": Unit("N/mm", 1e-3)}
"""Units of the paper and the figures, by the SI units of the rig file."""


class NotIdentified(NamedTuple):
    """A coefficient that the data do not identify.

    Attributes:
        name: its name in the rig file.
        value: its value in the new rig file, as text.
        reason: why it is not identifiable.
    """

    name: str
    value: str
    reason: str


class Pair(NamedTuple):
    """A pair of coefficients with the correlation of their estimates."""

    correlation: float
    first: str
    second: str


def percent(part: float) -> str:
    """Write a fraction as a percentage, "< 0.001 %" if smaller than that."""
    if not math.isfinite(part):
        return MISSING_NUMBER
    return f"{number(100 * part, 2)} %" if abs(part) >= 1e-5 or part == 0 else "< 0.001 %"


def relative_error(estimate: Estimate) -> str:
    """Write the standard error of an estimate in per cent of its value."""
    return percent(estimate.std / abs(estimate.value) if estimate.value else math.nan)


def strong_pairs(names: Sequence[str], correlations: Array) -> tuple[list[Pair], Pair | None]:
    """Return the strongly correlated pairs, the strongest first, and the strongest pair of all; None if there is none."""
    pairs = [
        Pair(float(correlations[i, j]), names[j], names[i])
        for i in range(len(names))
        for j in range(i)
        if np.isfinite(correlations[i, j])
    ]
    pairs.sort(key=lambda pair: (abs(pair.correlation), pair.first, pair.second), reverse=True)
    return [pair for pair in pairs if abs(pair.correlation) >= STRONG], pairs[0] if pairs else None


def split(name: str) -> tuple[str, str]:
    """Split the name of an element's coefficient into base and number, which is empty for others."""
    found = re.fullmatch(r"(element_\w+?)_(\d+)", name)
    return (found[1], found[2]) if found else (name, "")


def symbol(name: str) -> str:
    """Return the symbol of a coefficient, or its name if there is none."""
    base, index = split(name)
    return SYMBOLS[base] + index if base in SYMBOLS else name


def meaning(rig: Rig, name: str) -> str:
    """Return the description of a rig's coefficient from its declaration."""
    base, index = split(name)
    declared = {d.name: d.description for group in (Plant, type(rig.friction)) for d in declarations(group)}
    text = declared.get(base, "").split(";", maxsplit=1)[0]
    # The symbol has a separate column.
    return re.sub(r" \w+_i\b", "", text).replace("each element", f"element {index}") if index else text


def readable(estimate: Estimate, digits: int = 1) -> str:
    """Write an estimate with its standard error in the unit of the figures."""
    unit = READABLE.get(estimate.unit, Unit(unit_text(estimate.unit)))
    text = written(unit.factor * estimate.value, unit.factor * estimate.std, digits)
    shown = "" if unit.symbol == "1" else f" {unit.symbol}"
    return f"{text.value}{shown} ± {text.error}"


def value_in(rig: Rig, name: str) -> float | tuple[float, ...] | None:
    """Return a coefficient of a rig; None if it has none of that name or number."""
    base, index = split(name)
    for group in (rig.friction, rig.plant):
        if base in group._fields:
            value = getattr(group, base)
            if not index:
                return tuple(map(float, value)) if isinstance(value, tuple) else float(value)
            return float(value[int(index) - 1]) if 0 < int(index) <= len(value) else None
    return None


def not_identified(found: Identification) -> list[NotIdentified]:
    """List the coefficients that are not identifiable, with the reason for each."""
    return [NotIdentified(name, _kept(found, name), _reason(found, name)) for name in found.not_identifiable]


def _kept(found: Identification, name: str) -> str:
    # The rig file's elements are sorted; those of the fit have the numbers of the estimates.
    fitted = found.rig._replace(friction=found.fit.friction)
    value = value_in(fitted if split(name)[1] else found.rig, name)
    if value is None:
        return MISSING_NUMBER
    return ", ".join(map(as_shown, value)) if isinstance(value, tuple) else as_shown(value)


def _reason(found: Identification, name: str) -> str:
    reasons = [remark.rstrip(".") for remark in found.remarks if re.search(rf"\b{re.escape(name)}\b", remark)]
    if reasons:
        return "; ".join(reasons)
    if found.static is None and name in StaticFriction._fields:
        return "nothing slides steadily"
    if not any(motion.small for motion in found.motions) or (found.elements and found.branch is None):
        return "no presliding is recorded"
    return "the fit did not move it"


def other_remarks(found: Identification) -> list[str]:
    """Return the remarks except reasons for unidentifiable coefficients and the one on the number of elements."""
    named = [re.compile(rf"\b{re.escape(name)}\b") for name in found.not_identifiable]
    left = [remark for remark in found.remarks if not any(name.search(remark) for name in named)]
    return [remark for remark in left if found.branch is None or "Bayesian" not in remark]


def verdict_sentence(found: Identification) -> tuple[str, bool | None]:
    """Summarise an identification.

    Args:
        found: the result.

    Returns:
        One sentence, and whether all coefficients are identified; None if an experiment is missing, False if estimates are
        too uncertain or a search has not converged.
    """
    scalars = [name for name in found.rig.friction._fields if name in found.estimates]
    named = [f"{symbol(name)} {readable(found.estimates[name])}" for name in scalars]
    parts = [f"{listed(named)} (± one standard error)" if named else "The data identify no coefficient of friction"]
    if found.elements:
        parts.append(elements_remark(found))
    missing = [name for name in found.not_identifiable if not _inseparable(found, name)]
    if missing:
        parts.append(f"not identifiable: {listed(missing)}")
    if any(_inseparable(found, name) for name in found.not_identifiable):
        parts.append("viscous_damping cannot be separated from viscous_coefficient")
    good: bool | None = True
    if found.static is None or (found.branch is None if found.elements else bool(missing)):
        good = None
    if any(_is_vague(found, name) for name in missing):
        good = False
    searches = [found.fit.converged, *([] if found.static is None else [found.static.search.converged])]
    if not all(searches):
        parts.append("the search has not converged")
        good = False
    return "; ".join(parts) + ".", good


def _inseparable(found: Identification, name: str) -> bool:
    return name == "viscous_damping" and "viscous_coefficient" in found.estimates


def _is_vague(found: Identification, name: str) -> bool:
    """Return whether a coefficient was fitted without success, not left out for lack of a recording."""
    remarks = [remark for remark in found.remarks if re.search(rf"\b{re.escape(name)}\b", remark)]
    return any("standard error" in remark or "told apart" in remark or "limit" in remark for remark in remarks)


def elements_remark(found: Identification) -> str:
    """Return a remark on the number of friction elements that explain the loop."""
    count = len(found.fit.friction.element_stiffness)
    if found.branch is None:
        return "the hysteresis loop is not identified"
    plural = "s" if count > 1 else ""
    if len(found.criteria) > 1:
        return f"{_COUNTS.get(count, str(count))} friction element{plural} explain{'' if plural else 's'} the loop"
    return f"the loop is fitted with {_COUNTS.get(count, str(count))} friction element{plural}, as asked for"


_COUNTS = {1: "one", 2: "two", 3: "three", 4: "four"}


def criteria_remark(found: Identification) -> str:
    """Return a remark on the Bayesian information criterion for other numbers of elements."""
    chosen = len(found.fit.friction.element_stiffness)
    ours = found.criteria.get(chosen, math.nan)
    others = [(count, value - ours) for count, value in sorted(found.criteria.items()) if count != chosen]
    text = f"{elements_remark(found)}."
    text = text[0].upper() + text[1:]
    if others:
        changes = [f"{_change(change)} with {count}" for count, change in others]
        text += (
            f" The Bayesian information criterion (BIC) changes by {listed(changes)}; one more element has to lower it by"
            f" {EVIDENCE:g}."
        )
    ways = [node.way for node in found.nodes]
    if len(ways) > 1 and 0 < max(ways) < TOGETHER * min(ways):
        text += (
            f" They give way within {number(100 * (max(ways) / min(ways) - 1), 2)} % of the same travel, so they act as one."
        )
    return text


def _change(value: float) -> str:
    return f"{value:+,.0f}".replace(",", "\u202f").replace("-", "−") if math.isfinite(value) else MISSING_NUMBER


def correlation_remark(found: Identification) -> str:
    """Return a remark on the most strongly correlated pairs."""
    strong, largest = strong_pairs(list(found.estimates), found.correlations)
    if strong:
        named = [f"{symbol(pair.first)} and {symbol(pair.second)} {fixed_point(pair.correlation, 3)}" for pair in strong[:5]]
        return f"Strongest: {listed(named)}."
    if largest is None:
        return ""
    value, first, second = largest
    return f"None reaches {STRONG:g} in size; the largest is {fixed_point(value, 2)}, {symbol(first)} and {symbol(second)}."


def noise_remark(found: Identification) -> str:
    """Return a remark that compares the residuals with the noise of the force sensor."""
    ratios: Mapping[str, float] = {
        motion.name: left / motion.force_noise
        for motion, left in zip(found.motions, found.fit.noise, strict=True)
        if motion.force_noise > 0 and math.isfinite(left)
    }
    if not ratios:
        return ""
    worst = max(ratios, key=lambda name: ratios[name])
    text = f"The residuals are at most {number(ratios[worst], 2)} times the force sensor's noise"
    text += f" ({worst})." if len(ratios) > 1 else "."
    if ratios[worst] > NOISY:
        text += " So the model limits the fit, and the standard errors hold only as far as the model does."
    return text
