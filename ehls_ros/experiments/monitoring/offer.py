"""The shortest experiment of the catalogue that tells coefficients which the present programme does not.

Each experiment is run on the simulated healthy rig, once, and read as the monitor reads its blocks: what it would tell is known
before the rig moves. As the error of a coefficient falls with the root of the time, an experiment that tells it too coarsely is
repeated as often as that needs.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.monitoring.blocks import scores, telling
from ehls_ros.diagnosis.monitoring.directions import directions
from ehls_ros.diagnosis.monitoring.tracking import WANTED, readings, tracked
from ehls_ros.diagnosis.record import USED, prepare
from ehls_ros.diagnosis.stages import setup
from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.experiments.catalogue import CATALOGUE, catalogue_spec
from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.spec import spec_from_mapping
from ehls_ros.physics.rig import Rig, rig_to_mapping, unknown_keys
from ehls_ros.trajectory import Trajectory

REPEATS = (1, 2, 4, 8)
"""How often an experiment may be run."""


class Offer(NamedTuple):
    """An experiment that tells what the present programme does not.

    Attributes:
        name: its name in the catalogue.
        purpose: what it does, in a few words.
        seconds: time that it takes, with its repetitions [s].
        repeats: how often it is run.
        tells: names of the coefficients that it tells, of those asked for.
        spec: spec for ``ehls experiment``, without the rig file.
    """

    name: str
    purpose: str
    seconds: float
    repeats: int
    tells: tuple[str, ...]
    spec: Mapping[str, Any]


def offer(missing: Collection[str], rig: Rig, signals: Collection[str] = USED) -> Offer | None:
    """Return the experiment that tells most of some coefficients, and of those that tell as many the shortest.

    Args:
        missing: names in :data:`~ehls_ros.diagnosis.monitoring.tracking.COEFFICIENTS`.
        rig: the healthy rig.
        signals: names of the signals that are recorded.

    Returns:
        The experiment; None where none of them tells any, or the rig cannot be simulated.
    """
    if unknown_keys(rig):
        return None
    found = [made for name in CATALOGUE if (made := _rated(name, missing, rig, signals)) is not None]
    return max(found, key=lambda made: (len(made.tells), -made.seconds), default=None)


def _rated(name: str, missing: Collection[str], rig: Rig, signals: Collection[str]) -> Offer | None:
    """Return an experiment with what it tells of some coefficients; None where that is nothing."""
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
    evidence = telling(evidence)
    found = directions(evidence, WANTED)
    numbers = tracked(found)
    own = [found[number] for number in numbers.values()]
    [said] = scores(evidence, own, range(len(own)), [0.0])
    scatter = np.full(len(own), rules.LEARNT_SCATTER)
    places = {name: place for place, name in enumerate(numbers)}
    wanted, before = set(missing), set[str]()
    best = None
    for count in REPEATS:
        read = readings(own, places, rig, count * said.score[: len(own)], count * said.normal, scatter)
        told = {reading.name for reading in read if reading.told} & wanted
        if told > before:
            tells = tuple(reading.name for reading in read if reading.name in told)
            best = Offer(name, CATALOGUE[name].purpose, count * spec.settings.duration, count, tells, mapping)
            before = told
    return best
