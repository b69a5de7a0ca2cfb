"""Chamber pressures, load cell, angle and torque, and raw counts as signals of the data contract."""

import re

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.recording.columns import Column, ColumnMap, Cylinder, Rotary
from ehls_ros.recording.conversion import converted
from ehls_ros.trajectory import Own, Preparation, Trajectory

T = np.arange(3000) * 1e-3


def run(given: ColumnMap | None = None, preparation: Preparation | None = None, **signals) -> Trajectory:
    arrays = {name: np.broadcast_to(np.asarray(values, dtype=float), T.shape) for name, values in signals.items()}
    trajectory = Trajectory(T, arrays, preparation=preparation or Preparation())
    return converted(trajectory, given or ColumnMap(), "it")


def test_two_pressures_on_unequal_areas_give_the_force_of_both():
    given = ColumnMap(cylinder=Cylinder(area_a=2.0e-3, area_b=1.2e-3))
    out = run(given, pressure_a_pa=5.0e6, pressure_b_pa=3.0e6)
    # 10 kN less 3.6 kN, over the mean area of 1.6e-3 m².
    assert out["load_pressure_pa"][0] == pytest.approx(4.0e6)
    assert out["load_pressure_pa"][0] * out.preparation.equivalent_area == pytest.approx(6400.0)
    assert set(out.preparation.not_judged) == {"flow"}
    assert "unequal areas" in out.preparation.not_judged["flow"]


def test_equal_areas_give_the_difference_and_the_flow_is_judged():
    out = run(pressure_a_pa=5.0e6, pressure_b_pa=3.0e6)
    assert out["load_pressure_pa"][0] == pytest.approx(2.0e6)
    assert not out.preparation.not_judged
    assert out.preparation.equivalent_area is None
    [remark] = out.preparation.remarks
    assert "equal areas" in remark


def test_supply_counts_above_the_tank_and_the_cell_in_the_line_as_disturbance():
    out = run(supply_pressure_pa=7.0e6, tank_pressure_pa=0.4e6, load_cell_n=-250.0)
    assert out["supply_pressure_pa"][0] == pytest.approx(6.6e6)
    assert out["disturbance_force_n"][0] == pytest.approx(-250.0)
    assert out.preparation.measured == ("disturbance_force_n",)


def test_angle_and_torque_act_at_the_arm():
    given = ColumnMap(rotary=Rotary(0.25))
    out = run(given, angle_rad=2.0, angular_velocity_rad_s=-1.0, torque_n_m=50.0, load_torque_n_m=20.0)
    values = {name: out[name][0] for name in ("position_m", "velocity_m_s", "force_n", "disturbance_force_n")}
    assert values == pytest.approx({"position_m": 0.5, "velocity_m_s": -0.25, "force_n": 200.0, "disturbance_force_n": 80.0})


def test_chambers_beside_a_load_pressure_are_kept_as_they_are():
    """As a table of a simulated single rod has them."""
    signals = {"load_pressure_pa": 1e6, "pressure_a_pa": 3e6, "pressure_b_pa": 4e6}
    out = run(**signals)
    assert {name: out[name][0] for name in signals} == signals
    assert set(out.preparation.not_judged) == {"flow"}
    assert not run(**{**signals, "load_pressure_pa": -1e6}).preparation.not_judged


def test_noise_of_slow_chambers_follows_their_areas():
    slow = Preparation(interpolated={"pressure_a_pa": Own(0.01, 3e3), "pressure_b_pa": Own(0.02, 4e3)})
    out = run(ColumnMap(cylinder=Cylinder(1.0, 1.0)), slow, pressure_a_pa=5e6, pressure_b_pa=3e6)
    assert out.preparation.interpolated["load_pressure_pa"] == pytest.approx(Own(0.02, 5e3))


@pytest.mark.parametrize(
    ("given", "signals", "complaint"),
    [
        (ColumnMap(), {"angle_rad": 1.0}, "angle_rad is given without an arm; expected rotary"),
        (
            ColumnMap(rotary=Rotary(0.1)),
            {"angle_rad": 1.0, "position_m": 1.0},
            "position_m is given, and follows from angle_rad",
        ),
        (
            ColumnMap(cylinder=Cylinder(1.0, 0.5)),
            {"pressure_a_pa": 1.0, "pressure_b_pa": 1.0, "load_pressure_pa": 1.0},
            "load_pressure_pa is given, and",
        ),
        (ColumnMap(cylinder=Cylinder(1.0, 0.5)), {"pressure_a_pa": 1.0}, "pressure_a_pa is there without the other chamber"),
        (ColumnMap(), {"load_cell_n": 1.0, "disturbance_force_n": 1.0}, "disturbance_force_n is given, and"),
    ],
)
def test_what_contradicts_itself_is_bad_input(given: ColumnMap, signals: dict[str, float], complaint: str):
    with pytest.raises(BadInput, match=complaint):
        run(given, **signals)


# --- raw counts --------------------------------------------------------------------------------

PATH = 0.02 * np.sin(3.0 * T)
SPEED = 0.06 * np.cos(3.0 * T)


def counts(name: str, to: str, **more) -> ColumnMap:
    return ColumnMap({name: Column("raw", fit_to=to), to: Column("known")}, **more)


def test_counts_of_a_path_are_fitted_to_the_velocity():
    rng = np.random.default_rng(0)
    raw = np.round(PATH / 2.5e-6 + 8000.0 + rng.standard_normal(len(T)))
    out = run(counts("position_m", "velocity_m_s"), position_m=raw, velocity_m_s=SPEED + 1e-3 * rng.standard_normal(len(T)))
    np.testing.assert_allclose(np.diff(out["position_m"][::100]), np.diff(PATH[::100]), atol=5e-5)
    [remark] = out.preparation.remarks
    found, error = (float(text) for text in re.match(r"position_m: (\S+) ± (\S+) m per count", remark).groups())
    assert abs(found - 2.5e-6) < 3.5 * error < 0.01 * 2.5e-6
    assert "its zero stays that of the counts" in remark


def test_counts_of_a_velocity_are_fitted_to_the_path_with_their_offset():
    raw = SPEED / 1e-5 + 300.0
    out = run(counts("velocity_m_s", "position_m"), velocity_m_s=raw, position_m=PATH)
    np.testing.assert_allclose(out["velocity_m_s"], SPEED, atol=2e-5)


def test_counts_of_a_force_are_fitted_to_pressure_and_area():
    pressure = 1e6 * np.cos(5.0 * T)
    raw = (2e-3 * pressure - 40.0) / 0.7
    given = counts("force_n", "load_pressure_pa", cylinder=Cylinder(2e-3, 2e-3))
    out = run(given, force_n=raw, load_pressure_pa=pressure)
    np.testing.assert_allclose(out["force_n"], 2e-3 * pressure, rtol=1e-9, atol=1e-6)
    assert "0.7 ±" in out.preparation.remarks[0]


@pytest.mark.parametrize(
    ("raw", "complaint"),
    [
        (np.random.default_rng(1).standard_normal(len(T)), "with a correlation of .* only: its scale is not fixed by it"),
        (np.full(len(T), 5.0), "one of them is too short or does not change"),
        (np.where(T < 0.05, PATH, np.nan), "one of them is too short or does not change"),
    ],
)
def test_a_scale_that_is_not_fixed_is_refused(raw: np.ndarray, complaint: str):
    with pytest.raises(BadInput, match=complaint):
        run(counts("position_m", "velocity_m_s"), position_m=raw, velocity_m_s=SPEED)


def test_a_scale_without_its_second_signal_is_refused():
    with pytest.raises(BadInput, match="position_m is to be fitted to velocity_m_s, which is not there"):
        run(counts("position_m", "velocity_m_s"), position_m=PATH)
