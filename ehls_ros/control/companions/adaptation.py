"""Adapt the rig file's coefficients while running: valve gain, bandwidth and delay, flow, area and friction.

The controller receives a corrected model, within a reach and a rate that preserve its margins. The user receives a report of
apparent errors in the rig file. :mod:`ehls_ros.control.adaptation` has the regressions.
"""

from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.adaptation.correction import AdaptationLimits
from ehls_ros.control.adaptation.estimation import Estimation
from ehls_ros.control.adaptation.friction import Surroundings
from ehls_ros.control.companions.base import Companion, Past, Setting
from ehls_ros.control.controllers.base import Model
from ehls_ros.physics.rig import SENSED
from ehls_ros.schema import quantity

ACTUATOR = False

STRIDE = 10
"""Cycles between successive small steps of the model."""


class Parameters(NamedTuple):
    """Bounds and thresholds of the adaptation."""

    reach: Annotated[
        float, quantity("1", "largest change of a coefficient from the rig file's, relative", minimum=0.0, maximum=0.3)
    ] = 0.3
    rate: Annotated[float, quantity("1/s", "largest relative change in a second", above=0.0, maximum=10.0)] = 1.0
    wait: Annotated[float, quantity("s", "time before anything changes", minimum=0.0, maximum=1e6)] = 0.1
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


def adaptation_limits(p: Parameters) -> AdaptationLimits:
    """Return the conditions and bounds on the adaptation of a coefficient."""
    return AdaptationLimits(p.reach, p.rate, p.certain, p.significance)


class Adaptation(Companion):
    """Adaptation of the controller's model as a companion; the corrected rig file is written to the run's folder."""

    corrects = True

    def __init__(self, p: Parameters, setting: Setting) -> None:
        """Start from the rig file's values."""
        self._wait = p.wait
        self._next = 0
        self._started: int | None = None
        self._estimation = Estimation(
            setting.model, adaptation_limits(p), p.forgetting, _surroundings(setting), setting.cylinder, setting.valve
        )

    @property
    def estimation(self) -> Estimation:
        """Estimates from the cycles so far."""
        return self._estimation

    def prepare(self) -> None:
        """Compile or load the accumulation of evidence by a call without cycles."""
        self._estimation.take(np.empty((0, len(SENSED))), np.empty(0))

    def room(self, first: int, place: Array) -> int:
        """Return the cycles until the model may change."""
        return min(STRIDE - first % STRIDE, len(place))

    def done(self, past: Past, model: Model) -> Model:
        """Add the past cycles to the evidence; return the model as corrected so far."""
        if self._started is None or past.first != self._next:
            self._started = past.first if self._started is None else self._started
            self._estimation.interrupt()
        self._next = past.first + len(past.command)
        self._estimation.take(np.ascontiguousarray(past.measured), np.ascontiguousarray(past.command))
        if self._next % STRIDE or (self._next - self._started) * model.period < self._wait:
            return model
        return self._estimation.corrected(model, STRIDE)

    def interrupt(self) -> None:
        """Discard incomplete data after an interruption."""
        self._estimation.interrupt()

    def report(self) -> Mapping[str, float | str]:
        """Return the values handed over, relative to the rig file's, and a sentence for each coefficient."""
        return self._estimation.report()

    def at_bounds(self) -> tuple[str, ...]:
        """Return a sentence for each coefficient whose estimate is out of reach."""
        return self._estimation.at_bounds()


def _surroundings(setting: Setting) -> Surroundings | None:
    """Return the coupling of the piston as modelled by the law; None if it is unknown."""
    if setting.actuator == "force":
        return Surroundings(0.0, 0.0)
    # Laws written before rig files contained the coupling have it among their parameters.
    knows = setting.model if setting.model.coupling_stiffness > 0.0 else setting.tuning
    stiffness, damping = (getattr(knows, name, 0.0) for name in ("coupling_stiffness", "coupling_damping"))
    return Surroundings(stiffness, damping) if stiffness > 0.0 else None


def check(p: Parameters, setting: Setting) -> None:
    """Accept every setting: coefficients that cannot be estimated remain unchanged."""


def build(p: Parameters, setting: Setting) -> Adaptation:
    """Return a new companion."""
    return Adaptation(p, setting)
