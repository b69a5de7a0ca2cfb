"""Kernels compiled in parallel before they are run."""

from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest
import yaml

import truth_generator
from ehls_ros.arrays import kernel
from ehls_ros.diagnosis import stages
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.stages import Comparison
from ehls_ros.duals import Dual
from ehls_ros.errors import BadInput
from ehls_ros.experiments.compiling import Job, compile_in_parallel, consequences_jobs, diagnosis_jobs
from ehls_ros.experiments.controller_benefit import controller_benefit
from ehls_ros.parallel import Workers
from ehls_ros.physics.composition import compiled, is_compiled
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.imposed_motion import PARTS, compile_part, part_kernel
from ehls_ros.physics.rig import EffectUse, rig_from_mapping
from ehls_ros.trajectory import Trajectory


def using(rig, name, **parameters):
    return rig._replace(effects=(*rig.effects, EffectUse(name, EFFECTS.load(name).Parameters(**parameters))))


@pytest.mark.parametrize("part", PARTS)
def test_a_part_is_compiled_for_the_arguments_a_diagnosis_gives_it(part, rig, rig_file):
    if part == "chambers":
        rig_file = yaml.safe_load((Path(__file__).parents[2] / "config" / "rig_single_rod.yaml").read_text(encoding="utf-8"))
        rig = rig_from_mapping(rig_file, "rig")
    r = truth_generator.record(rig_file, {}, "rich", duration=2.0, seed=1)
    record = prepare(Trajectory(r.time, r.columns), rig, "case")
    parted = using(rig, "hinge_backlash", load_gap=1e-3) if part == "load" else rig
    effective = parted.effective()
    compile_part(part, effective)
    run = part_kernel(part, effective).run
    before = list(run.signatures)
    comparison = Comparison(record, stages.setup(record, rig))
    methods = {"spool": "simulated_spool", "flow": "flow_terms", "chambers": "chamber_terms", "force": "extra_force"}
    method = {**methods, "readings": "misread"}.get(part, part)
    getattr(comparison, method)(effective)
    assert before
    assert run.signatures == before
    assert is_compiled(part_kernel(part, effective))


def test_the_friction_is_compiled_for_the_arguments_an_identification_gives_its_derivatives(rig, recorded):
    r = recorded({}, "rich", duration=2.0, seed=1)
    record = prepare(Trajectory(r.time, r.columns), rig, "case")
    compile_part("friction", rig.effective(), duals=True)
    run = part_kernel("friction", rig.effective(), duals=True).run
    before = list(run.signatures)
    varied = rig._replace(friction=rig.friction._replace(coulomb_force=Dual(rig.friction.coulomb_force, {3: 1.0})))
    assert list(Comparison(record, stages.setup(record, rig)).friction(varied.effective()).tangents) == [3]
    assert before
    assert run.signatures == before


def test_only_what_is_not_kept_is_compiled_and_only_then_the_user_is_told(rig, tmp_path, monkeypatch):
    said = []
    kept = [Job(job.kernel, partial(refused)) for job in diagnosis_jobs(rig)]
    for job in diagnosis_jobs(rig):
        job.compile()
    compile_in_parallel(kept, Workers(1), lambda *step: said.append(step))
    assert said == []
    # A folder without results of an earlier run.
    monkeypatch.setenv("EHLS_CACHE_DIR", str(tmp_path))
    fresh = compiled(built_of_nothing, {"run": "x"})
    compile_in_parallel([Job(lambda: fresh, partial(int))], Workers(1), lambda *step: said.append(step))
    assert said == [(0, 1), (1, 1)]
    assert not is_compiled(fresh)
    assert fresh.run(2.0) == 2.0
    assert is_compiled(fresh)


def test_what_follows_a_diagnosis_runs_what_was_compiled_for_it(rig):
    diagnosis = SimpleNamespace(names_causes=True, rig=rig, extended=using(rig, "mass_shift", factor=1.5))
    jobs = consequences_jobs(diagnosis)
    for job in jobs:
        job.compile()
        assert is_compiled(job.kernel())
    before = [signatures(job.kernel()) for job in jobs]
    assert all(before)
    controller_benefit(diagnosis.rig, diagnosis.extended)
    assert [signatures(job.kernel()) for job in jobs] == before
    assert [
        job.kernel() for job in consequences_jobs(SimpleNamespace(names_causes=False, term=None, rig=rig, extended=rig))
    ] == [jobs[-1].kernel()]


def signatures(module):
    return {name: entry.signatures for name, entry in vars(module).items() if hasattr(entry, "signatures") and entry.signatures}


class Built(NamedTuple):
    run: Any


@kernel
def same(x):
    return x


def built_of_nothing():
    return Built(same)


def refused():
    raise BadInput("it was compiled", "here", "leave it")
