"""What the rig file has wrong, found while running: valve gain, bandwidth and delay, flow, area and friction.

The controller is given a corrected model, within a reach and a rate that keep its margins; the user is told what the rig file
seems to have wrong. :mod:`ehls_ros.control.adaptation` has the regressions.
"""

from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.adaptation.friction import Surroundings
from ehls_ros.control.adaptation.hand_over import Caution
from ehls_ros.control.adaptation.search import Search
from ehls_ros.control.companions.base import Kept, Past, Setting, Upcoming
from ehls_ros.control.controllers.base import Model
from ehls_ros.physics.rig import SENSED
from ehls_ros.schema import quantity

ACTUATOR = False

STRIDE = 10
"""Cycles between two small steps of the model."""


class Parameters(NamedTuple):
    """Caution of the adaptation."""

    reach: Annotated[
        float, quantity("1", "largest change of a coefficient from the rig file's, relative", minimum=0.0, maximum=0.3)
    ] = 0.3
    rate: Annotated[float, quantity("1/s", "largest relative change in a second", above=0.0, maximum=10.0)] = 0.2
    wait: Annotated[float, quantity("s", "time before anything changes", minimum=0.0, maximum=1e6)] = 1.0
    certain: Annotated[
        float, quantity("1", "largest relative standard error of an estimate that is used", above=0.0, maximum=0.3)
    ] = 0.03
    significance: Annotated[
        float,
        quantity("1", "standard errors by which an estimate must differ to be used", minimum=1.0, maximum=10.0),
    ] = 2.5
    forgetting: Annotated[float, quantity("s", "time constant with which readings are forgotten", minimum=1.0, maximum=1e6)] = (
        30.0
    )


def caution_of(p: Parameters) -> Caution:
    """Return when a coefficient moves, how far and how fast."""
    return Caution(p.reach, p.rate, p.certain, p.significance)


class Adaptation:
    """The companion at work."""

    corrects = True

    def __init__(self, p: Parameters, setting: Setting) -> None:
        """Start from what the rig file says."""
        self._wait = p.wait
        self._next = 0
        self._started: int | None = None
        self._search = Search(setting.model, caution_of(p), p.forgetting, _surroundings(setting))

    @property
    def search(self) -> Search:
        """What is found."""
        return self._search

    def prepare(self) -> None:
        """Compile or load what gathers the evidence: it takes in no cycle."""
        self._search.take(np.empty((0, len(SENSED))), np.empty(0))

    def room(self, first: int, place: Array) -> int:
        """Return the cycles until the model may change."""
        return min(STRIDE - first % STRIDE, len(place))

    def ahead(self, upcoming: Upcoming) -> None:
        """Change nothing."""

    def done(self, past: Past, model: Model) -> Model:
        """Take in what happened; return the model as corrected so far."""
        if self._started is None or past.first != self._next:
            self._started = past.first if self._started is None else self._started
            self._search.interrupt()
        self._next = past.first + len(past.command)
        self._search.take(np.ascontiguousarray(past.measured), np.ascontiguousarray(past.command))
        if self._next % STRIDE or (self._next - self._started) * model.period < self._wait:
            return model
        return self._search.corrected(model, STRIDE)

    def interrupt(self) -> None:
        """Forget what is half gathered."""
        self._search.interrupt()

    def report(self) -> Mapping[str, float | str]:
        """Return what the controller is given, over the rig file's values, and a sentence for each coefficient."""
        return self._search.report()

    def at_bounds(self) -> tuple[str, ...]:
        """Return a sentence for each coefficient whose estimate is out of reach."""
        return self._search.at_bounds()

    def kept(self) -> Kept:
        """Keep nothing: the rig file to write is in the run's folder."""
        return Kept()

    def recall(self, kept: Kept) -> None:
        """Recall nothing."""


def _surroundings(setting: Setting) -> Surroundings | None:
    """Return what holds the piston beside its load, as the law knows it; None where that is not known."""
    if setting.actuator == "force":
        return Surroundings(0.0, 0.0)
    # A law that was made before rig files knew the coupling has it among its parameters.
    knows = setting.model if setting.model.coupling_stiffness > 0.0 else setting.tuning
    stiffness, damping = (getattr(knows, name, 0.0) for name in ("coupling_stiffness", "coupling_damping"))
    return Surroundings(stiffness, damping) if stiffness > 0.0 else None


def check(p: Parameters, setting: Setting) -> None:
    """Refuse nothing: what cannot be told of a rig is left as it is."""


def build(p: Parameters, setting: Setting) -> Adaptation:
    """Return the companion ready to work."""
    return Adaptation(p, setting)
