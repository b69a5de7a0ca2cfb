"""The causal limit of experiments and recordings, and the entry where there is none."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from ehls_ros.experiments.causal_limit import evaluate_recording, limit_of_run, with_causal_limit
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.spec import load_spec


@pytest.fixture(scope="module")
def specs(config):
    """Two experiments with the large disturbance: perfect sensors, and those of a rig; 3 s of each."""
    found = (load_spec(config / "experiments" / f"{name}.yaml") for name in ("sine_fd2", "measured_sine_fd2"))
    return tuple(spec._replace(settings=spec.settings._replace(duration=3.0)) for spec in found)


@pytest.fixture(scope="module")
def runs(specs):
    """A run of each."""
    return tuple(map(run_in_process, specs))


def test_no_law_is_below_the_limit(runs):
    perfect, measured = (with_causal_limit(evaluate(run), run) for run in runs)
    assert 0.0 < perfect.causal_limit_n < 0.1
    assert perfect.max_error_n > 10.0
    assert 20.0 < measured.causal_limit_n < measured.max_error_n
    assert limit_of_run(runs[1]).limit.horizon == 2e-3


def test_a_recording_that_went_through_json_has_the_same_limit(runs):
    again = replace(runs[1], metadata=json.loads(json.dumps(runs[1].metadata)))
    assert evaluate_recording(again).causal_limit_n == limit_of_run(runs[1]).limit.largest


def test_a_few_missed_cycles_do_not_matter(runs):
    signals = {name: values.copy() for name, values in runs[1].signals.items()}
    for name in ("disturbance_displacement_m", "disturbance_velocity_m_s", "spool_m"):
        signals[name][100:103] = np.nan
    found = limit_of_run(replace(runs[1], signals=signals)).limit
    assert found.largest == pytest.approx(limit_of_run(runs[1]).limit.largest, rel=1e-3)


def test_what_has_no_limit_says_why(runs, config):
    run = runs[1]
    unknown = {name: values for name, values in run.signals.items() if not name.startswith("disturbance")}
    gaps = {
        **run.signals,
        "disturbance_velocity_m_s": np.where(np.arange(len(run)) % 10, run["disturbance_velocity_m_s"], np.nan),
    }
    position = load_spec(config / "experiments" / "friction_sweep_quick.yaml")
    broken = {**run.metadata, "spec": {**run.metadata["spec"], "duration": -1.0}}
    cases = {
        "position": limit_of_run(run_in_process(position)),
        "rig and experiment": limit_of_run(replace(run, metadata={})),
        "cannot be read": limit_of_run(replace(run, metadata=broken)),
        "not recorded": limit_of_run(replace(run, signals=unknown)),
        "too many cycles": limit_of_run(replace(run, signals=gaps)),
    }
    for words, (limit, reason) in cases.items():
        assert limit is None
        assert words in reason
    metrics = with_causal_limit(evaluate(run), replace(run, signals=unknown))
    assert math.isnan(metrics.causal_limit_n)
    assert json_document(metrics)["causal_limit_n"] is None
