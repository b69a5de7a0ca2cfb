"""Units in base units."""

import pytest

from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.fmu.unit_definitions import BASE, SIGNAL_UNITS, base_unit
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.parameters import Plant
from ehls_ros.recording.topics import READINGS
from ehls_ros.schema import notes
from ehls_ros.trajectory import READABLE


@pytest.mark.parametrize(
    ("unit", "factor", "exponents"),
    [
        ("m^5/(N s)", 1.0, {"kg": -1, "m": 4, "s": 1}),
        ("N s/(m K)", 1.0, {"kg": 1, "s": -1, "K": -1}),
        ("t MPa/s^2", 1e9, {"kg": 2, "m": -1, "s": -4}),
        ("mm^5/N^3", 1e-15, {"kg": -3, "m": 2, "s": 6}),
        ("1/Pa", 1.0, {"kg": -1, "m": 1, "s": 2}),
        ("rad/s", 1.0, {"rad": 1, "s": -1}),
        ("1", 1.0, {}),
    ],
)
def test_factor_and_exponents(unit, factor, exponents):
    found = base_unit(unit)
    assert found.factor == pytest.approx(factor, rel=1e-12)
    assert {name: power for name, power in zip(BASE, found.exponents, strict=True) if power} == exponents


@pytest.mark.parametrize("unit", ["furlong", "m^", "N s/?"])
def test_other_texts_are_no_units(unit):
    with pytest.raises(ValueError, match="unit"):
        base_unit(unit)


def test_every_declared_unit_is_known():
    families = (EFFECTS, FRICTION_MODELS, CONTROLLERS, OBSERVERS)
    declared = [Plant, *(family.load(name).Parameters for family in families for name in family.names())]
    units = {note.unit for parameters in declared for note in notes(parameters).values() if note.unit}
    for unit in sorted(units):
        base_unit(unit)


def test_signals_have_the_units_of_their_recordings():
    assert {name: READABLE[signal].unit for name, signal in READINGS.items()} == SIGNAL_UNITS
