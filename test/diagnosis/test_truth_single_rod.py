"""The single rod of the truth generator: the rig file's model, conserved oil, the double rod as a limit, effects by side."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.integrate import cumulative_trapezoid
from tiers import tiered

from ehls_ros.physics.plant import FRICTION, XV, V, X
from ehls_ros.physics.rig import rig_from_mapping
from ehls_ros.physics.simulator import Simulator
from truth_generator import draw_effect, record
from truth_generator.effects import SINGLE_ROD, SINGLE_ROD_OUTSIDE, effects_of
from truth_generator.residuals import edge_flows, model_residuals, rms
from truth_generator.single_rod import COLUMNS
from truth_generator.visibility import against, background

CONFIG = Path(__file__).parents[2] / "config"
RIG = yaml.safe_load((CONFIG / "rig_single_rod.yaml").read_text(encoding="utf-8"))
PAPER = yaml.safe_load((CONFIG / "rig_paper_measured.yaml").read_text(encoding="utf-8"))
ALL = effects_of(RIG)


@pytest.mark.parametrize("experiment", tiered(["rich", "paper_sine", "steps", "random"], "rich"))
def test_with_nothing_hidden_it_is_the_rig_files_model(experiment):
    c = record(RIG, {}, experiment, seed=4, duration=6.0, noise=0.0, hold=True).columns
    simulator = Simulator(rig_from_mapping(RIG, "rig").quiet(), 1e-3, 5e-5)
    y, oil = simulator.state.y, FRICTION + len(RIG["friction"]["element_weight"])
    y[X], y[oil], y[oil + 1] = (c[name][0] for name in ("position_m", "pressure_a_pa", "pressure_b_pa"))
    states = [y.copy()]
    for command, force in zip(c["valve_command_m"][:-1], c["disturbance_force_n"][:-1], strict=True):
        simulator.advance(command, force, 0.0, 0.0, 0.0)
        states.append(y.copy())
    replayed = np.array(states)
    places = {"position_m": X, "velocity_m_s": V, "spool_m": XV, "pressure_a_pa": oil, "pressure_b_pa": oil + 1}
    for name, place in (places | {"supply_pressure_pa": oil + 2}).items():
        assert np.abs(replayed[:, place] - c[name]).max() < 1e-6 * np.abs(c[name]).max(), name


def test_oil_is_neither_made_nor_lost():
    # A rig whose every way for oil is open.
    cylinder = RIG["cylinder"] | {"leakage_a": 3e-12, "leakage_b": 5e-12}
    rig = RIG | {"cylinder": cylinder, "plant": RIG["plant"] | {"leakage_coefficient": 1e-11}}
    r = record(rig, {}, "rich", seed=3, duration=12.0, noise=0.0, rate=4000.0)
    c, tank = r.columns, cylinder["tank_pressure"]
    a, b, x = (c[name] for name in ("pressure_a_pa", "pressure_b_pa", "position_m"))
    pa, at, pb, bt = edge_flows(rig, c["spool_m"], c["supply_pressure_pa"], a, b)
    for pressure, volume, flow, past, side in (
        (a, cylinder["volume_a"] + cylinder["area_a"] * x, pa - at, -1e-11 * (a - b), "a"),
        (b, cylinder["volume_b"] - cylinder["area_b"] * x, pb - bt, 1e-11 * (a - b), "b"),
    ):
        lost = cylinder[f"leakage_{side}"] * (pressure - tank)
        taken = cumulative_trapezoid(flow + past - lost, r.time)
        widened = cylinder[f"hose_compliance_{side}"] * (pressure[1:] - pressure[0])
        compressed = cumulative_trapezoid(volume / RIG["plant"]["bulk_modulus"], pressure) + widened
        left = taken - compressed - (volume[1:] - volume[0])
        assert np.abs(left).max() < 1e-6 * cumulative_trapezoid(np.abs(flow), r.time)[-1]


def test_with_equal_areas_it_is_the_double_rod():
    # A stiff oil in large chambers: as compliant, and the same at every position.
    plant = {key: value for key, value in PAPER["plant"].items() if key not in ("piston_area", "total_volume")}
    half, area, larger = 0.5 * PAPER["plant"]["total_volume"], PAPER["plant"]["piston_area"], 1e6
    single = PAPER | {
        "plant": plant | {"bulk_modulus": larger * plant["bulk_modulus"]},
        "cylinder": {
            "model": "two_chamber", "area_a": area, "area_b": area, "volume_a": larger * half, "volume_b": larger * half,
        },
        "valve": {"model": "four_edges", "transition_pressure": 1.0},
    }  # fmt: skip
    one = record(single, {}, "rich", seed=6, duration=6.0, noise=0.0).columns
    two = record(PAPER, {}, "rich", seed=6, duration=6.0, noise=0.0).columns
    load = one["pressure_a_pa"] - one["pressure_b_pa"]
    assert np.abs(load - two["load_pressure_pa"]).max() < 1e-5 * np.abs(two["load_pressure_pa"]).max()
    for name in ("valve_command_m", "position_m", "velocity_m_s", "force_n"):
        assert np.abs(one[name] - two[name]).max() < 1e-5 * np.abs(two[name]).max(), name


@pytest.mark.parametrize("name", tiered(ALL, *list(ALL)[::5]))
def test_a_neutral_size_changes_nothing(name):
    plain, neutral = (record(RIG, hidden, "rich", seed=5, duration=1.0).columns for hidden in ({}, {name: {}}))
    assert list(plain) == list(COLUMNS)
    assert all(np.array_equal(neutral[column], plain[column]) for column in COLUMNS)


@pytest.fixture(scope="module")
def rich_background():
    return background(RIG, "rich", seed=2, duration=20.0)


@pytest.mark.parametrize("name", tiered(ALL, *list(ALL)[::5], "swapped_pressure_sensors"))
def test_drawn_sizes_stand_out_of_the_noise(name, rich_background):
    sizes = draw_effect(name, np.random.default_rng([0, *name.encode()]), RIG)
    seen = against(rich_background, RIG, record(RIG, {name: sizes}, "rich", seed=2, duration=20.0, noise=0.0))
    assert max(seen.values()) > (1.3 if name in SINGLE_ROD_OUTSIDE else 0.3), seen


SIDED = {
    "external_leakage": {"coefficient": 8e-12},
    "hose_compliance": {"compliance": 8e-13},
    "entrained_air": {"fraction": 0.04},
    "edge_gain": {"factor": 1.1},
    "edge_wear": {"worn": 2e-5},
}


@pytest.mark.parametrize("name", SIDED)
@pytest.mark.parametrize("side", ["a", "b"])
def test_an_effect_of_one_side_shows_in_the_oil_of_its_chamber(name, side, rich_background):
    sizes = SIDED[name] | {"side": side}
    if name.startswith("edge"):
        sizes["edge"] = {"a": "pa", "b": "bt"}[side]
    r = record(RIG, {name: sizes}, "rich", seed=2, duration=20.0, noise=0.0)
    rows = zip(model_residuals(RIG, r)["flow"], rich_background.left["flow"], rich_background.floor["flow"], strict=True)
    shown = dict(zip("ab", [rms(with_it - without) / noise for with_it, without, noise in rows], strict=False))
    other = "b" if side == "a" else "a"
    assert shown[side] > 2.0
    assert shown[other] < 0.2 * shown[side]


def test_swapped_sensors_exchange_the_readings_and_leave_the_motion_alone():
    straight, swapped = (
        record(RIG, hidden, "random", seed=2, duration=4.0, noise=0.0).columns
        for hidden in ({}, {"swapped_pressure_sensors": {"swapped": 1.0}})
    )
    assert np.array_equal(swapped["pressure_a_pa"], straight["pressure_b_pa"])
    assert np.array_equal(swapped["pressure_b_pa"], straight["pressure_a_pa"])
    assert np.array_equal(swapped["position_m"], straight["position_m"])


@pytest.mark.parametrize("experiment", tiered(["rich", "random", "steps", "paper_sine"], "rich"))
def test_no_chamber_cavitates_and_the_piston_stays_within_its_stroke_whatever_is_hidden(experiment):
    vapour, (low, high) = RIG["cylinder"]["vapour_pressure"], RIG["limits"]["position"]
    for seed, name in enumerate(name for name, effect in SINGLE_ROD.items() if effect.stage != "sensors"):
        hidden = {name: draw_effect(name, np.random.default_rng([seed, 1]), RIG)}
        c = record(RIG, hidden, experiment, seed=seed, duration=4.0, noise=0.0).columns
        assert min(c["pressure_a_pa"].min(), c["pressure_b_pa"].min()) > vapour + 2e5, hidden
        assert low < c["position_m"].min() < c["position_m"].max() < high, hidden


def test_the_noise_is_that_of_the_rig_files_sensors():
    plain, noisy = (record(RIG, {}, "rest", seed=7, duration=5.0, noise=noise).columns for noise in (0.0, 1.0))
    for side in "ab":
        # The controller reacts to noise, slowly.
        spread = np.std(np.diff(noisy[f"pressure_{side}_pa"] - plain[f"pressure_{side}_pa"])) / np.sqrt(2.0)
        assert spread == pytest.approx(np.hypot(2.5e3, 1e3 / np.sqrt(12.0)), rel=0.05)


def test_a_rig_beyond_the_generator_is_refused():
    with pytest.raises(ValueError, match="four_edges"):
        record(RIG | {"valve": {"model": "load_flow"}}, {}, "rich", seed=1, duration=1.0)
    with pytest.raises(ValueError, match="two_chamber"):
        record(RIG | {"cylinder": RIG["cylinder"] | {"damper": 1.0}}, {}, "rich", seed=1, duration=1.0)
    with pytest.raises(KeyError, match="hinge_backlash"):
        record(RIG, {"hinge_backlash": {"gap": 1e-4}}, "rich", seed=1, duration=1.0)
