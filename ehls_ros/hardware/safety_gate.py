"""The safety gate: what stands before every actuator write, simulated or real.

Nothing reaches the valve but what :meth:`Gate.step` returns: a finite number within the rig's spool limit, whatever came in.
Faults are seen by detectors; each has a reaction. ``warn`` says so and goes on. ``hold`` keeps the last safe command and goes
on once the fault is gone; holding that uses up ``hold_time`` becomes a ramp. ``ramp`` leads to null in ``ramp_time``, ``cut``
is null at once. Ramp and cut are latched until :meth:`Gate.reset`, and after that the gate has to be enabled again.

The calls, in each cycle's order::

    gate = Gate(rig, period)
    gate.sense(cycle, readings, force_reference)        # a new snapshot, before it is sent out
    gate.take(cycle_answered, spool, sender)            # for each command that came in
    gate.enable()                                       # once, when asked to: None, or why not
    write(gate.step(monotonic_seconds))                 # every cycle, whether a command came or not

Every call may come from any thread, and none of these raises, whatever it is given.
"""

import math
import operator
import threading
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

from ehls_ros.errors import BadInput
from ehls_ros.hardware.detectors import Detector, Readings, sensor_detectors
from ehls_ros.hardware.gate_parameters import REACTIONS, Parameters
from ehls_ros.physics.rig import SENSED, Rig
from ehls_ros.schema import parse

STATES = DISABLED, ENABLING, ACTIVE, HOLDING, RAMPING, CUT = ("disabled", "enabling", "active", "holding", "ramping", "cut")
"""Disabled, ramping and cut end at null and stay there; ramping and cut are latched."""

OK, WARN, ERROR = range(3)
"""Levels of :meth:`Gate.health`."""

WARN_REACTION, HOLD_REACTION, RAMP_REACTION, CUT_REACTION = range(len(REACTIONS))

STOP = "emergency_stop"

RECOVERY = 0.1
"""While commands pass, the time that may be spent holding grows back at this part of time's pace."""

NOTICE = 2.0
"""How long diagnostics speak of a fault that is over [s]."""

LEAST_STEP = 0.01
"""A clock that moves by less than this part of a period from step to step stands still."""

ROUNDING = 1e-9
"""Ages are sums of periods [s]."""

LARGEST_CYCLE = 2**63
"""Cycles are numbers of 64 bits."""

NO_READINGS = (math.nan,) * len(SENSED)


class Cause(NamedTuple):
    """One cause of a trip.

    Attributes:
        detector: its name.
        reaction: what followed.
        time: of the step that tripped, by the caller's clock [s].
        value: what was seen.
        limit: what it broke.
        unit: of both.
        subject: the signal or sender, where the detector looks at several.
    """

    detector: str
    reaction: str
    time: float
    value: float
    limit: float
    unit: str
    subject: str

    def __str__(self) -> str:
        """Return it in a line."""
        if self.detector == STOP:
            return "emergency stop"
        about = f" of {self.subject}" if self.subject else ""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.detector}{about}: {self.value:.6g}{unit}, limit {self.limit:.6g}{unit}"


class Gate:
    """The safety gate of one actuator.

    Attributes:
        parameters: the limits and reactions in force.
        state: one of :data:`STATES`.
        output: the command written last [m].
        causes: what tripped it, first cause first; empty while it is not tripped.
        owner: whose commands are taken; None: whoever comes first.
        detectors: by name.
    """

    def __init__(
        self, rig: Rig, period: float, parameters: Parameters | None = None, measured: Collection[str] = SENSED
    ) -> None:
        """Start disabled, at null.

        Args:
            rig: the rig behind the actuator, for its limits.
            period: control period [s].
            parameters: limits and reactions; None: the declared defaults.
            measured: signals of ``SENSED`` the rig measures; what the others hold is never looked at.

        Raises:
            BadInput: a parameter, the period, a signal or one of the rig's limits is wrong.
        """
        chosen = _checked(Parameters() if parameters is None else parameters)
        _check_rig(rig, period, measured)
        self._lock = threading.Lock()
        self._period = float(period)
        self._limit = float(rig.limits.spool)
        order = (
            Detector("command_not_finite", "m"),
            Detector("command_range", "m"),
            Detector("command_rate", "m/s"),
            Detector("command_stale", "s"),
            Detector("command_order", "cycles"),
            Detector("second_sender", ""),
            *sensor_detectors(),
            Detector("sensor_stale", "s"),
            Detector("clock", "s"),
        )
        self.detectors = {detector.name: detector for detector in order}
        (
            self._not_finite, self._range, self._rate, self._stale, self._order, self._stranger,
        ) = order[:6]  # fmt: skip
        self._blind, self._clock = order[-2:]
        self._all = order
        self._readings = Readings(rig, measured, chosen, self.detectors)
        self._put_in_force(chosen)
        self.state = DISABLED
        self.output = 0.0
        self.causes: list[Cause] = []
        self.owner: str | None = None
        self._stopped = False
        self._time = math.nan
        self._now = 0.0
        self._newest = -1
        self._sensed = False
        self._snapshot_age = math.inf
        self._command = 0.0
        self._answered = -1
        self._taken = False
        self._command_age = math.inf
        self._held = 0.0
        self._blend = 0.0
        self._start = 0.0
        self._slope = math.inf

    @property
    def driving(self) -> bool:
        """Whether commands reach the actuator."""
        return self.state in {ENABLING, ACTIVE, HOLDING}

    def retune(self, parameters: Parameters) -> None:
        """Put other limits and reactions in force from the next call on.

        Raises:
            BadInput: one of them is out of its range; the old ones stay.
        """
        chosen = _checked(parameters)
        with self._lock:
            self._readings.retune(chosen)
            self._put_in_force(chosen)

    def _put_in_force(self, chosen: Parameters) -> None:
        self.parameters = chosen
        for detector in self._all:
            detector.retune(chosen)
        self._range.limit, self._rate.limit = self._limit, chosen.command_rate
        self._stale.limit, self._blind.limit = chosen.command_timeout, chosen.sensor_timeout

    def sense(self, cycle: int, measured: Sequence[float], reference: float = math.nan) -> None:
        """Take a snapshot.

        Args:
            cycle: its number, counted up; one not above the last is no new snapshot.
            measured: readings in the order of ``SENSED``, shape (7,).
            reference: what the force should be in this cycle [N]; NaN where it is not known.
        """
        number = _integer(cycle)
        with self._lock:
            if number is None or number <= self._newest:
                return
            elapsed = (number - self._newest) * self._period if self._newest >= 0 else 0.0
            self._newest = number
            self._sensed = True
            # What is not driven owes no force.
            wanted = _number(reference) if self.state in {ACTIVE, HOLDING} else math.nan
            self._readings.look(_readings(measured), elapsed, self.output, wanted)

    def take(self, cycle: int, spool: float, sender: str = "") -> bool:
        """Take a command that came in.

        Args:
            cycle: the cycle it answers.
            spool: spool command [m].
            sender: who sent it.

        Returns:
            Whether it counts; if not, :meth:`health` says why.
        """
        number, value = _integer(cycle), _number(spool)
        with self._lock:
            if number is None:
                self._order.again(math.nan, float(self._newest), "no cycle")
                return False
            return self._is_owner(str(sender)) and self._is_due(number) and self._is_sound(number, value)

    def _is_owner(self, sender: str) -> bool:
        silent = not self._taken and self._command_age >= self.parameters.command_timeout - ROUNDING
        if self.owner is None or silent:
            self.owner = sender
        elif sender != self.owner:
            self._stranger.again(math.nan, math.nan, sender)
            return False
        return True

    def _is_due(self, number: int) -> bool:
        """Tell whether a command answers a cycle that is neither to come, nor answered, nor long past."""
        if number > self._newest:
            self._order.again(float(number - self._newest), 0.0, "to come")
        elif number == self._answered:
            self._order.again(0.0, 1.0, "duplicate")
        elif number < self._answered:
            self._order.again(float(number - self._answered), 1.0, "out of order")
        elif (self._newest - number) * self._period >= self.parameters.command_timeout - ROUNDING:
            self._order.again(float(self._newest - number), self.parameters.command_timeout / self._period, "too old")
        else:
            return True
        return False

    def _is_sound(self, number: int, value: float) -> bool:
        """Tell whether a command's value may be followed, and keep it if so."""
        finite = math.isfinite(value)
        self._not_finite.look(not finite, value, math.inf)
        if not finite:
            return False
        beyond = abs(value) > self._limit
        self._range.look(beyond, value, self._limit)
        if beyond and self._range.reaction >= HOLD_REACTION:
            return False
        value = min(max(value, -self._limit), self._limit)
        rate = abs(value - self._command) / ((number - self._answered) * self._period)
        # Where it does not act, and while it is blended in, a command may jump: the output does not.
        fast = rate > self.parameters.command_rate and self._answered >= 0 and self.state in {ACTIVE, HOLDING}
        self._rate.look(fast, rate, self.parameters.command_rate)
        if fast and self._rate.reaction >= HOLD_REACTION:
            return False
        self._command, self._answered, self._taken = value, number, True
        return True

    def step(self, time: float) -> float:
        """Decide on the command to write; to be called once a cycle, whatever came in.

        Args:
            time: monotonic time, in lockstep that of the cycle [s].

        Returns:
            The spool command [m], finite and within the rig's limit.
        """
        moment = _number(time)
        with self._lock:
            elapsed = self._elapsed(moment)
            self._age(elapsed)
            worst = self._worst()
            self._react(worst, elapsed)
            self._move(elapsed)
            return self.output

    def _elapsed(self, time: float) -> float:
        """Return the time since the last step; where the clock tells none, a period."""
        elapsed = time - self._time
        sound = LEAST_STEP * self._period < elapsed < math.inf
        first = math.isnan(self._time) and math.isfinite(time)
        self._clock.look(not (sound or first), elapsed, 0.0)
        if math.isfinite(time):
            self._time = time
        if not sound:
            elapsed = self._period
        self._now += min(elapsed, NOTICE)
        return elapsed

    def _age(self, elapsed: float) -> None:
        """Let command and snapshot age, unless they are new, and look whether they are stale."""
        p = self.parameters
        self._command_age = 0.0 if self._taken else self._command_age + elapsed
        self._snapshot_age = 0.0 if self._sensed else self._snapshot_age + elapsed
        self._taken = self._sensed = False
        age = self._age_of_command()
        # Before it is enabled, nobody need command.
        missed = self.state != DISABLED and age >= p.command_timeout - ROUNDING
        self._stale.look(missed, age, p.command_timeout)
        self._blind.look(self._snapshot_age >= p.sensor_timeout - ROUNDING, self._snapshot_age, p.sensor_timeout)

    def _age_of_command(self) -> float:
        """Return the age of what the gate follows: since it came, or of the cycle it answers if that is more."""
        return max(self._command_age, (self._newest - self._answered) * self._period)

    def _worst(self) -> Detector | None:
        """Return the fault with the strongest reaction; None where nothing is to be done."""
        worst, reaction = None, WARN_REACTION
        for detector in self._all:
            if detector.raised:
                detector.seen = self._now
                if detector.reaction > reaction:
                    worst, reaction = detector, detector.reaction
        return worst

    def _react(self, worst: Detector | None, elapsed: float) -> None:
        for detector in (self._order, self._stranger):
            detector.raised = False
        if worst is not None and self.state in {RAMPING, CUT}:
            self._trip(worst, worst.reaction)
        elif self.driving:
            if worst is None:
                self.state = ACTIVE if self._blend >= 1.0 else ENABLING
                self._held = max(0.0, self._held - RECOVERY * elapsed)
            elif worst.reaction >= RAMP_REACTION:
                self._trip(worst, worst.reaction)
            else:
                self.state = HOLDING
                self._held += elapsed
                if self._held > self.parameters.hold_time + ROUNDING:
                    self._trip(worst, RAMP_REACTION)

    def _trip(self, worst: Detector, reaction: int) -> None:
        """Latch a fault, and whatever else is wrong at the same time; a cut overrides a ramp."""
        others = [d for d in self._all if d.raised and d.reaction >= HOLD_REACTION and d is not worst]
        for detector in (worst, *others):
            if all(cause.detector != detector.name for cause in self.causes):
                named = REACTIONS[max(reaction if detector is worst else detector.reaction, HOLD_REACTION)]
                self.causes.append(
                    Cause(detector.name, named, self._time, detector.value, detector.limit, detector.unit, detector.subject)
                )
        if reaction == CUT_REACTION:
            self.state = CUT
        elif self.state not in {RAMPING, CUT} and reaction == RAMP_REACTION:
            self._ramp(RAMPING)

    def _ramp(self, state: str) -> None:
        """Begin to lead the output to null."""
        self.state = state
        self._slope = abs(self.output) / self.parameters.ramp_time if self.parameters.ramp_time > 0.0 else math.inf

    def _move(self, elapsed: float) -> None:
        """Bring the output where the state wants it."""
        if self.state in {ENABLING, ACTIVE}:
            wanted = self._command
            if self.state == ENABLING:
                self._blend = self._blended(elapsed)
                wanted = self._start + self._blend * (self._command - self._start)
                if self._blend >= 1.0:
                    self.state, wanted = ACTIVE, self._command
            reach = self.parameters.command_rate * max(elapsed, self._period)
            if abs(wanted - self.output) > reach:
                wanted = self.output + math.copysign(reach, wanted - self.output)
            self.output = min(max(wanted, -self._limit), self._limit)
        elif self.state == CUT:
            self.output = 0.0
        elif self.state != HOLDING:
            left = abs(self.output) - self._slope * elapsed
            self.output = math.copysign(left, self.output) if left > 0.0 else 0.0

    def _blended(self, elapsed: float) -> float:
        if self.parameters.enable_time <= 0.0:
            return 1.0
        return min(1.0, self._blend + elapsed / self.parameters.enable_time)

    def enable(self) -> str | None:
        """Let commands through from the next step on, blended in over ``enable_time``.

        Returns:
            None, or why that cannot be: tripped, no fresh command or snapshot, or a fault that would trip it at once.
        """
        with self._lock:
            if self.driving:
                return None
            reason = self._why_not()
            if reason is not None:
                return reason
            self._start, self._blend, self._held = self.output, 0.0, 0.0
            self.state = ENABLING
            return None

    def _why_not(self) -> str | None:
        if self.causes:
            return f"tripped by {self.causes[0]}; reset first"
        if self._stopped:
            return "emergency stop is engaged"
        fault = self._fault()
        if fault is not None:
            return f"{fault.name} persists"
        if not self._sensed and self._snapshot_age >= self.parameters.sensor_timeout - ROUNDING:
            return "no fresh snapshot"
        age = (self._newest - self._answered) * self._period if self._taken else self._age_of_command()
        return "no fresh command" if age >= self.parameters.command_timeout - ROUNDING else None

    def _fault(self) -> Detector | None:
        """Return a fault that is there now and would not be let pass."""
        return next((d for d in self._all if d.raised and d.reaction >= HOLD_REACTION), None)

    def disable(self) -> None:
        """Lead the output to null and let the actuator's owner go."""
        with self._lock:
            self.owner = None
            if self.driving:
                self._ramp(DISABLED)

    def emergency_stop(self, engaged: bool = True) -> None:
        """Cut and latch.

        Args:
            engaged: False lets go of the stop; the trip stays until it is reset.
        """
        with self._lock:
            self._stopped = bool(engaged)
            if engaged:
                self.state = CUT
                if all(cause.detector != STOP for cause in self.causes):
                    self.causes.append(Cause(STOP, REACTIONS[CUT_REACTION], self._time, math.nan, math.nan, "", ""))

    def reset(self) -> str | None:
        """Clear the trip once its causes are gone; the gate is disabled then, at null.

        Returns:
            None, or why that cannot be.
        """
        with self._lock:
            if not self.causes:
                return None
            if self._stopped:
                return "emergency stop is engaged"
            if self.output != 0.0:
                return "not at null yet"
            fault = self._fault()
            if fault is not None:
                return f"{fault.name} persists"
            self.causes.clear()
            self.state, self.owner = DISABLED, None
            return None

    def health(self) -> tuple[int, str, dict[str, Any]]:
        """Return level, message and figures for diagnostics: every limit, reaction and count in force."""
        with self._lock:
            lately = [d for d in self._all if d.raised or self._now - d.seen < NOTICE]
            if self.causes:
                level, message = ERROR, f"{self.state}, tripped by {self.causes[0]}"
            elif lately:
                level, message = WARN, f"{self.state}; {', '.join(d.name for d in lately)}"
            else:
                level, message = OK, self.state
            figures: dict[str, Any] = {
                "state": self.state,
                "output_m": self.output,
                "output_limit_m": self._limit,
                "owner": self.owner if self.owner is not None else "nobody",
                "command_age_s": self._age_of_command(),
                "snapshot_age_s": self._snapshot_age,
                "held_s": self._held,
            }
            for number, cause in enumerate(self.causes, 1):
                figures[f"cause_{number}"] = f"{cause} at {cause.time:.6f} s, {cause.reaction}"
            for detector in self._all:
                figures[f"fault_{detector.name}"] = _line(detector)
            figures |= self.parameters._asdict()
            return level, message, figures


def _line(detector: Detector) -> str:
    limit = f" beyond {detector.limit:.6g} {detector.unit}".rstrip() if math.isfinite(detector.limit) else ""
    now = ", now" if detector.raised else ""
    return f"{REACTIONS[detector.reaction]}{limit}, {detector.count} times{now}"


def _number(value: Any) -> float:
    """Return a value as a float; what is none becomes NaN."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _reading(value: Any) -> float:
    """Return a reading as a float; what is not finite becomes NaN, which is beyond no limit, for it tells nothing."""
    number = _number(value)
    return number if math.isfinite(number) else math.nan


def _integer(value: Any) -> int | None:
    """Return a value as an integer of 64 bits; None where it is none."""
    try:
        number = operator.index(value)
    except TypeError:
        return None
    return number if abs(number) < LARGEST_CYCLE else None


def _readings(measured: Any) -> Sequence[float]:
    """Return a snapshot's readings, finite or NaN; a snapshot of another length holds none."""
    try:
        values = [_reading(reading) for reading in measured]
    except TypeError:
        return NO_READINGS
    return values if len(values) == len(SENSED) else NO_READINGS


def _checked(parameters: Parameters) -> Parameters:
    """Return a parameter set once more checked, for it may have been built without."""
    return parse(Parameters, parameters._asdict(), "safety gate")


def _check_rig(rig: Rig, period: float, measured: Collection[str]) -> None:
    if not 0.0 < _number(period) <= 0.1:
        raise BadInput(f"period is {period!r}", "safety gate", "a number above 0, at most 0.1 s")
    for signal in measured:
        if signal not in SENSED:
            raise BadInput(f"signal {signal!r} is unknown", "safety gate", f"one of {', '.join(SENSED)}")
    limits = rig.limits
    for name in ("spool", "force", "load_pressure", "velocity"):
        if not 0.0 < _number(getattr(limits, name)) < math.inf:
            raise BadInput(f"{name} is {getattr(limits, name)!r}", "safety gate: limits", "a finite number above 0")
    if not -math.inf < limits.position[0] < limits.position[1] < math.inf:
        raise BadInput(f"position is {list(limits.position)}", "safety gate: limits", "two finite numbers [min, max]")
