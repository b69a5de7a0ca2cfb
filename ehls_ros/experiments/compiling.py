"""Compiling what a diagnosis will run, on all processors, before it is run.

A kernel is compiled once for a version of this package; later runs load it.
"""

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
from ehls_ros.physics.along import PARTS, compile_part, part_kernel
from ehls_ros.physics.composition import is_kept
from ehls_ros.physics.rig import Rig
from ehls_ros.physics.simulator import Simulator, parts_of, plant_kernel

COMPILING = "compiling, once for this version"
"""What a user is told meanwhile."""


class Job(NamedTuple):
    """A kernel to compile.

    Attributes:
        kernel: returns its module.
        compile: compiles it, in a process of its own.
    """

    kernel: Callable[[], ModuleType]
    compile: Task


def of_diagnosis(rig: Rig) -> list[Job]:
    """Return the kernels of a diagnosis of a rig; the longest to compile come first."""
    effective = rig.effective()
    return [Job(partial(part_kernel, name, effective), partial(compile_part, name, effective)) for name in reversed(PARTS)]


def of_consequences(diagnosis: Diagnosis) -> list[Job]:
    """Return the kernels of what follows from a diagnosis."""
    given, extended = diagnosis.rig, diagnosis.extended
    if not diagnosis.names_causes:
        return [_plant(given)]
    loops = {loop_kernel(spec): spec for spec in runs(given, extended)}
    jobs = [Job(partial(loop_kernel, spec), partial(_loop, spec)) for spec in loops.values()]
    return [*jobs, _plant(given), _plant(extended)]


def compile_side_by_side(jobs: Iterable[Job], workers: Workers, progress: Progress) -> None:
    """Compile those of some kernels that are not kept yet.

    Args:
        jobs: the kernels.
        workers: the processes to compile in.
        progress: called with the number compiled and their total number; not called where all are kept.
    """
    tasks = [job.compile for job in jobs if not is_kept(job.kernel())]
    if tasks:
        progress(0, len(tasks))
        # Without the help of other processes, a kernel is compiled where it is run.
        with suppress(BrokenProcessPool):
            workers.run(tasks, progress)


def _plant(rig: Rig) -> Job:
    return Job(partial(plant_kernel, parts_of(rig)), partial(_simulator, rig))


def _simulator(rig: Rig) -> None:
    Simulator(rig)


def _loop(spec: Spec) -> None:
    ClosedLoop(spec, check=False)
