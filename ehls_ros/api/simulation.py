"""Rigs and simulated experiments."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from ehls_ros.api.arguments import check_kind
from ehls_ros.api.recordings import Recording, with_methods
from ehls_ros.api.results import written
from ehls_ros.errors import BadInput
from ehls_ros.experiments.causal_limit import with_causal_limit
from ehls_ros.experiments.compiling import announce_compiling, loop_jobs
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.loop import run_as_far_as_it_goes
from ehls_ros.experiments.metrics import Metrics, evaluate
from ehls_ros.experiments.run_failure import with_failure
from ehls_ros.experiments.spec import (
    Spec,
    check_spec,
    for_simulated_rig,
    load_rig,
    spec_from_mapping,
    spec_to_mapping,
    swinging_actuator,
    undeclared_effects,
)
from ehls_ros.experiments.yaml_files import rig_text
from ehls_ros.physics.rig import EffectUse, Rig, rig_from_mapping, rig_to_mapping
from ehls_ros.progress import progress_bar
from ehls_ros.recording.yaml_text import read_yaml

RigSource = Rig | Mapping[str, Any] | str | Path
"""A rig: an object, a mapping like its YAML file, the path of that file, or the name of one supplied with the package."""

SpecSource = Spec | Mapping[str, Any] | str | Path
"""An experiment, in the same forms as :data:`RigSource`."""

EXPECTED_RIG = "a rig, the path of its file, the name of one that comes with the package, or a mapping"
EXPECTED_SPEC = "an experiment, the path of its file, the name of one that comes with the package, or a mapping"

Part = Mapping[str, Any] | str
"""A member of a family: its name, or a mapping of ``name`` and parameters."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Simulation(Recording):
    """The recording of a simulated experiment.

    Attributes:
        metrics: its figures of merit. ``metrics.warnings`` lists limitations of the run, and the reason if it ended early.
        spec: the experiment.
    """

    metrics: Metrics = field()  # without the inherited property as its default
    spec: Spec


def rig(source: RigSource) -> Rig:
    """Return a rig.

    Args:
        source: path of a rig file; name of one supplied with the package, such as ``"rig_paper_measured"``; its content as a
            mapping; or a rig, which is returned unchanged.

    Raises:
        BadInput: the file or one of its keys is wrong.
    """
    if isinstance(source, Rig):
        return source
    check_kind(source, (Mapping, str, Path), "rig", EXPECTED_RIG)
    return rig_from_mapping(source, "rig") if isinstance(source, Mapping) else load_rig(configured(source))


def save_rig(rig: Rig, path: str | Path) -> Path:
    """Write a rig file and return its path.

    Raises:
        BadInput: the file cannot be written.
    """
    return written(path, partial(Path.write_text, data=rig_text(rig_to_mapping(rig)), encoding="utf-8"))


def simulate(
    spec: SpecSource | None = None,
    *,
    rig: RigSource | None = None,
    controller_rig: RigSource | None = None,
    effects: Sequence[Mapping[str, Any] | EffectUse] | None = None,
    reference: Part | None = None,
    disturbance: Part | None = None,
    controller: Part | None = None,
    compensation: Part | None = None,
    duration: float | None = None,
    seed: int | None = None,
    title: str | None = None,
    progress: bool = True,
) -> Simulation:
    """Run an experiment on the simulated rig: plant, friction observer and controller in one process, without ROS.

    All arguments but the last are keys of an experiment file, and override those in ``spec``.

    Args:
        spec: the experiment to start from: path of its file, name of one supplied with the package, such as
            ``"sine_fd2"``, its content, or an experiment. None: rig and reference are required, and the controller is FASMC.
        rig: the true rig, in place of the experiment's rig, effects and controller's rig.
        controller_rig: the rig assumed by the controller.
        effects: effects in addition to those of the rig, each with ``name`` and parameters.
        reference: force reference, such as ``{"name": "sine", "amplitude": 1e4, "frequency": 0.5}``.
        disturbance: disturbance of the rig; by default none.
        controller: the control law with its parameters, such as ``{"name": "fasmc", "k": 6.0}``.
        compensation: the friction observer.
        duration: plant time [s].
        seed: seed of the sensors' noise.
        title: title in reports.
        progress: show a progress bar, in a notebook or on a terminal.

    Returns:
        The recording with its metrics. A run that becomes numerically invalid ends early, with a warning.

    Raises:
        BadInput: a value is wrong, or the values together describe no valid rig.
    """
    changes: dict[str, Any] = {
        "effects": effects, "reference": reference, "disturbance": disturbance, "controller": controller,
        "compensation": compensation, "duration": duration, "seed": seed, "title": title,
    }  # fmt: skip
    made = _changed(spec, rig, controller_rig, {key: value for key, value in changes.items() if value is not None})
    made = for_simulated_rig(made)
    if progress:
        announce_compiling(loop_jobs(made), what=made.settings.title)
    with progress_bar(made.settings.title, shown=progress, lines=False) as bar:
        trajectory, failure = run_as_far_as_it_goes(made, bar)
    metrics = with_failure(with_causal_limit(evaluate(trajectory), trajectory), failure)
    metrics = metrics._replace(warnings=(*metrics.warnings, *undeclared_effects(made), *swinging_actuator(made)))
    return with_methods(Simulation, trajectory, made.settings.title, metrics=metrics, spec=made)


def _changed(source: SpecSource | None, true: RigSource | None, assumed: RigSource | None, changes: Mapping[str, Any]) -> Spec:
    """Return an experiment with some keys replaced."""
    content, where, folder = spec_content(source)
    if true is not None:
        content |= {"rig": rig_to_mapping(rig(true)), "controller_rig": None, "effects": None}
    if assumed is not None:
        content["controller_rig"] = rig_to_mapping(rig(assumed))
    content |= changes
    if "effects" in changes:
        content["effects"] = [
            {"name": use.name, **use.parameters._asdict()} if isinstance(use, EffectUse) else use for use in changes["effects"]
        ]
    where = f"simulate, from {where}" if source is not None and changes else where
    spec = spec_from_mapping(content, where, folder)
    check_spec(spec, where)
    return spec


def spec_content(source: SpecSource | None) -> tuple[dict[str, Any], str, Path]:
    """Return an experiment's keys, its name in errors, and the folder to which its file names are relative."""
    if source is None:
        return {"controller": "fasmc"}, "simulate", Path()
    if isinstance(source, Spec):
        return spec_to_mapping(source), source.settings.title, Path()
    if isinstance(source, Mapping):
        return dict(source), "simulate", Path()
    check_kind(source, (str, Path), "spec", EXPECTED_SPEC)
    path = configured(source, "experiments")
    content = read_yaml(path, "spec")
    if not isinstance(content, Mapping):
        raise BadInput(f"a spec is {type(content).__name__}", str(path), "a mapping of an experiment's keys")
    return dict(content), str(path), path.parent
