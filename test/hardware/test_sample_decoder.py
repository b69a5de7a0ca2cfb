"""The load pressure of a single rod from the sensors that it has."""

import math

import pytest

from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_rig
from ehls_ros.hardware.calibration import Calibration, Input, Output
from ehls_ros.hardware.sample_decoder import SampleDecoder
from ehls_ros.physics import sensors

SINGLE, DOUBLE = (load_rig(configured(name)) for name in ("rig_single_rod", "rig_paper"))
SCALES = {"position": 0.01, "force": 5e3, "pressure_a": 2.5e6, "pressure_b": 2.5e6, "load_pressure": 2e6}


def wired(*names):
    return Calibration({name: Input(channel, scale=SCALES[name]) for channel, name in enumerate(names)}, Output(0, scale=1e-4))


def load_pressure(rig, **volts):
    calibration = wired(*volts)
    readings, _ = SampleDecoder(calibration, rig).decode([volts[name] for name in calibration.wired])
    return readings[sensors.LOAD_PRESSURE]


def test_the_pressures_of_both_chambers_give_the_load_pressure():
    p, mean = SINGLE.cylinder.parameters, SINGLE.plant.piston_area
    force = p.area_a * 5e6 - p.area_b * 2.5e6
    assert load_pressure(SINGLE, position=0.0, force=0.0, pressure_a=2.0, pressure_b=1.0) == pytest.approx(force / mean)


def test_without_them_it_is_that_of_the_load_cell():
    assert load_pressure(SINGLE, position=0.0, force=2.0) == pytest.approx(1e4 / SINGLE.plant.piston_area)
    assert load_pressure(SINGLE, position=0.0, force=2.0, pressure_a=1.0) == pytest.approx(1e4 / SINGLE.plant.piston_area)


def test_a_sensor_of_its_own_is_read():
    assert load_pressure(SINGLE, position=0.0, force=2.0, load_pressure=1.0) == 2e6


def test_it_is_not_known_without_any_of_these_or_on_a_double_rod():
    assert math.isnan(load_pressure(SINGLE, position=0.0))
    assert math.isnan(load_pressure(DOUBLE, position=0.0, force=2.0))
    known = {rig.cylinder.model: SampleDecoder(wired("position", "force"), rig).measured for rig in (SINGLE, DOUBLE)}
    assert {model: "load_pressure" in measured for model, measured in known.items()} == {
        "two_chamber": True,
        "double_rod": False,
    }


def test_a_saturated_load_cell_leaves_it_unknown():
    readings, saturated = SampleDecoder(wired("position", "force"), SINGLE).decode([0.0, 10.0])
    assert math.isnan(readings[sensors.LOAD_PRESSURE])
    assert saturated == ("force",)
