"""Discrimination gained from a missing signal, according to the models."""

import numpy as np
import pytest

from ehls_ros.diagnosis import stages
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.fit import Fit
from ehls_ros.diagnosis.hypotheses import candidates, extended
from ehls_ros.diagnosis.missing_signals import deciding, untried
from ehls_ros.diagnosis.record import prepare
from ehls_ros.trajectory import Trajectory

FEW = ("valve_command_m", "load_pressure_pa", "position_m", "disturbance_force_n")


@pytest.fixture(scope="module")
def gathered(rig, recorded):
    """Return the evidence of some columns of one recording."""
    r = recorded({}, "rich", seed=3, duration=6.0)

    def gathered(columns):
        record = prepare(Trajectory(r.time, {name: r.columns[name] for name in columns}), rig, "it")
        return gather(record, rig, stages.setup(record, rig), 0)

    return gathered


def fitted(evidence, name, *values):
    """Return an effect as if fitted with these values of its first form."""
    candidate = next(c for c in candidates(evidence.record, evidence.rig, ())[0] if c.name == name)
    values = np.array(values)
    residuals = evidence.residuals(evidence.comparison(), extended(evidence.rig, (candidate,), values))
    return Fit((candidate,), values, evidence.channels, residuals, np.empty((0, 0)), 0.0, values)


def test_each_missing_signal_tells_what_shows_in_it(gathered):
    evidence = gathered(FEW)
    pressure = fitted(evidence, "pressure_sensor_bias", 5e4)
    load = fitted(evidence, "constant_load", 130.0)
    zero = fitted(evidence, "position_sensor_bias", 1e-3)
    late = fitted(evidence, "command_delay", 4e-3)
    scale = fitted(evidence, "position_sensor_gain", 1.02)
    droop = fitted(evidence, "supply_pressure_droop", 1e9)
    # A load cell reveals errors of the pressure sensor; a load shows in neither, nor does a shifted zero in a speed.
    assert deciding(evidence, pressure, load) == ("force_n",)
    assert deciding(evidence, zero, load) == ()
    assert deciding(evidence, scale, load) == ("velocity_m_s",)
    assert deciding(evidence, late, load) == ("spool_m",)
    assert deciding(evidence, droop, load) == ("supply_pressure_pa",)


def test_what_is_recorded_tells_nothing_more(gathered):
    evidence = gathered([*FEW, "spool_m", "force_n", "velocity_m_s", "supply_pressure_pa"])
    assert deciding(evidence, fitted(evidence, "pressure_sensor_bias", 5e4), fitted(evidence, "constant_load", 130.0)) == ()


def test_without_a_thermometer_friction_may_be_that_of_another_temperature(gathered):
    evidence = gathered(FEW)
    nothing = Fit((), np.empty(0), (), evidence.base, np.empty((0, 0)), 0.0, np.empty(0))
    whole = {"temperature_dependent_friction": ("oil_temperature_k",)}
    assert untried(evidence, fitted(evidence, "coulomb_shift", 60.0), nothing) == whole
    assert untried(evidence, fitted(evidence, "viscous_shift", 300.0), nothing) == whole
    # No temperature makes friction differ by direction.
    assert untried(evidence, fitted(evidence, "viscous_asymmetry", 300.0), nothing) == {}
    # Nor does it change the valve.
    evidence = gathered([*FEW, "spool_m"])
    assert untried(evidence, fitted(evidence, "valve_null_bias", 5e-5), nothing._replace(residuals=evidence.base)) == {}
    measured = gathered([*FEW, "oil_temperature_k"])
    assert untried(measured, fitted(measured, "coulomb_shift", 60.0), nothing) == {}
