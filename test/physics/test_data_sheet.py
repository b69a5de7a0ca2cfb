"""Data sheet values converted to the model's coefficients, checked by the simulator's laws."""

import math

import pytest

from ehls_ros.arrays import in_python
from ehls_ros.errors import BadInput
from ehls_ros.physics.data_sheet import DataSheet, lag_bandwidth, mean_area, rig_values, sheet_from_mapping
from ehls_ros.physics.equations import load_flow
from ehls_ros.physics.parameters import Plant
from ehls_ros.schema import Misfit, notes
from ehls_ros.units import in_unit

SHEET = {
    "bore": 63,
    "rod": 36,
    "rods": "two",
    "stroke": 200,
    "supply_pressure": "210 bar",
    "rated_flow": "38 l/min",
    "rated_drop": 70,
}
LITRES_A_MINUTE = 1e-3 / 60.0


def plant_of(**more):
    values = rig_values(sheet_from_mapping(SHEET | more, "answers"))
    return Plant(**{key: source.value for key, source in values["plant"].items()}), values


@pytest.mark.parametrize(("drop_over", "at_full_drop"), [("valve", 38.0), ("edge", 38.0 / math.sqrt(2.0))])
@pytest.mark.parametrize("travel", [None, "0.5 mm", 3.0])
def test_the_simulators_orifice_passes_the_rated_flow_at_the_rated_drop(drop_over, at_full_drop, travel):
    plant, values = plant_of(drop_over=drop_over, spool_travel=travel, oil_density=870)
    opening = values["limits"]["spool"].value
    for drop, flow in ((70e5, at_full_drop), (210e5, at_full_drop * math.sqrt(3.0))):
        found = in_python(load_flow)(opening, 1.0, 0.0, drop, plant)
        assert found / LITRES_A_MINUTE == pytest.approx(flow)


def test_a_cylinder_of_known_areas():
    """ISO 3320 sizes: 63 mm has 31.17 cm², its ring about a rod of 36 mm 20.99 cm²."""
    assert mean_area(0.063, 0.036, "two") == pytest.approx(20.99e-4, rel=1e-3)
    assert mean_area(0.063, 0.036, "one") == pytest.approx(0.5 * (31.17e-4 + 20.99e-4), rel=1e-3)
    plant, values = plant_of(dead_volume=300)
    assert plant.total_volume == pytest.approx(20.99e-4 * 0.2 + 300e-6, rel=1e-3)
    assert values["limits"]["force"].value == pytest.approx(44.1e3, rel=1e-3)
    assert values["limits"]["position"].value == [-0.1, 0.1]


def test_a_first_order_lag_is_as_late_as_the_valve_it_stands_for():
    """Slow commands of s² / ω² + 2 ζ s / ω + 1 are late by 2 ζ / ω, of s / ω_v + 1 by 1 / ω_v."""
    slow, natural = 0.5, 2.0 * math.pi * 60.0
    phase = math.atan2(2.0 * 0.7 * slow / natural, 1.0 - (slow / natural) ** 2)
    assert math.atan(slow / lag_bandwidth(60.0, "-90 deg")) == pytest.approx(phase, rel=1e-3)
    assert 1.0 / math.hypot(1.0, 2.0 * math.pi * 60.0 / lag_bandwidth(60.0, "-3 dB")) == pytest.approx(math.sqrt(0.5))


def test_each_value_says_where_it_came_from():
    _, values = plant_of(moving_mass=150)
    assert values["plant"]["moving_mass"] == (150.0, "given", "150 kg")
    assert values["plant"]["piston_area"].origin == "computed"
    for section, key in (("plant", "leakage_coefficient"), ("plant", "bulk_modulus"), ("friction", "coulomb_force")):
        assert values[section][key].origin == "assumed"
        assert "ehls identify" in values[section][key].basis
    _, values = plant_of(friction="0.5 kN", leakage=0.2)
    assert values["friction"]["coulomb_force"] == (500.0, "given", "500 N")
    assert values["plant"]["leakage_coefficient"].value == pytest.approx(0.2 * LITRES_A_MINUTE / 210e5)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("70", "bar", 70.0),
        ("3000 psi", "bar", 206.84),
        (" 21MPa ", "bar", 210.0),
        ("2.5 in", "mm", 63.5),
        ("5e-4 m³", "cm^3", 500),
        ("0.5 L", "cm^3", 500),
        ("38 L/min", "l/min", 38.0),
        ("210 bar(g)", "MPa", 21.0),
        ("2 Ns/mm", "N s/m", 2000.0),
        ("60 Hz", "rad/s", 376.99),
    ],
)
def test_figures_with_units(text, unit, value):
    assert in_unit(text, unit) == pytest.approx(value, rel=1e-4)


@pytest.mark.parametrize(
    ("text", "said"), [("70 mm", "MPa, bar"), ("seventy", "a number"), ("7,5 bar", "decimal point"), ("5 bra", "'bar'?")]
)
def test_what_is_no_figure_in_bar(text, said):
    with pytest.raises(Misfit, match=said):
        in_unit(text, "bar")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"bore": 36, "rod": 63}, "rod is 63 mm, bore is 36 mm; expected a rod thinner than the bore; are they swapped?"),
        ({"supply_pressure": "21e6 bar"}, "2000"),
        ({"rods": "double"}, "one of two, one"),
        ({"rated_flw": 38}, "did you mean 'rated_flow'?"),
        ({"stroke": "200 bar"}, "stroke is '200 bar'"),
        ({"rod_points": True}, "level, up, down"),
    ],
)
def test_wrong_answers(wrong, said):
    with pytest.raises(BadInput) as caught:
        sheet_from_mapping(SHEET | wrong, "answers.yaml")
    assert str(caught.value).startswith("answers.yaml: ")
    assert said in str(caught.value)


def test_the_needed_answers_are_few():
    with pytest.raises(BadInput, match="key 'bore' is missing; expected a value for it"):
        sheet_from_mapping({}, "answers.yaml")
    assert set(SHEET) == set(DataSheet._fields) - set(DataSheet._field_defaults)


def test_every_figure_may_have_another_unit():
    units = {note.unit for note in notes(DataSheet).values() if note.unit}
    assert [in_unit(f"2 {unit}", unit) for unit in units] == [2.0] * len(units)


SINGLE_ROD = {
    "bore": 63, "rod": 45, "rods": "one", "stroke": 400, "supply_pressure": "210 bar", "rated_flow": 40, "rated_drop": "70 bar",
    "cylinder": "two_chamber", "hose_a": 250, "hose_b": 200, "flow_pb": 20, "flow_bt": 22, "tank_pressure": "3 bar",
}  # fmt: skip


def test_a_single_rod_has_areas_volumes_and_edges_of_its_own():
    values = rig_values(sheet_from_mapping(SINGLE_ROD, "answers"))
    found = {key: source.value for key, source in {**values["cylinder"], **values["valve"]}.items()}
    a, ring = 0.25 * math.pi * 0.063**2, 0.25 * math.pi * (0.063**2 - 0.045**2)
    assert found == pytest.approx(
        {
            "area_a": a,
            "area_b": ring,
            "volume_a": 0.2 * a + 250e-6,
            "volume_b": 0.2 * ring + 200e-6,
            "tank_pressure": 3e5,
            "gain_pa": 1.0,
            "gain_at": 1.0,
            "gain_pb": 0.5,
            "gain_bt": 0.55,
        }
    )
    assert {"piston_area", "total_volume"}.isdisjoint(values["plant"])


def test_figures_of_chambers_are_refused_with_one_pressure():
    with pytest.raises(BadInput, match="hose_a is 250; expected no hose_a, or cylinder: two_chamber"):
        sheet_from_mapping({**SINGLE_ROD, "cylinder": "double_rod"}, "answers")
