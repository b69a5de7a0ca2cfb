from pathlib import Path

import pytest

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, Cylinder, Rotary, read_columns


def test_a_map_is_read(tmp_path: Path):
    (tmp_path / "map.yaml").write_text(
        "time_s: {name: t}\nposition_m: {name: x mm, scale: 1e-3, offset: -1}\nfriction_slipping_12: {name: s}\n",
        encoding="utf-8",
    )
    assert read_columns(tmp_path / "map.yaml").columns == {
        "time_s": Column("t", 1.0, 0.0),
        "position_m": Column("x mm", 0.001, -1.0),
        "friction_slipping_12": Column("s"),
    }


def test_units_gains_tables_and_areas_are_read(tmp_path: Path):
    (tmp_path / "map.yaml").write_text(
        "tables: {fast.csv: {name: t, unit: ms, offset: 0.5}, slow.csv: }\nbase: slow.csv\n"
        "cylinder: {area_a: 2e-3, area_b: 1e-3}\nrotary: {radius: 0.1}\n"
        "position_m: {name: x, unit: mm, scale: -1, offset: 0.2}\noil_temperature_k: {name: T, unit: °C}\n"
        "valve_command_m: {name: i, unit: mA, gain: 0.05}\nsupply_pressure_pa: {name: p, unit: psi, table: slow.csv}\n",
        encoding="utf-8",
    )
    given = read_columns(tmp_path / "map.yaml")
    assert (given.base, given.cylinder, given.rotary) == ("slow.csv", Cylinder(2e-3, 1e-3), Rotary(0.1))
    assert given.tables["slow.csv"] is None
    assert given.tables["fast.csv"].plain() == Column("t", 1e-3, 0.5)
    plain = given.plain()
    assert plain["position_m"] == Column("x", -1e-3, 0.2)
    assert plain["oil_temperature_k"] == Column("T", 1.0, 273.15)
    # 10 mA open the valve by 0.5 mm.
    assert 10.0 * plain["valve_command_m"].scale == pytest.approx(5e-4)
    assert 1000.0 * plain["supply_pressure_pa"].scale == pytest.approx(6.894757e6, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "- time_s",
            ": it contains ['time_s']; expected a mapping like 'position_m: {name: x, scale: 0.001, offset: 0.0}'",
        ),
        ("time_s: [", ":2: map of columns is not valid YAML ("),
        ("position_m: {name: x}\nposition_m: {name: y}", ":2: map of columns is not valid YAML (duplicate key 'position_m')"),
        ("position_mm: {name: x}", ": name 'position_mm' is unknown; expected one of time_s, valve_command_m,"),
        ("friction_elements_n_0: {name: x}", ": name 'friction_elements_n_0' is unknown; expected one of"),
        ("force_n_1: {name: x}", ": name 'force_n_1' is unknown; expected one of"),
        ("position_m: x", ", position_m: it is 'x'; expected a mapping like"),
        ("position_m: {scale: 2}", ", position_m: key 'name' is missing; expected"),
        (
            "position_m: {name: x, units: mm}",
            ", position_m: key 'units' is unknown; expected one of name, scale, offset, unit,",
        ),
        ("position_m: {name: x, unit: bar}", ", position_m: unit is bar, a pressure; expected a unit of length"),
        ("position_m: {name: x, unit: furlong}", ", position_m: unit is 'furlong'; expected one of s,"),
        (
            "position_m: {name: x, unit: mm, gain: 2}",
            ", position_m: unit is mm, which needs no gain; expected a gain only with",
        ),
        (
            "valve_command_m: {name: i, unit: mA}",
            ", valve_command_m: unit is mA and no gain is given; expected gain: m per SI unit",
        ),
        ("valve_command_m: {name: i, gain: 2}", ", valve_command_m: gain is given without a unit; expected unit: A,"),
        (
            "force_n: {name: F, fit_to: position_m}",
            ", force_n: fit_to is 'position_m'; expected a known scale: only load_pressure_pa",
        ),
        (
            "spool_m: {name: F, fit_to: position_m}",
            ", spool_m: fit_to is 'position_m'; expected a known scale: no second signal",
        ),
        (
            "force_n: {name: F, fit_to: load_pressure_pa}\nload_pressure_pa: {name: p, fit_to: force_n}",
            ", force_n: fit_to is 'load_pressure_pa', which has no scale; expected that signal",
        ),
        ("tables: fast.csv", ", tables: it is 'fast.csv'; expected a list of files, or a mapping"),
        ("tables: [a.csv, a.csv]", ", tables: it is ['a.csv', 'a.csv']; expected each file once"),
        ("tables: {a.csv: t}", ", tables, a.csv: it is 't'; expected a list of files, or a mapping"),
        ("tables: [a.csv]\nbase: b.csv", ": base is 'b.csv'; expected one of the tables a.csv"),
        ("force_n: {name: F, table: b.csv}", ", force_n: table is 'b.csv'; expected one of the tables (none)"),
        ("cylinder: {area_a: 1e-3}", ", cylinder: key 'area_b' is missing; expected"),
        ("cylinder: {area_a: 1e-3, area_b: 0}", ", cylinder: area_b is 0; expected"),
        ("rotary: 0.1", ", rotary: it is 0.1; expected a mapping of radius"),
        ("position_m: {name: x, scale: mm}", ", position_m: scale is 'mm'; expected a valid number"),
        ("position_m: {name: x, scale: .inf}", ", position_m: scale is inf; expected a finite number"),
        ("position_m: {name: x, scale: 0}", ", position_m: scale is 0; expected a factor other than 0"),
    ],
)
def test_an_error_names_its_place(tmp_path: Path, text: str, complaint: str):
    file = tmp_path / "map.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput) as caught:
        read_columns(file)
    assert str(caught.value).startswith(f"{file}{complaint}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [None, b"position_m: {name: \xff}"])
def test_a_map_that_cannot_be_read_is_bad_input(tmp_path: Path, content: bytes | None):
    if content is not None:
        (tmp_path / "map.yaml").write_bytes(content)
    with pytest.raises(BadInput, match=r"cannot be read|not text"):
        read_columns(tmp_path / "map.yaml")
