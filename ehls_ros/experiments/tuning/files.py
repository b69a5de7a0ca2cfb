"""Files of a tuning: the experiment with the numbers found, and the parameter file of the controller's node."""

from collections.abc import Mapping
from typing import Any

from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.spec import spec_to_mapping
from ehls_ros.experiments.tuning.tune import Trial, Tuned
from ehls_ros.experiments.yaml_files import commented, spec_text
from ehls_ros.schema import notes

EXPERIMENT = "experiment.yaml"
"""Name of the experiment's file."""


def experiment_text(found: Tuned) -> str:
    """Return the experiment's file, its rig written out."""
    content = {key: value for key, value in spec_to_mapping(found.spec).items() if value not in (None, [])}
    return f"# Tuned by `ehls tune`.\n{spec_text(content)}"


def parameters_text(found: Tuned) -> str:
    """Return the parameter file of the controller's node, for ``--params-file``."""
    law = found.spec.controller
    numbers = {name: float(f"{value:.6g}") for name, value in found.chosen.numbers.items()}
    remarks = {name: note.text for name, note in notes(type(law.parameters)).items() if name in numbers}
    node = f"/**/{law.name}_node"
    return commented({node: {"ros__parameters": numbers}}, {node: {"ros__parameters": remarks}})


def document(found: Tuned) -> dict[str, Any]:
    """Return the content of ``tuning.json``; what is not finite is null."""
    made: dict[str, Any] = json_document(
        {
            "law": found.spec.controller.name,
            "numbers": found.chosen.numbers,
            "default": _trial(found.default),
            "chosen": _trial(found.chosen),
            "wanted": found.wanted._asdict(),
            "causal_limit_n": found.causal_limit,
            "without": [limit._asdict() for limit in found.limits],
            "curve": [_trial(trial) for trial in found.curve],
            "tried": found.tried,
            "remarks": list(found.remarks),
        }
    )
    return made


def _trial(trial: Trial) -> Mapping[str, Any]:
    return {
        "max_error_n": trial.error,
        "max_error_within_uncertainty_n": trial.typical,
        "largest_of_all_runs_n": trial.worst,
        "held_error": trial.held,
        "gain_margin_db": trial.gain_db,
        "phase_margin_deg": trial.margins.phase_deg,
        "delay_margin_s": trial.margins.delay,
        "numbers": trial.numbers,
    }
