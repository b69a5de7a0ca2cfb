"""Recognition of measured signals by their column headers: a word for the quantity, and its unit.

Only a header that states both without contradiction is assigned to a signal. Others are listed with the missing information,
for the user to decide.
"""

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal, NamedTuple

from ehls_ros.recording.columns import ELECTRICAL, TIME, is_contract_name, quantity_of, unique_names, unit_of
from ehls_ros.trajectory import READABLE
from ehls_ros.units import UNITS

Certainty = Literal["contract", "stated", "unsure", "unknown"]


class Recognised(NamedTuple):
    """Interpretation of a header.

    Attributes:
        column: the header.
        signal: name in the data contract; the best candidate if unsure, empty if there is none.
        unit: unit in its standard spelling; empty if none is stated.
        certainty: ``contract`` needs no map; ``stated`` has quantity and unit; ``unsure`` is ambiguous.
        open: the ambiguity; empty for the first two, or a remark.
    """

    column: str
    signal: str
    unit: str
    certainty: Certainty
    open: str


WORDS: Mapping[str, str] = {
    **dict.fromkeys(("t", "time", "zeit", "timestamp", "zeitstempel", "uhrzeit", "elapsed"), "time"),
    **dict.fromkeys(("laufzeit", "messzeit", "prüfzeit", "xvalue"), "time"),
    **dict.fromkeys(("x", "position", "pos", "weg", "hub", "stroke", "displacement", "kolbenweg"), "length"),
    **dict.fromkeys(("xv", "spool", "schieber", "schieberweg"), "spool"),
    **dict.fromkeys(("v", "velocity", "vel", "speed", "geschwindigkeit"), "velocity"),
    **dict.fromkeys(("F", "force", "kraft"), "force"),
    **dict.fromkeys(("loadcell", "kraftmessdose", "kraftaufnehmer"), "cell"),
    **dict.fromkeys(("p", "P", "pressure", "druck", "press"), "pressure"),
    **dict.fromkeys(("ps", "versorgungsdruck", "systemdruck", "pumpendruck"), "supply"),
    **dict.fromkeys(("pt", "tankdruck"), "tank"),
    **dict.fromkeys(("pL", "dp", "lastdruck", "differenzdruck"), "load pressure"),
    **dict.fromkeys(("T", "temp", "temperature", "temperatur"), "temperature"),
    **dict.fromkeys(("öltemperatur", "oeltemperatur"), "oil temperature"),
    **dict.fromkeys(("phi", "φ", "theta", "angle", "winkel", "drehwinkel"), "angle"),
    **dict.fromkeys(("omega", "ω", "drehzahl", "winkelgeschwindigkeit"), "angular velocity"),
    **dict.fromkeys(("M", "torque", "moment", "drehmoment"), "torque"),
    **dict.fromkeys(
        (
            "u",
            "U",
            "i",
            "I",
            "command",
            "cmd",
            "stellsignal",
            "stellgröße",
            "strom",
            "current",
            "ventilstrom",
            "ventilspannung",
        ),
        "command",
    ),
}
"""Words for quantities, English and German. Single letters and words with a capital inside are case-sensitive."""

QUALIFIERS: Mapping[str, str] = {
    "a": "A",
    "b": "B",
    "1": "1",
    "2": "2",
    "0": "0",
    **dict.fromkeys(("p", "s", "supply", "pump", "system", "versorgung", "pumpe"), "supply"),
    **dict.fromkeys(("t", "tank", "return", "rücklauf"), "tank"),
    **dict.fromkeys(("l", "load", "last", "diff", "differential", "delta"), "load"),
    **dict.fromkeys(("oil", "öl", "oel", "fluid"), "oil"),
    **dict.fromkeys(("cell", "dose", "aufnehmer"), "cell"),
    **dict.fromkeys(("ref", "reference", "soll", "sollwert", "setpoint", "target", "desired"), "reference"),
    **dict.fromkeys(("valve", "ventil", "servo"), "valve"),
    **dict.fromkeys(("min", "max", "mean", "avg", "std", "rms", "filtered", "filt", "raw", "err", "error"), "worked on"),
}
"""Words that distinguish several signals of a quantity."""

UNIT_LIKE_WORDS = ("min", "in", "h", "d", "C", "K")
"""Suffixes that may be words or units."""

LOWER_CASE: Mapping[str, str] = {"n": "N", "kn": "kN", "pa": "Pa", "kpa": "kPa", "k": "K", "v": "V", "ma": "mA", "degc": "°C"}
"""Units by their spelling in lower-case names."""

NO_UNIT = "no unit is given"
"""Ambiguity of a column whose quantity is known."""

ZERO = "is pressure 0 the supply?"
"""Ambiguity of a pressure numbered 0."""

TWO_UNITS = ("mpa", "mn")
"""Lower-case spellings that each denote two units."""

FIELD = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)+")
BRACKETS = re.compile(r"\s*(?P<label>.*?)\s*[\[({<]\s*(?P<unit>[^\])}>]*?)\s*[\])}>]\s*\Z")
BETWEEN = re.compile(r"\s*(?P<label>.*?\S)\s*(?:/|\s+in\s+)\s*(?P<unit>\S.*?)\s*\Z")
PIECES = re.compile(r"[A-ZÄÖÜ]?[a-zäöüßµ]+|[A-ZÄÖÜ]+(?![a-zäöü])|[0-9]+|[α-ωΑ-Ω]")


def recognised(header: Sequence[str], units: Mapping[str, str] = MappingProxyType({})) -> list[Recognised]:
    """Interpret the headers of a table, in their order.

    Args:
        header: the names of its columns.
        units: units by name, if stated separately in the file, such as in a row of units.

    Returns:
        The interpretations; a column whose name is empty or occurs more than once is called by its number.
    """
    found = [_recognised(name, units.get(unique, "")) for name, unique in zip(header, unique_names(header), strict=True)]
    both = {"pressure_a_pa", "pressure_b_pa"} <= {r.signal for r in found if r.certainty in ("contract", "stated")}
    # Beside both chambers, the pressure numbered 0 is the supply's.
    found = [r._replace(certainty="stated", open="") if both and r.open == ZERO and r.unit else r for r in found]
    stated = [r.signal for r in found if r.certainty in ("contract", "stated")]
    return [
        r._replace(certainty="unsure", open=f"{stated.count(r.signal)} columns state the same signal; which is right?")
        if r.certainty == "stated" and stated.count(r.signal) > 1
        else r
        for r in (_numbered(r, unique) for r, unique in zip(found, unique_names(header), strict=True))
    ]


def _numbered(found: Recognised, unique: str) -> Recognised:
    """Return an interpretation with the unique name of the column; one whose name occurs more than once is not certain."""
    if unique == found.column:
        return found
    what = f"'{found.column}' is the name of several columns" if found.column else "it has no name"
    certainty = "unsure" if found.certainty in ("contract", "stated") else found.certainty
    return found._replace(column=unique, certainty=certainty, open="; ".join(filter(None, (what, found.open))))


def _recognised(column: str, apart: str) -> Recognised:
    if is_contract_name(column):
        return Recognised(column, column, "", "contract", "")
    # For a field of a structure, only the last part of the name is used.
    label, unit, doubt = _parted(column.rpartition(".")[2] if FIELD.fullmatch(column) else column)
    if apart:
        known = unit_of(apart)
        doubt = "" if known else f"unit {apart!r} is not known"
        if unit and known and UNITS[unit] != UNITS[known]:
            doubt = f"the name has {unit}, and the row of units {known}"
        bracketed = BRACKETS.match(column)
        label, unit = bracketed["label"] if bracketed else label, "" if doubt else known or ""
    quantity, qualifiers = _words(label)
    signal, left_open = _signal(quantity, qualifiers)
    if not quantity:
        # The unit alone gives a candidate if only one signal has its quantity.
        candidates = [name for name in (TIME, *READABLE) if unit and quantity_of(name) == UNITS[unit].quantity]
        candidate = candidates[0] if len(candidates) == 1 else ""
        what = doubt or ("the unit is known, the name is not" if unit else "no word of the name is known")
        return Recognised(column, candidate, unit, "unsure" if unit or doubt else "unknown", what)
    if doubt or not unit:
        return Recognised(column, signal, "", "unsure", "; ".join(filter(None, (doubt or NO_UNIT, left_open))))
    if UNITS[unit].quantity in ELECTRICAL:
        return Recognised(
            column, signal, unit, "unsure", f"needs the signal at two values in {unit}, by the data sheet: range and means"
        )
    if quantity_of(signal) != UNITS[unit].quantity:
        what = f"{unit} is a unit of {UNITS[unit].quantity}, which the name contradicts"
        return Recognised(column, "", unit, "unsure", what)
    return Recognised(column, signal, unit, "unsure" if left_open else "stated", left_open)


def _parted(column: str) -> tuple[str, str, str]:
    """Split a header into label, unit and doubt: the unit is in brackets or after a slash, ``in``, underscore or space."""
    for pattern in (BRACKETS, BETWEEN):
        match = pattern.match(column)
        unit = unit_of(match["unit"]) if match else None
        if match and unit is not None:
            return match["label"], unit, ""
        if match and pattern is BRACKETS:
            return match["label"], "", f"unit {match['unit']!r} is not known" if match["unit"] else ""
    parts = re.split(r"[_\s]+", column.strip("_ "))
    for count, joint in ((2, "/"), (2, ""), (1, "")):
        if len(parts) > count:
            label, written = "_".join(parts[:-count]), joint.join(parts[-count:])
            found = _suffix(label, written)
            if found is not None:
                return label, *found
    return column, "", ""


def _suffix(label: str, written: str) -> tuple[str, str] | None:
    """Return unit and doubt of the suffix of a label; None if it is part of the name.

    In ``p_A`` the suffix is a chamber, not amperes: a suffix that contradicts the label is not a unit.
    """
    unit = unit_of(written) or LOWER_CASE.get(written)
    if unit is None:
        return ("", f"{written} is two units by its case; write the one meant") if written in TWO_UNITS else None
    quantity, qualifiers = _words(label)
    signal, _ = _signal(quantity, qualifiers)
    if quantity != "command" and (not signal or quantity_of(signal) != UNITS[unit].quantity):
        return None
    if written in UNIT_LIKE_WORDS and quantity not in ("temperature", "oil temperature"):
        return "", f"'{written}' may be a unit or a word"
    return unit, ""


def _words(label: str) -> tuple[str, set[str]]:
    """Return the quantity named by a label, empty for none or for several, and the qualifiers of its signal."""
    pieces = PIECES.findall(label)
    whole = "".join(pieces)
    if whole in WORDS or (whole.lower() in WORDS and len(whole) > 2):
        return WORDS.get(whole) or WORDS[whole.lower()], set()
    quantities, qualifiers = list[str](), set[str]()
    for place, piece in enumerate(pieces):
        known = WORDS.get(piece) if len(piece) == 1 or piece in WORDS else WORDS.get(piece.lower())
        if known and not (place and len(piece) == 1):
            quantities.append(known)
        elif piece.lower() in QUALIFIERS:
            qualifiers.add(QUALIFIERS[piece.lower()])
        elif piece.lower() not in _IGNORED:
            qualifiers.add("unknown")
    distinct = set(quantities)
    if distinct == {"command", "reference"} or len(distinct) != 1:
        return "", qualifiers
    return distinct.pop(), qualifiers


_IGNORED = (
    "sensor",
    "signal",
    "measured",
    "mess",
    "ist",
    "actual",
    "act",
    "axial",
    "piston",
    "kolben",
    "cylinder",
    "zylinder",
    "chamber",
    "kammer",
)
"""Words without influence on the signal."""


def _signal(quantity: str, qualifiers: set[str]) -> tuple[str, str]:
    """Return the signal of a quantity with its qualifiers, and the remaining ambiguity."""
    if quantity == "pressure" and not qualifiers & _DOUBTS.keys():
        return _pressure(qualifiers)
    doubt = next((text for word, text in _DOUBTS.items() if word in qualifiers), "")
    rest = qualifiers - _DOUBTS.keys()
    for (of, qualifier), signal in _QUALIFIED.items():
        if of == quantity and rest == {qualifier}:
            return signal, doubt
    if quantity == "temperature":
        return _BY_QUANTITY.get(quantity, ""), doubt or "of the oil?"
    free = quantity in ("command", "spool") and rest <= {"valve"}
    return _BY_QUANTITY.get(quantity, ""), doubt or ("" if free or not rest else "which one?")


_DOUBTS: Mapping[str, str] = {
    "worked on": "a statistic, a filtered or a raw signal?",
    "unknown": "a word of the name is not known",
}
"""Qualifiers that make every quantity ambiguous."""

_QUALIFIED: Mapping[tuple[str, str], str] = {
    ("temperature", "oil"): "oil_temperature_k",
    ("force", "reference"): "force_reference_n",
    ("force", "cell"): "load_cell_n",
    ("force", "load"): "load_cell_n",
    ("length", "reference"): "position_reference_m",
    ("torque", "load"): "load_torque_n_m",
}
"""Signals by quantity and qualifier."""


def _pressure(qualifiers: set[str]) -> tuple[str, str]:
    by_name = {
        "A": "pressure_a_pa",
        "B": "pressure_b_pa",
        "supply": "supply_pressure_pa",
        "tank": "tank_pressure_pa",
        "load": "load_pressure_pa",
    }
    found = [by_name[q] for q in sorted(qualifiers) if q in by_name]
    if len(found) == 1 and len(qualifiers) == 1:
        return found[0], ""
    if qualifiers == {"0"}:
        return "supply_pressure_pa", ZERO
    numbered = {"1": "pressure_a_pa", "2": "pressure_b_pa"}
    for number, signal in numbered.items():
        if qualifiers == {number}:
            return signal, f"is chamber {number} the one that pushes towards {'+' if number == '1' else '-'}x?"
    return "load_pressure_pa", "of which chamber: load_pressure_pa, pressure_a_pa, pressure_b_pa, supply_pressure_pa?"


_BY_QUANTITY: Mapping[str, str] = {
    "time": TIME,
    "length": "position_m",
    "spool": "spool_m",
    "velocity": "velocity_m_s",
    "force": "force_n",
    "cell": "load_cell_n",
    "pressure": "load_pressure_pa",
    "supply": "supply_pressure_pa",
    "tank": "tank_pressure_pa",
    "load pressure": "load_pressure_pa",
    "temperature": "oil_temperature_k",
    "oil temperature": "oil_temperature_k",
    "angle": "angle_rad",
    "angular velocity": "angular_velocity_rad_s",
    "torque": "torque_n_m",
    "command": "valve_command_m",
}
