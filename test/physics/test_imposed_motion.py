"""The model along a recording of a few samples, against numbers worked out by hand."""

import math

import numpy as np
import pytest
from rig_runs import PERIOD, SINGLE_ROD_RIG

from ehls_ros.experiments.spec import load_rig
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.imposed_motion import PARTS, run_part
from ehls_ros.physics.imposed_motion.base import ModelRun, Motion
from ehls_ros.physics.imposed_motion.chambers import Chambers
from ehls_ros.physics.imposed_motion.friction import FrictionInputs
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import EffectUse
from ehls_ros.schema import declarations

SAMPLES = 50
TIME = PERIOD * np.arange(SAMPLES)


def still(**signals):
    """Return a recording in which only the given signals change."""
    rest = dict.fromkeys(Motion._fields, np.zeros(SAMPLES)) | {"time": TIME, "temperature": np.full(SAMPLES, 313.15)}
    return Motion(**(rest | {name: np.array(values, dtype=np.float64) for name, values in signals.items()}))


def along(part, rig, motion, given=None, steps=0, history=0, fresh=(0,)):
    effective, kind = rig.effective(), PARTS[part]
    begins = np.isin(np.arange(SAMPLES), fresh)
    effects = kind.effects.parameters(rig.effects)
    a = ModelRun(motion, begins, PERIOD, steps, history, effective.plant, effective.friction, effects)
    return run_part(part, effective, a, given)


def test_the_spool_follows_a_step_exponentially(make_rig):
    rig = make_rig()
    spool = along("spool", rig, still(command=np.full(SAMPLES, 1e-4)))[:, 0]
    expected = 1e-4 * rig.plant.valve_gain * (1.0 - np.exp(-rig.plant.valve_bandwidth * TIME))
    np.testing.assert_allclose(spool, expected, rtol=1e-12, atol=1e-20)


def test_a_late_command_reaches_the_spool_late(make_rig):
    late = make_rig(effects=[{"name": "command_delay", "delay": 0.0025}])
    step = 1e-4 * (TIME >= 0.01 - 1e-9)
    spool = along("spool", late, still(command=step), history=50)[:, 0]
    since = np.maximum(TIME - 0.0125, 0.0)
    expected = 1e-4 * late.plant.valve_gain * (1.0 - np.exp(-late.plant.valve_bandwidth * since))
    np.testing.assert_allclose(spool, expected, rtol=1e-9, atol=1e-18)


def test_a_fresh_stretch_starts_at_the_recorded_spool(make_rig):
    spool = along("spool", make_rig(), still(spool=np.full(SAMPLES, 2e-4)), fresh=(0, 20))[:, 0]
    assert spool[0] == spool[20] == 2e-4
    assert 0.0 < spool[19] < 2e-4


def test_the_flow_is_that_of_the_orifice(make_rig):
    rig = make_rig(effects=[{"name": "turbulent_leakage", "coefficient": 1e-8}])
    p = rig.plant
    flow, leak, modulus, supply = along("flow", rig, still(spool=np.full(SAMPLES, 1e-4), pressure=np.full(SAMPLES, 4e6)))[7]
    root = math.sqrt((p.supply_pressure - 4e6) / p.oil_density)
    assert flow == pytest.approx(p.discharge_coefficient * p.valve_area_gradient * 1e-4 * root, rel=1e-12)
    assert leak == pytest.approx(p.leakage_coefficient * 4e6 + 2e-5, rel=1e-12)
    assert (modulus, supply) == (p.bulk_modulus, p.supply_pressure)


def test_elements_that_stick_are_springs(make_rig):
    rig = make_rig()
    velocity = 1e-6 * np.arange(SAMPLES)
    nothing = FrictionInputs(np.zeros(SAMPLES), np.zeros(SAMPLES), 1.0)
    force = along("friction", rig, still(velocity=velocity), nothing, steps=1)[:, 0]
    way = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]))]) * PERIOD
    expected = sum(rig.friction.element_stiffness) * way + rig.friction.viscous_coefficient * velocity
    np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-12)


def test_a_static_model_at_rest_holds_what_is_applied(make_rig):
    rig = make_rig(friction={"model": "stribeck"}, plant={"gravity": 0.0})
    # It moves, stops, and is pushed with less than the holding force.
    velocity = np.where(np.arange(SAMPLES) < 20, 1e-3, 0.0)
    nothing = FrictionInputs(np.zeros(SAMPLES), np.zeros(SAMPLES), 1.0)
    motion = still(velocity=velocity, pressure=np.full(SAMPLES, 1e5))
    force = along("friction", rig, motion, nothing, steps=1)[:, 0]
    assert force[5] > rig.friction.coulomb_force
    np.testing.assert_allclose(force[21:], rig.plant.piston_area * 1e5, rtol=1e-12)


@pytest.mark.parametrize("balance", [300.0, -5e4])
def test_a_start_balances_the_other_forces_as_far_as_it_can(make_rig, balance):
    rig = make_rig()
    inputs = FrictionInputs(np.zeros(SAMPLES), np.full(SAMPLES, balance), 1.0)
    force = along("friction", rig, still(), inputs, steps=1)[0, 0]
    assert force == pytest.approx(max(balance, -rig.friction.static_force))


@pytest.mark.parametrize("part", [name for name, part in PARTS.items() if part.coefficients != Plant._fields])
def test_a_part_depends_on_no_other_coefficients_than_it_names(part, make_rig):
    kind, wave = PARTS[part], np.sin(60.0 * TIME)
    rig = load_rig(SINGLE_ROD_RIG) if kind.has_chambers else make_rig()
    effective = rig.effective()
    motion = still(position=0.01 * wave, velocity=0.1 * wave, pressure=4e6 * wave, spool=2e-4 * wave, command=3e-4 * wave)
    given = {
        "friction": FrictionInputs(np.zeros(SAMPLES), np.zeros(SAMPLES), 1.0),
        "chambers": Chambers(
            6e6 + 4e6 * wave, 6e6 - 4e6 * wave, 1e7 + wave, True, effective.cylinder.parameters, effective.valve.parameters
        ),
    }.get(part)

    def run(use, plant):
        a = ModelRun(motion, np.arange(SAMPLES) == 0, PERIOD, 4, 60, plant, effective.friction, kind.effects.parameters((use,)))
        return run_part(part, effective, a, given)

    read = set()
    for name in kind.effects.names:
        moved = {d.name: d.default + 1e-3 * (d.maximum - d.default) for d in declarations(EFFECTS.load(name).Parameters)}
        use = EffectUse(name, EFFECTS.load(name).Parameters(**moved))
        for field in Plant._fields:
            changed = effective.plant._replace(**{field: 1.1 * getattr(effective.plant, field)})
            if not np.array_equal(run(use, changed), run(use, effective.plant)):
                read.add(field)
    assert read == set(kind.coefficients)
