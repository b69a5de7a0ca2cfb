"""Two chambers against textbook formulas, conservation, the paper's cylinder, and an independent solution."""

import math
from dataclasses import replace

import numpy as np
import pytest
from reference_single_rod import SingleRodConstants, random_rig, solve_single_rod
from rig_runs import PERIOD, run
from tiers import tiered

from ehls_ros.errors import BadInput
from ehls_ros.physics.integration_step import rates, steps_per_period
from ehls_ros.physics.plant import FRICTION, PL, XV, V, X
from ehls_ros.physics.plausibility import check_rig
from ehls_ros.physics.rig import rig_from_mapping, rig_to_mapping
from ehls_ros.physics.sensitivity import Inputs, sensitivities
from ehls_ros.physics.sensors import FORCE, LOAD_PRESSURE, PRESSURE_A, PRESSURE_B
from ehls_ros.physics.simulator import Simulator

A, B, P = FRICTION + 3, FRICTION + 4, FRICTION + 5
"""Indices of the chambers' states and of the supply pressure, after three friction elements."""

FREE = SingleRodConstants(
    Fc=1e-4, Fs=1e-4, sigma_f=0.0, k=(1.0, 1.0, 1.0), alpha=(0.4, 0.3, 0.3), C=1e-3, B0=0.0, ks=0.0, g=0.0, Ctc=0.0, laminar=1e3
)
"""A single rod without load and friction, with areas of ratio 2 and edges of equal, sharp lands."""

CLOSED = replace(FREE, overlaps=(1e-3,) * 4)
"""Its valve closed at the null position."""


@pytest.fixture
def rig_of(rig_data):
    """Return the rig of some constants."""
    return lambda constants: rig_from_mapping(constants.mapping(rig_data, "gms"), "rig")


def still(cycles):
    """Return the inputs of cycles without command and disturbance."""
    return np.zeros((cycles, 3))


def chambers(states, vapour=-1e5):
    """Return the pressures of both chambers from states."""
    return np.maximum(states[..., A], vapour), np.maximum(states[..., B], vapour)


@pytest.mark.parametrize("seed", tiered(range(20), 0, 1, 4, 8))
def test_agrees_with_an_independent_solution(seed, rig_of):
    random = np.random.default_rng(seed)
    constants = random_rig(random)
    t, (turn, shake) = np.arange(150) * PERIOD, 2.0 * math.pi * random.uniform(1.0, 5.0, 2)
    # Every fourth load runs ahead of the valve and leaves a cavity behind.
    load = (0.6 if seed % 4 == 0 else 0.25) * constants.ps * constants.areas[0]
    force = load * np.sin(shake * t + 0.5), load * shake * np.cos(shake * t + 0.5)
    inputs = np.column_stack([1e-3 * random.uniform(0.2, 0.9) * np.sin(turn * t), *force])
    solution = solve_single_rod(constants, "gms", inputs, PERIOD)
    states, expected = run(Simulator(rig_of(constants)), inputs), solution.y
    found = np.column_stack([states[:, [X, V, XV, P]], *chambers(states)])
    wanted = np.column_stack([expected[:, [0, 1, 3, 11]], expected[:, 7], expected[:, 8]])
    assert solution.events > 5
    assert np.max(np.abs(found - wanted).max(axis=0) / np.abs(wanted).max(axis=0)) < 1e-6


def test_equal_areas_give_the_load_pressure_of_a_double_rod_up_to_the_square_of_the_change_of_volume(rig_of, make_rig):
    """With n times volumes and modulus, 1/n of the volume moves: the mean pressure departs by 1/n, pL by 1/n²."""
    plant = {"leakage_coefficient": 4.7e-12, "gravity": 0.0}
    inputs = np.column_stack([3e-4 * np.sin(2.0 * math.pi * 2.0 * np.arange(500) * PERIOD), still(500)[:, 1:]])
    expected = run(Simulator(make_rig(plant), PERIOD), inputs)
    pressure, mean = [], []
    for n in (4.0, 40.0, 400.0):
        equal = SingleRodConstants(areas=(2.6e-3,) * 2, volumes=(7.5e-4 * n,) * 2, beta_e=6.9e8 * n, g=0.0, laminar=1e2)
        states = run(Simulator(rig_of(equal), PERIOD, 2.5e-4), inputs)
        a, b = chambers(states)
        pressure.append(np.abs(a - b - expected[:, PL]).max() / np.ptp(expected[:, PL]))
        mean.append(np.abs(0.5 * (a + b) - 3.5e6).max())
    assert np.diff(np.log10(pressure)) == pytest.approx([-2.0, -2.0], abs=0.1)
    assert np.diff(np.log10(mean)) == pytest.approx([-1.0, -1.0], abs=0.05)
    assert pressure[-1] < 1e-6


@pytest.mark.parametrize("load", [0.0, 3e3])
def test_speeds_and_pressures_of_steady_motion(load, rig_of):
    """Jelali, Kroll, Hydraulic Servo-systems, 2003, ch. 4: the flow of each edge is that of its chamber."""
    c = replace(FREE, tank=2e5)
    (a, b), opening = c.areas, 2e-4
    gain = c.Cd * c.w * opening * math.sqrt(2.0 / c.rho)
    cubes = a**3 + b**3
    out, back = (
        gain * math.sqrt((c.ps * a - c.tank * b - load) / cubes),
        gain * math.sqrt((c.ps * b - c.tank * a + load) / cubes),
    )
    settled = {}
    for command in (opening, -opening):
        simulator = Simulator(rig_of(c))
        states = run(simulator, np.tile([command, load, 0.0], (1200, 1)))
        settled[command] = states[-1]
    first, second = settled[opening], settled[-opening]
    assert first[V] == pytest.approx(out, rel=1e-6)
    assert second[V] == pytest.approx(-back, rel=1e-6)
    assert chambers(first) == pytest.approx((c.ps - (a * out / gain) ** 2, c.tank + (b * out / gain) ** 2), rel=1e-6)
    assert chambers(second) == pytest.approx((c.tank + (a * back / gain) ** 2, c.ps - (b * back / gain) ** 2), rel=1e-6)


def test_pressures_jump_at_a_reversal(rig_of):
    """Without load, p_A jumps from ps/(1 + φ³) to ps φ²/(1 + φ³), φ the ratio of areas; p_B = φ p_A."""
    c, ratio = FREE, FREE.areas[0] / FREE.areas[1]
    simulator = Simulator(rig_of(c))
    out, back = (run(simulator, np.tile([u, 0.0, 0.0], (1000, 1)))[-1] for u in (2e-4, -2e-4))
    (a, b), (a_back, b_back) = chambers(out), chambers(back)
    assert a == pytest.approx(c.ps / (1.0 + ratio**3), rel=1e-5)
    assert a_back - a == pytest.approx(c.ps * (ratio**2 - 1.0) / (1.0 + ratio**3), rel=1e-5)
    assert (b, b_back) == pytest.approx((ratio * a, ratio * a_back), rel=1e-5)


@pytest.mark.parametrize("position", [-0.3, -0.1, 0.0, 0.15, 0.3])
def test_frequency_of_the_oil_column_by_position(position, rig_of):
    """ω² = βe/m (A²/V_A + A²/V_B), each with its area (Merritt, ch. 6)."""
    c = CLOSED
    simulator = Simulator(rig_of(c), PERIOD, position=position)
    simulator.y[V] = 1e-3
    velocity = run(simulator, still(1000))[:, V]
    volumes = c.volumes[0] + c.areas[0] * position, c.volumes[1] - c.areas[1] * position
    omega = math.sqrt(c.beta_e / c.m0 * (c.areas[0] ** 2 / volumes[0] + c.areas[1] ** 2 / volumes[1]))
    t = np.arange(velocity.size) * PERIOD
    turns = np.flatnonzero(velocity[:-1] * velocity[1:] < 0.0)
    crossed = t[turns] - velocity[turns] * PERIOD / np.diff(velocity)[turns]
    assert math.pi * (turns.size - 1) / (crossed[-1] - crossed[0]) == pytest.approx(omega, rel=3e-4)


def test_oil_in_closed_chambers_is_conserved_while_cavities_open_and_close(rig_of):
    """Oil of density exp(p/βe) fills what no cavity takes."""
    c = replace(CLOSED, B0=4e3, sigma_f=2e3)
    t = np.arange(60000) * PERIOD
    omega = 2.0 * math.pi
    load = 1.6e4
    inputs = np.column_stack([np.zeros_like(t), load * np.sin(omega * t), load * omega * np.cos(omega * t)])
    states = run(Simulator(rig_of(c)), inputs)
    for place, at_zero, area in ((A, c.volumes[0], c.areas[0]), (B, c.volumes[1], -c.areas[1])):
        pressure = np.maximum(states[:, place], c.vapour)
        cavity = (pressure - states[:, place]) * at_zero / c.beta_e
        oil = (at_zero + area * states[:, X] - cavity) * np.exp(pressure / c.beta_e)
        assert np.abs(oil / oil[0] - 1.0).max() < 1e-10
        assert np.count_nonzero(np.diff(np.sign(cavity))) > 50


def test_order_is_5_through_cavitation(rig_of):
    c = replace(CLOSED, B0=4e3, sigma_f=2e3)
    t = np.arange(400) * PERIOD
    omega, load = 2.0 * math.pi * 5.0, 1.6e4
    inputs = np.column_stack([np.zeros_like(t), load * np.sin(omega * t), load * omega * np.cos(omega * t)])
    exact, coarse, fine = (
        run(Simulator(rig_of(c), PERIOD, step), inputs)[:, [X, V, A, B]] for step in (3.125e-5, 1e-3, 2.5e-4)
    )
    assert np.any(exact[:, 2:] < c.vapour)
    errors = [np.max(np.abs(some - exact).max(axis=0) / np.abs(exact).max(axis=0)) for some in (coarse, fine)]
    assert 4.5 < math.log(errors[0] / errors[1]) / math.log(4.0) < 5.7


def test_readings_have_both_chambers_and_the_force_between_them(rig_of):
    rig = rig_of(FREE)
    simulator = Simulator(rig)
    run(simulator, np.tile([1e-4, 500.0, 0.0], (20, 1)))
    readings = dict(zip(rig.sensed, simulator.measure(np.zeros(9)), strict=True))
    assert readings["force"] == pytest.approx(2e-3 * readings["pressure_a"] - 1e-3 * readings["pressure_b"])
    assert readings["load_pressure"] == pytest.approx(readings["force"] / 1.5e-3)
    assert (rig.sensed.index("pressure_a"), rig.sensed.index("pressure_b")) == (PRESSURE_A, PRESSURE_B)
    assert simulator.truth[FORCE] == readings["force"] == pytest.approx(1.5e-3 * simulator.truth[LOAD_PRESSURE])


@pytest.mark.long
def test_derivatives_agree_with_differences(rig_of):
    rig = rig_of(replace(random_rig(np.random.default_rng(4)), hoses=(2e-13, 1e-13)))
    t = np.arange(200) * PERIOD
    load = 0.6 * rig.plant.supply_pressure * rig.cylinder.parameters.area_a
    inputs = Inputs(4e-4 * np.sin(20.0 * t), load * np.sin(15.0 * t + 0.5), load * 15.0 * np.cos(15.0 * t + 0.5))
    keys = ["area_a", "volume_b", "leakage_a", "supply_resistance"]
    paths = [*(f"cylinder.{key}" for key in keys), "valve.gain_bt", "plant.bulk_modulus"]
    found = sensitivities(rig, paths, inputs)

    def changed(path, factor):
        section, key = path.split(".")
        if section == "plant":
            return rig.with_plant(**{key: rig.plant.bulk_modulus * factor})
        use = getattr(rig, section)
        value = getattr(use.parameters, key) * factor
        other = rig._replace(**{section: use._replace(parameters=use.parameters._replace(**{key: value}))})
        return other.with_plant(**other.cylinder.law.derived(other.cylinder.parameters))

    for column, path in enumerate(paths):
        more, less = (sensitivities(changed(path, 1.0 + h), [], inputs).readings for h in (1e-5, -1e-5))
        section, key = path.split(".")
        value = getattr(getattr(rig, section) if section == "plant" else getattr(rig, section).parameters, key)
        expected = (more - less) / (2e-5 * value)
        # Spool and temperature depend on none of them.
        depend = [place for place, signal in enumerate(rig.sensed) if signal not in ("spool_position", "oil_temperature")]
        away = np.abs(found.derivatives[:, depend, column] - expected[:, depend]).max(axis=0)
        assert np.max(away / np.abs(expected[:, depend]).max(axis=0)) < 1e-4, path


def test_step_follows_the_stiffer_chamber(rig_of):
    short = replace(FREE, laminar=1e5)
    tight = replace(short, volumes=(short.volumes[0], 3.05e-4))
    flow = [next(part.rate for part in rates(rig_of(c)) if part.what == "valve's flow") for c in (short, tight)]
    assert flow[1] > 1.5 * flow[0]
    assert steps_per_period(rig_of(tight), PERIOD) >= steps_per_period(rig_of(short), PERIOD)


def test_a_rig_file_is_read_as_written(rig_of):
    rig = rig_of(random_rig(np.random.default_rng(1)))
    written = rig_to_mapping(rig)
    assert {"piston_area", "total_volume"}.isdisjoint(written["plant"])
    assert rig_from_mapping(written, "rig") == rig
    check_rig(rig, "rig")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"plant": {"piston_area": 1e-3}}, "key 'piston_area' is given"),
        ({"valve": {"model": "load_flow"}}, "load_flow has no flow for cylinder two_chamber"),
        ({"effects": [{"name": "empirical_leakage"}]}, "'empirical_leakage' acts on a load pressure"),
        ({"effects": [{"name": "entrained_air", "load": 0.01}]}, "load of effect 'entrained_air' is 0.01"),
        ({"cylinder": {"area_b": 1e-6}}, "area_a is 0.002 and area_b 1e-06"),
        ({"cylinder": {"model": "three_chamber"}}, "three_chamber"),
    ],
)
def test_a_contradictory_rig_file_is_refused(change, message, rig_data):
    data = FREE.mapping(rig_data, "gms")
    for section, values in change.items():
        data[section] = {**data[section], **values} if isinstance(values, dict) and section != "valve" else values
    with pytest.raises(BadInput, match=message):
        rig_from_mapping(data, "rig")


def test_a_chamber_smaller_than_the_stroke_is_refused(rig_of):
    rig = rig_of(FREE).with_cylinder(volume_b=2.9e-4)
    with pytest.raises(BadInput, match=r"volume_b is 0\.00029 m\^3, and the chamber has .* left at position 0\.3 m"):
        check_rig(rig, "rig")


def test_a_leak_to_outside_is_the_effect_or_the_coefficient(rig_data):
    """Each chamber's own: the effect adds to the coefficients of the rig file."""
    data = FREE.mapping(rig_data, "gms")
    leaking = rig_from_mapping({**data, "effects": [{"name": "external_leakage", "first": 2e-12, "each": 1e-12}]}, "rig")
    own = rig_from_mapping({**data, "cylinder": {**data["cylinder"], "leakage_a": 3e-12, "leakage_b": 1e-12}}, "rig")
    assert leaking.effective().cylinder == own.effective().cylinder


def test_air_softens_the_chamber_of_low_pressure(rig_data):
    """A closed chamber is compressed as oil and air (Merritt, ch. 2): V (dp/β + x (p0/p)^(1/n) dp/(n p)) = A dx."""
    air, n = 0.02, 1.4
    data = {**CLOSED.mapping(rig_data, "gms"), "effects": [{"name": "entrained_air", "chambers": air}]}
    data["cylinder"] |= {"area_b": 1e-4, "volume_b": 1.0}
    simulator = Simulator(rig_from_mapping(data, "rig"))
    turned, force = 10.0 * np.arange(400) * PERIOD, 3e3
    inputs = np.column_stack([np.zeros(400), force * np.sin(turned), 10.0 * force * np.cos(turned)])
    states = run(simulator, inputs)
    a, (x, pressure) = CLOSED.areas[0], (states[:, X], states[:, A])

    def filled(p):
        absolute = 101325.0 + p
        return np.exp(-p / CLOSED.beta_e + air * (101325.0 / absolute) ** (1.0 / n))

    volume = CLOSED.volumes[0] + a * x
    assert np.ptp(pressure) > 1e6
    np.testing.assert_allclose(volume / volume[0], filled(pressure) / filled(pressure[0]), rtol=1e-9)
