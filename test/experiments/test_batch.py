"""Many runs side by side, compared with separate runs."""

import copy
import json

import numpy as np
import pytest

from ehls_ros.errors import BadInput
from ehls_ros.experiments.batch import MIN_TOGETHER, is_ready, run_batch
from ehls_ros.experiments.campaign.work import code_version, run_chunk, run_one
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.run_failure import Implausible
from ehls_ros.experiments.spec import spec_to_mapping
from ehls_ros.physics.lane_memory import LANES

RUNS = LANES + MIN_TOGETHER
DURATION = 0.6
REFERENCES = (
    {"name": "sine", "amplitude": 8e3, "frequency": 2.0},
    {"name": "triangle", "amplitude": 5e3, "frequency": 1.5},
    {"name": "constant", "value": 6e3},
)


@pytest.fixture
def make_run(make_spec, rig_mapping):
    """Return a maker of runs of one structure: stick and slip, a hysteresis, an end stop and noise, all of different sizes."""

    def make(index, **sections):
        vary = np.random.default_rng(index).uniform
        rig = copy.deepcopy(rig_mapping)
        for key in ("supply_pressure", "bulk_modulus", "moving_mass", "valve_bandwidth"):
            rig["plant"][key] *= vary(0.9, 1.1)
        rig["friction"]["coulomb_force"] *= vary(0.7, 1.0)
        rig["friction"]["stribeck_exponent"] *= vary(0.8, 2.0)
        stop = {"name": "end_stop", "upper": vary(0.002, 0.01), "stiffness": vary(1e6, 2e6), "exponent": vary(1.0, 1.5)}
        rig["effects"] = [{"name": "valve_hysteresis", "width": vary(0.0, 1e-5)}, stop]
        rig["sensors"] = {"load_pressure": {"noise_std": 1e3, "resolution": 500.0}, "velocity": {"noise_std": 1e-4}}
        rig["limits"] |= sections.pop("limits", {})
        signal = {"name": "sine", "amplitude": vary(1e3, 5e3), "frequency": vary(1.0, 4.0)}
        return make_spec(
            rig=rig,
            reference=REFERENCES[index % len(REFERENCES)],
            disturbance={"name": "force", "signal": signal},
            duration=DURATION,
            seed=index,
            **sections,
        )

    return make


def assert_same(run, expected):
    """Compare two runs to the last bit."""
    assert list(run.signals) == list(expected.signals)
    np.testing.assert_array_equal(run.time_s, expected.time_s)
    for name, values in expected.signals.items():
        np.testing.assert_array_equal(run[name], values, err_msg=name)
        np.testing.assert_array_equal(np.signbit(run[name]), np.signbit(values), err_msg=name)


@pytest.mark.long
def test_each_run_has_the_numbers_it_has_by_itself(make_run):
    specs = [make_run(index) for index in range(RUNS)]
    # Two violate their limits at once, and another has other sizes than the rest.
    for index in (0, 3):
        specs[index] = make_run(index, limits={"velocity": 2e-3})
    specs[7] = make_run(7, compensation={"name": "gms", "steps": 5})
    results = dict(run_batch(specs, threads=2))
    assert is_ready(specs[1])
    assert sorted(results) == list(range(RUNS))
    modes = set()
    for index, spec in enumerate(specs):
        result = results[index]
        if index in {0, 3}:
            assert isinstance(result, Implausible)
            with pytest.raises(Implausible) as alone:
                run_in_process(spec)
            assert str(result) == str(alone.value)
            result, expected = result.trajectory, alone.value.trajectory
        else:
            expected = run_in_process(spec)
        assert_same(result, expected)
        modes.update(map(tuple, result["friction_slipping"]))
    # The elements stick and slip.
    assert len(modes) > 3


def test_too_few_for_lanes_run_by_themselves_and_an_error_is_that_runs_own(make_run):
    fine = make_run(0)
    mistaken = fine._replace(rig=fine.rig._replace(plant=fine.rig.plant._replace(supply_pressure=70.0)))
    results = dict(run_batch(iter([fine, mistaken])))
    assert isinstance(results[1], BadInput)
    assert "70" in str(results[1])
    assert_same(results[0], run_in_process(fine))
    assert sorted(results) == [0, 1]


def test_the_loop_of_what_runs_by_itself_is_never_ready(make_spec):
    servo = {"name": "position_servo", "signal": {"name": "constant", "value": 0.0}}
    assert not is_ready(make_spec(disturbance=servo))


@pytest.mark.long
def test_a_campaigns_runs_side_by_side_have_the_metrics_they_have_alone(make_run):
    runs = [json.dumps(json_document(spec_to_mapping(make_run(index)))) for index in range(MIN_TOGETHER)]
    unreadable = json.dumps({**json.loads(runs[0]), "duration": -1.0})
    impossible = json.dumps({**json.loads(runs[0]), "initial_position": 1.0})
    together = [*runs[:2], unreadable, *runs[2:], impossible]
    rows = run_chunk(together, code_version(), side_by_side=True)
    for row, spec in zip(rows, together, strict=True):
        expected = run_one(spec)
        assert row.pop("wall_s") >= 0.0
        assert row == {name: value for name, value in expected.items() if name != "wall_s"}
    assert [row["error"] is None for row in rows] == [True, True, False, *[True] * (MIN_TOGETHER - 2), False]
