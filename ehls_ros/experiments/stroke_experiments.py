"""Experiments for strokes missing in recordings, within the limits of the rig."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ehls_ros.control.references import velocity_sweep
from ehls_ros.experiments.spec import check_spec, spec_from_mapping
from ehls_ros.experiments.yaml_files import spec_text
from ehls_ros.identification.strokes import Missing
from ehls_ros.physics.rig import Rig, rig_to_mapping, unknown_keys

STROKE_FRACTION, MAX_STROKE_S, REST_S, SINE_PERIODS = 0.8, 6.0, 0.5, 18
"""Fraction of the stroke used, longest time at one velocity and rest before each stroke [s], periods of the sine."""

ACCELERATION = 0.25
"""Acceleration of the strokes as in the paper [m/s^2]; larger if a fast stroke would otherwise not reach its velocity."""


class Request(NamedTuple):
    """A requested experiment.

    Attributes:
        file: name of its file.
        text: content of the file.
    """

    file: str
    text: str


def stroke_experiments(missing: Missing, rig: Rig, path: Path, folder: Path) -> Iterator[Request]:
    """Yield the experiments; none for a rig file that cannot be simulated.

    Args:
        missing: the missing strokes.
        rig: the rig.
        path: its file.
        folder: folder of the experiments.

    Raises:
        BadInput: the rig cannot run them.
    """
    if unknown_keys(rig):
        return
    low, high = rig.limits.position
    if missing.velocities:
        travel = STROKE_FRACTION * (high - low)
        enough = 2.0 * max(missing.velocities) ** 2 / travel
        strokes: dict[str, Any] = {
            "velocities": missing.velocities,
            "repeats": 1,
            "travel": travel,
            "longest": MAX_STROKE_S,
            "acceleration": max(ACCELERATION, enough),
            "rest": REST_S,
            "centre": 0.5 * (low + high),
        }
        length = velocity_sweep.duration(velocity_sweep.Parameters(**strokes)) + REST_S
        reference = {"name": "velocity_sweep", **strokes}
        yield _request("missing_strokes.yaml", "strokes at constant velocities", reference, length, rig, path, folder)
    if missing.sine is not None:
        amplitude, frequency = missing.sine
        reference = {"name": "sine", "amplitude": amplitude, "frequency": frequency, "offset": 0.5 * (low + high)}
        yield _request("missing_presliding.yaml", "presliding", reference, SINE_PERIODS / frequency, rig, path, folder)


def _request(
    file: str, title: str, reference: Mapping[str, Any], duration: float, rig: Rig, path: Path, folder: Path
) -> Request:
    middle = 0.5 * sum(rig.limits.position)
    spec = {
        "title": title,
        "duration": round(duration, 1),
        "initial_position": middle,
        "reference": reference,
        "controller": "pid",
    }
    check_spec(spec_from_mapping({**spec, "rig": rig_to_mapping(rig)}, file, folder), file)
    named = {"title": title, "rig": os.path.relpath(path, folder), **spec}
    return Request(
        file,
        f"# Requested by `ehls identify`: run it on the rig, with the gains of its position controller.\n{spec_text(named)}",
    )
