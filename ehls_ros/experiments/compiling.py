"""Compilation of kernels before a diagnosis or a run, announced with its expected duration; for a diagnosis on all processors.

A kernel is compiled once per version of this package; later runs load it.
"""

import math
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from functools import partial
from types import ModuleType
from typing import NamedTuple

from ehls_ros.diagnosis.result import Diagnosis
from ehls_ros.experiments.controller_benefit import runs
from ehls_ros.experiments.loop import ClosedLoop, loop_kernel
from ehls_ros.experiments.spec import Spec
from ehls_ros.parallel import Progress, Task, Workers
from ehls_ros.physics.composition import is_compiled
from ehls_ros.physics.imposed_motion import PARTS, compile_part, part_kernel, parts_along
from ehls_ros.physics.rig import EffectiveRig, Rig
from ehls_ros.physics.simulator import Simulator, parts_of, plant_kernel
from ehls_ros.progress import announce, duration_text

COMPILING = "compiling, once for this version"
"""Progress message."""


PER_KERNEL = 7.0
"""Time to compile a kernel on a machine that takes :data:`REFERENCE` for the loop of :func:`_slowness` [s]."""

REFERENCE, SHORT = 0.014, 200_000
"""Time of that loop [s], and its number of steps."""


class Job(NamedTuple):
    """A kernel to compile.

    Attributes:
        kernel: function that returns its module.
        compile: task that compiles it in another process.
    """

    kernel: Callable[[], ModuleType]
    compile: Task


def diagnosis_jobs(rig: Rig) -> list[Job]:
    """Return the kernels of a rig's diagnosis, which begins with an identification, those that compile longest first."""
    effective = rig.effective()
    return [*_parts(rig, duals=True), *(_part(name, effective, duals=False) for name in reversed(parts_along(effective)))]


def identification_jobs(rig: Rig) -> list[Job]:
    """Return the kernels for the identification of a whole rig: its parts, with and without derivatives."""
    return [*_parts(rig, duals=True), *_parts(rig, duals=False)]


def _parts(rig: Rig, *, duals: bool) -> list[Job]:
    effective = rig.effective()
    without = {"load"} if effective.piston_mass() == 0.0 else set()
    without |= set() if any(use.name in PARTS["readings"].effects.names for use in rig.effects) else {"readings"}
    return [_part(name, effective, duals=duals) for name in reversed(parts_along(effective)) if name not in without]


def _part(name: str, rig: EffectiveRig, *, duals: bool) -> Job:
    return Job(partial(part_kernel, name, rig, duals=duals), partial(compile_part, name, rig, duals=duals))


def consequences_jobs(diagnosis: Diagnosis) -> list[Job]:
    """Return the kernels of the experiments that follow a diagnosis."""
    given, extended = diagnosis.rig, diagnosis.extended
    if not diagnosis.names_causes:
        return [_plant(given)] if diagnosis.term is None else [_plant(given), _plant(extended)]
    loops = {loop_kernel(spec): spec for spec in runs(given, extended)}
    jobs = [Job(partial(loop_kernel, spec), partial(_loop, spec)) for spec in loops.values()]
    return [*jobs, _plant(given), _plant(extended)]


def loop_jobs(spec: Spec) -> list[Job]:
    """Return the kernel of an experiment in one process."""
    return [Job(partial(loop_kernel, spec), partial(_loop, spec))]


def graph_jobs(spec: Spec) -> list[Job]:
    """Return the kernels of an experiment's nodes: the plant's, and that of the loop for those of its other nodes."""
    return [_plant(spec.rig), *loop_jobs(spec)]


def announce_compiling(jobs: Iterable[Job], processors: int = 1, what: str = "") -> list[Task]:
    """Print the number of kernels that are not in the cache, and the expected time of their compilation, if there are any.

    Args:
        jobs: the kernels.
        processors: number of processors that compile.
        what: name of the work, in front.

    Returns:
        The tasks that compile them.
    """
    tasks = [job.compile for job in jobs if not is_compiled(job.kernel())]
    if tasks:
        kernels = "1 kernel" if len(tasks) == 1 else f"{len(tasks)} kernels"
        expected = PER_KERNEL * math.ceil(len(tasks) / max(1, processors)) * _slowness()
        before, expected = f"{what}: " if what else "", float(f"{expected:.2g}")
        announce(f"{before}compiling {kernels}, once for this version; about {duration_text(expected)} on this machine")
    return tasks


def _slowness() -> float:
    """Return the time of a short loop relative to :data:`REFERENCE`."""
    begin = time.perf_counter()
    sum(i * i for i in range(SHORT))
    return max(1.0, (time.perf_counter() - begin) / REFERENCE)


def compile_in_parallel(jobs: Iterable[Job], workers: Workers, progress: Progress) -> None:
    """Compile the kernels that are not in the cache.

    Args:
        jobs: the kernels.
        workers: the processes to compile in.
        progress: called with the number compiled and the total number; not called if all are in the cache.
    """
    tasks = announce_compiling(jobs, len(os.sched_getaffinity(0)))
    if tasks:
        progress(0, len(tasks))
        # If the processes fail, a kernel is compiled when it is first run.
        with suppress(BrokenProcessPool):
            workers.run(tasks, progress)


def _plant(rig: Rig) -> Job:
    return Job(partial(plant_kernel, parts_of(rig)), partial(_simulator, rig))


def _simulator(rig: Rig) -> None:
    Simulator(rig)


def _loop(spec: Spec) -> None:
    ClosedLoop(spec, check=False)
