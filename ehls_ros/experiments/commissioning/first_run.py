"""The last steps of a commissioning: the law tuned for the rig as found, and the force that it controls for the first time."""

from typing import Any

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.control.controller import Outlook
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.references._signals import eased_in
from ehls_ros.experiments.catalogue import largest_force
from ehls_ros.experiments.commissioning.measuring import LOOK
from ehls_ros.experiments.commissioning.session import ENABLE_TIME, Session, Stopped
from ehls_ros.experiments.commissioning.step import Contradiction, Known, Outcome
from ehls_ros.experiments.graph_check import laws_for
from ehls_ros.experiments.loop import controller_of, sampled
from ehls_ros.experiments.real_rig import ADAPTING
from ehls_ros.experiments.spec import Spec
from ehls_ros.experiments.stepped_run import largest, stepped_run, swing
from ehls_ros.experiments.tuning.files import EXPERIMENT, experiment_text, parameters_text
from ehls_ros.experiments.tuning.task import HELD_FREQUENCY, HELD_PART, servo_of, task_of
from ehls_ros.experiments.tuning.tune import tune, with_numbers
from ehls_ros.progress import Update
from ehls_ros.trajectory import Trajectory

LAW = "fasmc_predictive"
"""The law: it takes delay, coupling and noise from the rig file."""

PARTS = (HELD_PART, 3.0 * HELD_PART, 8.0 * HELD_PART)
"""Amplitudes of the first runs over the largest force, in their order; the law is tuned for the first."""

PERIODS = 3
"""Number of periods of their sine, which is eased in during the first; the last half is judged."""

OFF = 0.3
"""Swing of the error over the amplitude above which no larger one follows; the largest error may be friction's."""


def law_tuned(session: Session, known: Known, progress: Update) -> Outcome:
    """Tune the law in simulation, with the standard errors found as its uncertainty.

    Raises:
        Contradiction: in simulation, no numbers hold the force.
    """
    found = tune(task_of(known.rig, LAW, period=session.period), wanted=known.wanted, progress=progress)
    if found.lost:
        remedy = "numbers that fit the rig, for which the report shows those found, or `ehls tune` with another law"
        raise Contradiction(f"in simulation, no numbers of {LAW} hold the force of the rig as found", "rig file", remedy)
    chosen, limit = found.chosen, found.causal_limit
    beside = f", {chosen.error / limit:.1f} times the causal limit" if limit > 0.0 else ""
    margins = f"{chosen.gain_db:.1f} dB and {chosen.margins.phase_deg:.0f} degrees"
    errors = f"largest error {chosen.error:.3g} N, with the defaults {found.default.error:.3g} N"
    simulated = f"simulated: {errors}{beside}; margins {margins}"
    numbers = tuple(f"{name} {found.default.numbers[name]:.4g} -> {value:.4g}" for name, value in chosen.numbers.items())
    files = {f"{LAW}.yaml": parameters_text(found), EXPERIMENT: experiment_text(found)}
    return Outcome(known.rig, (), (simulated, *numbers, *found.remarks), {}, chosen.numbers, files)


def first_run(session: Session, known: Known, progress: Update) -> Outcome:
    """Control the force, with a small amplitude first, while the actuator under test holds its position.

    Raises:
        Contradiction: readings that the law needs are not wired.
        Stopped: the gate closed the valve, or the force does not follow.
    """
    if LAW not in laws_for("force", session.measured):
        needs = f"channels for the readings of {LAW}: {', '.join(CONTROLLERS.load(LAW).NEEDS)}"
        raise Contradiction(f"only {', '.join(session.wired)} are wired", "bridge file", needs)
    sentences, recordings = list[str](), dict[str, Trajectory]()
    for number, part in enumerate(PARTS):
        progress(number, len(PARTS))
        rest = session.record(None, LOOK)
        amplitude = part * largest_force(known.rig)
        spec = _experiment(known, session.period, amplitude, float(np.mean(rest["force_n"])))
        loop = _Loop(spec)
        recording = recordings[f"first_run_{100.0 * part:g}"] = session.record(
            loop.command, spec.settings.duration, presses=True
        )
        error = recording["force_n"] - loop.wanted[: len(recording), 0]
        error = error[np.isfinite(error)]
        expected = stepped_run(spec._replace(companions=()))
        peak = f"largest error {largest(error):.3g} N, simulated {expected.largest():.3g} N"
        said = f"amplitude {amplitude:.4g} N: {peak}; swing {swing(error):.3g} N, simulated {expected.swing():.3g} N"
        if swing(error) > OFF * amplitude:
            raise Stopped(f"{said}; no larger amplitude before the cause is found (tune with larger margins)", recording)
        sentences.append(said)
    return Outcome(known.rig, (), (*sentences, *loop.apparent_errors()), recordings, known.numbers)


def _experiment(known: Known, period: float, amplitude: float, offset: float) -> Spec:
    """Return the experiment of a first run, with adaptation: it finds the errors of the file that commissioning has left."""
    still = {"name": "constant", "value": 0.0}
    content: dict[str, Any] = {
        "title": "first run",
        "duration": PERIODS / HELD_FREQUENCY,
        "control_period": period,
        "reference": {"name": "sine", "amplitude": amplitude, "frequency": HELD_FREQUENCY, "offset": offset},
        "disturbance": servo_of(known.rig, still),
    }
    spec = with_numbers(task_of(known.rig, LAW, content).spec, known.numbers)
    duration = spec.settings._replace(duration=PERIODS / HELD_FREQUENCY)
    return spec._replace(settings=duration, companions=ADAPTING)


def _wanted(spec: Spec) -> Array:
    """Return the reference with its derivatives, eased in from its offset, shape (cycles, 3)."""
    period = spec.settings.control_period
    rows = sampled(spec.reference, period).rows(0, spec.cycles)
    lead, start = 1.0 / HELD_FREQUENCY, spec.reference.parameters.offset
    led = range(round(lead / period))
    rows[led] = [eased_in(rows[cycle].tolist(), start, cycle * period, lead) for cycle in led]
    return rows


class _Loop:
    """The law with adaptation, as the session calls it.

    Attributes:
        wanted: the reference with its derivatives, shape (cycles, 3).
    """

    def __init__(self, spec: Spec) -> None:
        self._law = controller_of(spec)
        self.wanted, self._friction = _wanted(spec), np.zeros(2)
        self._blended = round(ENABLE_TIME / spec.settings.control_period)

    def command(self, measured: Array, cycle: int) -> float:
        """Return the spool command [m]."""
        command = self._law.step(measured, self.wanted[cycle], self._friction, outlook=Outlook(cycle))
        if cycle < self._blended:
            # The valve receives less than the law's command, which adaptation would take for the valve's gain.
            self._law.companions.interrupt()
        return command

    def apparent_errors(self) -> tuple[str, ...]:
        """Return the sentences of the adaptation on errors of the rig file."""
        return tuple(value for value in self._law.companions.report().values() if isinstance(value, str))
