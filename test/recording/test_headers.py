"""Interpretation of the headers of measured data, and the parts left to the user."""

from pathlib import Path

import pytest

from ehls_ros.recording.columns import read_columns, unit_of
from ehls_ros.recording.headers import recognised
from ehls_ros.recording.load import load
from ehls_ros.recording.proposal import look, proposed_map
from ehls_ros.units import QUANTITIES, SPELLINGS, UNITS

STATED = {
    "p_A [bar]": ("pressure_a_pa", "bar"),
    "Druck B [bar]": ("pressure_b_pa", "bar"),
    "pB (MPa)": ("pressure_b_pa", "MPa"),
    "ps [bar]": ("supply_pressure_pa", "bar"),
    "supply pressure [psi]": ("supply_pressure_pa", "psi"),
    "Druck P [bar]": ("supply_pressure_pa", "bar"),
    "p_P [bar]": ("supply_pressure_pa", "bar"),
    "Druck S (bar)": ("supply_pressure_pa", "bar"),
    "Druck T [bar]": ("tank_pressure_pa", "bar"),
    "P_A [bar]": ("pressure_a_pa", "bar"),
    "Tankdruck / bar": ("tank_pressure_pa", "bar"),
    "p_T [bar]": ("tank_pressure_pa", "bar"),
    "dp_MPa": ("load_pressure_pa", "MPa"),
    "Weg_mm": ("position_m", "mm"),
    "Weg in mm": ("position_m", "mm"),
    "x / µm": ("position_m", "µm"),
    "x [\N{GREEK SMALL LETTER MU}m]": ("position_m", "µm"),
    "position [mm]": ("position_m", "mm"),
    "Position_Soll [mm]": ("position_reference_m", "mm"),
    "xv [mm]": ("spool_m", "mm"),
    "v_mm_s": ("velocity_m_s", "mm/s"),
    "speed [mm/s]": ("velocity_m_s", "mm/s"),
    "Kraft (kN)": ("force_n", "kN"),
    "F_N": ("force_n", "N"),
    "force_kn": ("force_n", "kN"),
    "LoadCell [N]": ("load_cell_n", "N"),
    "time_ms": ("time_s", "ms"),
    "time [ms]": ("time_s", "ms"),
    "Zeit [s]": ("time_s", "s"),
    "T_oil [°C]": ("oil_temperature_k", "°C"),
    "Öltemperatur [°C]": ("oil_temperature_k", "°C"),
    "Winkel [°]": ("angle_rad", "°"),
    "angle_deg": ("angle_rad", "°"),
    "Drehmoment [Nm]": ("torque_n_m", "N m"),
    "n_drehzahl [rpm]": None,
    "log.motion.x_mm": ("position_m", "mm"),
    "Drehzahl [1/min]": ("angular_velocity_rad_s", "rpm"),
}
"""Headers that give both quantity and unit; None for one with an unknown letter."""

LEFT_OPEN = {
    "p": "no unit",
    "p [bar]": "which chamber",
    "pressure [bar]": "which chamber",
    # A letter behind a pressure is a chamber, not amperes.
    "p_A": "no unit",
    "p1 [bar]": "is chamber 1",
    "p0 [bar]": "is pressure 0 the supply",
    "Kraft P [kN]": "which one",
    "p_max [bar]": "a statistic",
    "x_filtered [mm]": "a filtered",
    "F_error [N]": "a raw signal",
    "t": "no unit",
    "t_min": "'min' may be a unit or a word",
    "x_in": "'in' may be a unit or a word",
    "dp_mpa": "two units by its case",
    "T [°C]": "of the oil?",
    "I [mA]": "two values in mA",
    "valve command [V]": "two values in V",
    "Weg [bar]": "which the name contradicts",
    "Weg [furlong]": "is not known",
    "[mm]": "the name is not",
    "qm [mm]": "the name is not",
    "s_foo_mm": "no word of the name",
    "x_3 [mm]": "a word of the name",
    "qm": "no word of the name",
    "vir": "no word of the name",
    "PG_1": "no word of the name",
    "": "no word of the name",
}
"""Headers that leave a part open, with that part."""


@pytest.mark.parametrize("header", STATED)
def test_a_header_that_says_quantity_and_unit_is_taken(header: str):
    [said] = recognised([header])
    expected = STATED[header]
    if expected is None:
        assert said.certainty != "stated", said
        return
    assert (said.signal, said.unit, said.certainty) == (*expected, "stated"), said


@pytest.mark.parametrize("header", LEFT_OPEN)
def test_nothing_is_guessed(header: str):
    [said] = recognised([header])
    assert said.certainty in ("unsure", "unknown"), said
    assert LEFT_OPEN[header] in said.open, said


def test_names_of_the_data_contract_need_no_map():
    assert [said.certainty for said in recognised(["time_s", "force_n", "pressure_a_pa"])] == ["contract"] * 3


def test_a_pressure_numbered_0_beside_both_chambers_is_that_of_the_supply():
    assert recognised(["Druck A [bar]", "Druck B [bar]", "Druck 0 [bar]"])[2].certainty == "stated"
    assert [said.certainty for said in recognised(["Druck 0 [bar]", "Druck 1 [bar]"])] == ["unsure", "unsure"]


@pytest.mark.parametrize(("values", "remark"), [((92, 209), "offset: -0.1505"), ((-60, 57), ""), ((1.25, 1.28), "")])
def test_a_position_that_never_comes_near_0_gets_a_remark(tmp_path: Path, values, remark):
    low, high = values
    (tmp_path / "data.csv").write_text(f"time [s],Weg [mm]\n0,{low}\n1,{high}\n2,{low}\n")
    [table] = look(tmp_path / "data.csv")
    assert remark in table.columns[1].absolute
    assert bool(remark) == bool(table.columns[1].absolute)
    assert ("0 has to be at mid-stroke" in proposed_map([table]).text) == bool(remark)


def test_two_columns_that_say_the_same_are_both_left_open():
    first, second, other = recognised(["x1 [mm]", "Weg [mm]", "position [mm]"])
    assert first.certainty == "unsure"
    assert (second.certainty, other.certainty) == ("unsure", "unsure")
    assert "2 columns state the same signal" in second.open


@pytest.mark.parametrize(
    ("written", "known"),
    [
        ("mm", "mm"),
        ("N m", "N m"),
        ("[Bar]", "bar"),
        ("mPa", None),
        ("bar(g)", "bar"),
        ("bar(a)", None),
        ("mm*s^-1", "mm/s"),
        ("m/s²", "m/s^2"),
        ("N/mm2", "N/mm^2"),
        ("in-lbf", "in lbf"),
        ("t", None),  # a time, not tonnes
        ("g", "gn"),  # an acceleration, not grams
        ("sec.", "s"),
        ("kip", "kip"),
        ("mV/V", "mV/V"),
    ],
)
def test_units_are_known_by_their_spelling(written: str, known: str | None):
    assert unit_of(written) == known


def test_units_have_their_sizes():
    assert UNITS["in lbf"].scale * 15000.0 == pytest.approx(1694.77, abs=0.01)
    assert UNITS["rpm"].scale * 60.0 == pytest.approx(6.283185, rel=1e-6)
    assert UNITS["°F"].scale * 32.0 + UNITS["°F"].offset == pytest.approx(273.15)
    assert UNITS["psi"].scale == pytest.approx(6894.757, rel=1e-6)
    assert UNITS["kip"].scale == pytest.approx(4448.222, rel=1e-6)
    assert UNITS["ksi"].scale == pytest.approx(6.894757e6, rel=1e-6)
    assert UNITS["gpm"].scale == pytest.approx(6.30902e-5, rel=1e-6)
    assert all(UNITS[unit] == (quantity, 1.0, 0.0) for unit, quantity in QUANTITIES.items())
    assert set(SPELLINGS.values()) <= UNITS.keys()
    assert not SPELLINGS.keys() & UNITS.keys()


def test_a_proposed_map_can_be_used_as_it_is(tmp_path: Path):
    (tmp_path / "data.csv").write_text(
        'time [ms],"Weg, ""neu"" [mm]",Kraft (kN),p,Datum,T_oil [°C]\n0,1,2,5,a,20\n10,2,3,6,b,21\n20,3,4,7,c,21\n',
        encoding="utf-8",
    )
    [table] = look(tmp_path / "data.csv")
    assert table.rate == pytest.approx(100.0)
    assert (table.columns[2].smallest, table.columns[2].largest) == (2.0, 4.0)
    text = proposed_map([table]).text
    (tmp_path / "columns.yaml").write_text(text, encoding="utf-8")
    given = read_columns(tmp_path / "columns.yaml")
    # Uncertain columns are left out: the pressure without a unit and the name with an unknown word.
    assert set(given.columns) == {"time_s", "force_n", "oil_temperature_k"}
    assert '# load_pressure_pa: {name: "p"' in text
    assert '# "Datum" is not a column of numbers' in text
    trajectory = load(tmp_path / "data.csv", given)
    assert trajectory.time_s.tolist() == [0.0, 0.01, 0.02]
    assert trajectory["force_n"].tolist() == [2000.0, 3000.0, 4000.0]
    assert trajectory["oil_temperature_k"][0] == pytest.approx(293.15)


def test_several_tables_are_proposed_as_one_recording(tmp_path: Path):
    (tmp_path / "fast.csv").write_text("t [ms],F [N]\n" + "".join(f"{k},{k}\n" for k in range(50)))
    (tmp_path / "slow.csv").write_text("Zeit [s],Weg [mm]\n" + "".join(f"{k / 100},{k}\n" for k in range(5)))
    text = proposed_map([*look(tmp_path / "fast.csv"), *look(tmp_path / "slow.csv")]).text
    (tmp_path / "columns.yaml").write_text(text, encoding="utf-8")
    given = read_columns(tmp_path / "columns.yaml")
    assert list(given.tables) == ["fast.csv", "slow.csv"]
    trajectory = load(tmp_path / "fast.csv", given)
    # A straight line stays one, at the times of the fast table.
    assert trajectory["position_m"] == pytest.approx(trajectory.time_s * 0.1, abs=1e-12)
    assert trajectory["force_n"] == pytest.approx(trajectory.time_s * 1e3)
