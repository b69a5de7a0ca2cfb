"""Offer of the shortest experiment of the catalogue for coefficients that the present programme does not determine.

Each experiment is simulated once on the healthy rig and evaluated like the monitor's blocks, so that its information is known
before the rig moves. The error of a coefficient decreases with the square root of time, so an experiment that is not precise
enough is repeated as often as necessary.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.monitoring.blocks import informative, scores
from ehls_ros.diagnosis.monitoring.directions import directions
from ehls_ros.diagnosis.monitoring.tracking import WANTED, IdentifiedRig, readings, tracked
from ehls_ros.diagnosis.record import USED, prepare
from ehls_ros.diagnosis.stages import setup
from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.experiments.catalogue import CATALOGUE, catalogue_spec
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import spec_from_mapping
from ehls_ros.physics.rig import Rig, rig_to_mapping, unknown_keys
from ehls_ros.trajectory import Trajectory

REPEATS = (1, 2, 4, 8)
"""Permitted numbers of repetitions of an experiment."""


class Offer(NamedTuple):
    """An experiment for coefficients that the present programme does not determine.

    Attributes:
        name: its name in the catalogue.
        purpose: short description.
        seconds: duration including repetitions [s].
        repeats: number of runs.
        tells: names of the requested coefficients that it determines.
        spec: spec for ``ehls experiment``, without the rig file.
    """

    name: str
    purpose: str
    seconds: float
    repeats: int
    tells: tuple[str, ...]
    spec: Mapping[str, Any]


def offer(missing: Collection[str], rig: Rig, signals: Collection[str] = USED) -> Offer | None:
    """Return the shortest experiment that determines the most of the missing coefficients.

    Args:
        missing: names in :data:`~ehls_ros.diagnosis.monitoring.tracking.COEFFICIENTS`.
        rig: the healthy rig.
        signals: names of the recorded signals.

    Returns:
        The experiment; None if none determines any, or if the rig cannot be simulated.
    """
    if unknown_keys(rig):
        return None
    found = [rated for name in CATALOGUE if (rated := _rated(name, missing, rig, signals)) is not None]
    return max(found, key=lambda rated: (len(rated.tells), -rated.seconds), default=None)


def _rated(name: str, missing: Collection[str], rig: Rig, signals: Collection[str]) -> Offer | None:
    """Return an experiment with the missing coefficients that it determines; None if there are none."""
    mapping = catalogue_spec(name, rig)
    try:
        spec = spec_from_mapping({**mapping, "rig": rig_to_mapping(rig)}, "catalogue", Path())
        run = run_in_process(spec)
        record = prepare(Trajectory(run.time_s, {s: run[s] for s in signals if s in run}), rig, name)
        evidence = gather(record, rig, setup(record, rig), 0)
    except (BadInput, WorkFailed):
        return None
    if not evidence.channels:
        return None
    evidence = informative(evidence)
    found = directions(evidence, WANTED)
    numbers = tracked(found)
    own = [found[number] for number in numbers.values()]
    [score] = scores(evidence, own, range(len(own)), [0.0])
    scatter = np.full(len(own), rules.LEARNT_SCATTER)
    places = {name: place for place, name in enumerate(numbers)}
    wanted, before = set(missing), set[str]()
    best = None
    for count in REPEATS:
        read = readings(own, places, IdentifiedRig(rig), [score] * count, scatter)
        identified = {reading.name for reading in read if reading.identified} & wanted
        if identified > before:
            tells = tuple(reading.name for reading in read if reading.name in identified)
            best = Offer(name, CATALOGUE[name].purpose, count * spec.settings.duration, count, tells, mapping)
            before = identified
    return best
