"""A step of a commissioning: its description, its known rig, and its result."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.commissioning.session import Session
from ehls_ros.experiments.tuning.tune import USUAL, Wanted
from ehls_ros.physics.rig import Rig, has_number
from ehls_ros.progress import Update
from ehls_ros.trajectory import Trajectory


class Contradiction(BadInput):
    """Rig, bridge file and rig file contradict each other; the message ends with the remedy."""


class Known(NamedTuple):
    """Knowledge at the beginning of a step.

    Attributes:
        rig: the rig as found so far.
        numbers: numbers of the law as tuned, by name; others are its defaults for the rig.
        wanted: margins that the tuning is asked for.
    """

    rig: Rig
    numbers: Mapping[str, float] = {}
    wanted: Wanted = USUAL


class Finding(NamedTuple):
    """A number found.

    Attributes:
        path: section and name in the rig file.
        given: the file's value; NaN if it has none.
        found: the value with its standard error.
    """

    path: str
    given: float
    found: Estimate


class Outcome(NamedTuple):
    """Result of a step.

    Attributes:
        rig: the rig with the numbers found.
        findings: these numbers.
        sentences: further results.
        recordings: recordings by name.
        numbers: numbers of the law as tuned.
        files: texts of further files, by name.
    """

    rig: Rig
    findings: tuple[Finding, ...] = ()
    sentences: tuple[str, ...] = ()
    recordings: Mapping[str, Trajectory] = {}
    numbers: Mapping[str, float] = {}
    files: Mapping[str, str] = {}


def after(known: Known, outcome: Outcome) -> Known:
    """Return the knowledge after a step; the rig file gets the standard errors of the numbers found."""
    errors = {**known.rig.standard_errors, **{finding.path: finding.found.std for finding in outcome.findings}}
    present = {path: std for path, std in errors.items() if has_number(outcome.rig, path)}
    return known._replace(rig=outcome.rig._replace(standard_errors=present), numbers=outcome.numbers or known.numbers)


class Step(NamedTuple):
    """A step.

    Attributes:
        name: its name in files.
        title: its title.
        moves: what it does to the rig, for the operator who releases it.
        run: does it.
    """

    name: str
    title: str
    moves: str
    run: Callable[[Session, Known, Update], Outcome]
