"""The safety gate in front of every actuator, simulated or real.

The valve receives only what :meth:`Gate.step` returns: a finite number within the rig's spool limit, whatever the input.
Detectors raise faults; each fault has a reaction. ``warn`` reports it. ``hold`` keeps the last safe command until the fault is
gone; once ``hold_time`` is used up it becomes a ramp. ``position`` holds the piston where it comes to rest, ``unload`` lets the
load pressure decay and then closes the valve (:mod:`ehls_ros.hardware.takeover`). ``ramp`` moves to null in ``ramp_time``,
``cut`` goes to null at once. These four are latched until :meth:`Gate.reset`, after which the gate must be enabled again. An
emergency stop must first be acknowledged by its name. docs/hardware.md has a table of all states and transitions.

The calls of a cycle, in order::

    gate = Gate(rig, period)
    gate.begin()                                        # the loop starts; gate.leave() ends it, at null
    gate.sense(cycle, readings, force_reference)        # a new snapshot, before it is published
    gate.take(cycle_answered, spool, sender)            # for each command received
    gate.enable()                                       # once, on request: None, or why not
    write(gate.step(monotonic_seconds))                 # every cycle, with or without a command

All calls are thread-safe. Only the constructor and :meth:`Gate.retune` raise; the others accept any argument.
"""

import math
import operator
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

from ehls_ros.control.rig_scale import tuned_for
from ehls_ros.errors import BadInput
from ehls_ros.hardware.command_intake import HOLD_REACTION, ROUNDING, CommandIntake
from ehls_ros.hardware.detectors import Detector, Readings, SensorDetectors
from ehls_ros.hardware.gate_bounds import Bound, bounds_of, out_of_bounds, within
from ehls_ros.hardware.gate_parameters import REACTIONS, Change, Parameters, changes
from ehls_ros.hardware.takeover import TakeOver
from ehls_ros.physics.rig import SENSED, Rig
from ehls_ros.schema import parse

STATES = DISABLED, ENABLING, ACTIVE, HOLDING, POSITION_CONTROL, UNLOADING, RAMPING, CUT, STOPPED = (
    "disabled", "enabling", "active", "holding", "position control", "unloading", "ramping", "cut", "stopped",
)  # fmt: skip
"""States, mildest first. Disabled, ramping, cut and stopped lead to null and stay there.

From position control on they are latched, except for an unloading that an operator requested, which ends disabled.
"""

DRIVING = frozenset({ENABLING, ACTIVE, HOLDING})
"""States in which commands reach the actuator."""

TAKEN_OVER = frozenset({POSITION_CONTROL, UNLOADING})
"""States in which the gate itself drives the actuator."""

OK, WARN, ERROR = range(3)
"""Levels of :meth:`Gate.health`."""

WARN_REACTION, _, POSITION_REACTION, UNLOAD_REACTION, RAMP_REACTION, CUT_REACTION = range(len(REACTIONS))
RAMP_NAME, CUT_NAME = REACTIONS[RAMP_REACTION], REACTIONS[CUT_REACTION]

TRIPPED = {POSITION_REACTION: POSITION_CONTROL, UNLOAD_REACTION: UNLOADING, RAMP_REACTION: RAMPING, CUT_REACTION: CUT}
"""State of a trip, by its reaction."""

STOP = "emergency_stop"
LEFT = "left_active"
READING_LOST = "reading_lost"
"""Causes without a detector: a requested emergency stop; the end of the loop while the actuator was driven; the lack of a
plausible reading of the quantity that the gate itself controls."""

STOP_TIME = 1.0
"""Shortest duration of an emergency stop [s]."""

MAX_SILENCE = 1.0
"""Silence of the service thread after which an emergency stop may not get through [s]."""

MAX_PERIODS = 3
"""Largest number of periods by which one step may move or blend in the output, however late it is."""

RECOVERY = 0.1
"""Rate at which the used hold time recovers while commands pass [s/s]."""

NOTICE = 2.0
"""Time for which diagnostics keep showing a fault that is over [s]."""

MIN_STEP = 0.01
"""A clock that advances by less than this fraction of a period per step counts as stopped."""

MAX_CYCLE = 2**63
"""Bound of the cycle numbers, which have 64 bits."""

CHANGES_KEPT = 20
"""Parameter changes kept for the diagnostics."""

NO_READINGS = (math.nan,) * len(SENSED)


def steps_to_drive(state: str, stop: str) -> tuple[str, ...]:
    """Return the requests, in order, after which commands reach the actuator again; none if they do, or soon will.

    Args:
        state: of the gate, one of :data:`STATES`.
        stop: name of the engaged emergency stop; empty if none is.
    """
    if state in DRIVING:
        return ()
    first = (f"acknowledge {stop}",) if stop else ("unload",) if state == POSITION_CONTROL else ()
    return (*first, *(() if state == DISABLED else ("reset",)), "enable")


class Cause(NamedTuple):
    """One cause of a trip.

    Attributes:
        detector: its name.
        reaction: of the gate.
        time: of the step that tripped, by the caller's clock [s].
        value: the offending value.
        limit: the limit it broke.
        unit: of both.
        subject: the signal or sender, where the detector watches several.
    """

    detector: str
    reaction: str
    time: float
    value: float = math.nan
    limit: float = math.nan
    unit: str = ""
    subject: str = ""

    def __str__(self) -> str:
        """Return the cause in one line."""
        if self.detector in {STOP, LEFT, READING_LOST}:
            return self.detector.replace("_", " ")
        about = f" of {self.subject}" if self.subject else ""
        if math.isnan(self.limit):
            return f"{self.detector}{about}"
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.detector}{about}: {self.value:.6g}{unit}, limit {self.limit:.6g}{unit}"


class Gate:
    """The safety gate of one actuator.

    Attributes:
        parameters: the limits and reactions in force.
        state: one of :data:`STATES`.
        output: the command written last [m].
        causes: of the trip, in order of occurrence; empty while not tripped.
        detectors: by name.
    """

    def __init__(
        self,
        rig: Rig,
        period: float,
        parameters: Parameters | None = None,
        measured: Collection[str] = SENSED,
        *,
        bounds: Mapping[str, Bound] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start disabled, at null; the loop has not begun.

        Args:
            rig: the rig behind the actuator, for its limits.
            period: control period [s].
            parameters: limits and reactions; None: the defaults for the rig, clipped to the bounds.
            measured: signals of ``SENSED`` that the rig measures; the others are ignored.
            bounds: of the parameters; None: those of the rig; empty for an actuator that cannot be damaged.
            clock: times the emergency stop [s].

        Raises:
            BadInput: a parameter, the period, a signal or one of the rig's limits is wrong.
        """
        _check_rig(rig, period, measured)
        self._bounds = bounds_of(rig, float(period)) if bounds is None else bounds
        chosen = _checked(within(tuned_for(Parameters, rig), self._bounds) if parameters is None else parameters)
        for complaint in out_of_bounds(chosen, self._bounds):
            raise complaint
        self._lock = threading.Lock()
        self._clock = clock
        self._period = float(period)
        self._limit = float(rig.limits.spool)
        self._commands = CommandIntake(self._limit, self._period)
        self._command_stale = Detector("command_stale", "s")
        self._sensor_stale = Detector("sensor_stale", "s")
        self._clock_fault = Detector("clock", "s")
        self._gap = Detector("gap", "s", "")
        self._device_null = Detector("device_null", "", "")
        self._services_silent = Detector("services_silent", "s", "")
        # Of equally severe faults the first in this order is the first cause: without snapshots there are no commands either.
        sensors = SensorDetectors()
        without_parameter = (self._gap, self._device_null, self._services_silent)
        self._all = (
            *without_parameter,
            *self._commands.detectors,
            *sensors,
            self._sensor_stale,
            self._command_stale,
            self._clock_fault,
        )
        self.detectors = {detector.name: detector for detector in self._all}
        self._readings = Readings(rig, measured, chosen, sensors)
        self._law = TakeOver(rig, self._period)
        self._put_in_force(chosen)
        self.state, self.output = DISABLED, 0.0
        self.causes: list[Cause] = []
        self._stops, self._stopped_at = 0, -math.inf
        self._changes: deque[str] = deque(maxlen=CHANGES_KEPT)
        self._now = 0.0
        self._forget_cycles()
        self._begun = False

    @property
    def driving(self) -> bool:
        """Whether commands reach the actuator."""
        return self.state in DRIVING

    @property
    def in_full(self) -> bool:
        """Whether commands reach the actuator unchanged, neither blended in nor held."""
        return self.driving and self.state != HOLDING and self._blend >= 1.0

    @property
    def owner(self) -> str | None:
        """Sender whose commands are accepted; None: the first to send."""
        return self._commands.owner

    @property
    def vacant(self) -> bool:
        """Whether the first sender is accepted, as no commands reach the actuator and none are sent."""
        return not self.driving and self._commands.silent

    @property
    def command_age(self) -> float:
        """Age of the command in use [s]."""
        with self._lock:
            return self._age_of_command()

    @property
    def stop(self) -> str:
        """Name of the engaged emergency stop; empty if none is."""
        return f"stop-{self._stops}" if self.state == STOPPED else ""

    def begin(self) -> None:
        """Start the loop: cycle count and ages restart, latched faults stay latched."""
        with self._lock:
            self._forget_cycles()
            self._begun = True

    def leave(self) -> None:
        """End the loop, at null at once; an open gate must then be reset and enabled to continue."""
        with self._lock:
            self._begun = False
            self.output = 0.0
            driven = self.driving or self.state in TAKEN_OVER
            if driven and not self.causes:
                self.causes.append(Cause(LEFT, CUT_NAME, self._time))
            if driven or self.state == RAMPING:
                self.state = CUT
            self._commands.begin()

    def _forget_cycles(self) -> None:
        self._commands.begin()
        self._readings.begin()
        self._time = math.nan
        self._newest = -1
        self._sensed = False
        self._lag = 0.0
        self._snapshot_age = math.inf
        self._held = 0.0
        self._blend = 0.0
        self._start = 0.0
        self._slope = math.inf
        self._taken_for = 0.0
        for detector in self._all:
            detector.look(False, 0.0, detector.limit)

    def retune(self, parameters: Parameters) -> list[Change]:
        """Apply other limits and reactions from the next call, and return the changes.

        Raises:
            BadInput: a parameter is out of range, or :meth:`objection` refuses the change; the old parameters stay.
        """
        chosen = _checked(parameters)
        with self._lock:
            wrong = self._objection(chosen)
            if wrong is not None:
                raise wrong
            changed = list(changes(self.parameters, chosen))
            self._changes.extend(f"{change} at {self._time:.3f} s" for change in changed)
            self._readings.retune(chosen)
            self._put_in_force(chosen)
            return changed

    def objection(self, parameters: Parameters) -> BadInput | None:
        """Return why other parameters are refused: out of the rig's bounds, or weaker protection while the gate is open."""
        with self._lock:
            return self._objection(parameters)

    def _objection(self, parameters: Parameters) -> BadInput | None:
        beyond = next(out_of_bounds(parameters, self._bounds), None)
        if beyond is not None or not self.driving:
            return beyond
        weaker = next((change for change in changes(self.parameters, parameters) if change.weakens), None)
        return (
            None
            if weaker is None
            else BadInput(f"{weaker}", "safety gate", "a disabled gate, since this weakens the protection")
        )

    def _put_in_force(self, chosen: Parameters) -> None:
        self.parameters = chosen
        for detector in self._all:
            detector.retune(chosen)
        self._commands.retune(chosen)
        self._command_stale.limit, self._sensor_stale.limit = chosen.command_timeout, chosen.sensor_timeout
        self._gap.limit = min(chosen.command_timeout, chosen.sensor_timeout)

    def sense(
        self,
        cycle: int,
        measured: Sequence[float],
        reference: float = math.nan,
        *,
        elapsed: float | None = None,
        lag: float = 0.0,
        at_null: bool = False,
    ) -> None:
        """Check a snapshot.

        Args:
            cycle: its number; a snapshot whose number is not above the last one is ignored.
            measured: readings in the order of ``SENSED``, shape (7,).
            reference: force reference of this cycle [N]; NaN if unknown.
            elapsed: time since the last snapshot by the rig's clock [s]; None: one period per cycle.
            lag: transport delay [s].
            at_null: the device keeps the valve closed.
        """
        number = _integer(cycle)
        with self._lock:
            if number is None or number <= self._newest:
                return
            periods = (number - self._newest) * self._period if self._newest >= 0 else 0.0
            self._newest = number
            self._sensed = True
            self._lag = max(_number(lag), 0.0)
            self._device_null.look(bool(at_null), math.nan, math.nan)
            # A force error is meaningless while the loop does not control the force.
            expected = _number(reference) if self.state in {ACTIVE, HOLDING} else math.nan
            lasted = periods if elapsed is None else elapsed
            self._readings.look(_readings(measured), lasted, self.output, expected, driving=self.driving)

    def take(self, cycle: int, spool: float, sender: str = "") -> bool:
        """Accept or refuse a command.

        Args:
            cycle: the cycle it answers.
            spool: spool command [m].
            sender: name of the sender.

        Returns:
            Whether it is accepted; if not, :meth:`health` gives the reason.
        """
        number, value = _integer(cycle), _number(spool)
        with self._lock:
            followed = self.state in {ACTIVE, HOLDING}
            return self._commands.take(number, value, str(sender), self._newest, followed=followed, driving=self.driving)

    def hand_over(self, sender: str) -> None:
        """Accept the commands of another sender from now on, and no longer those of the present one."""
        with self._lock:
            self._commands.hand_over(str(sender), self._newest)

    def set_service_silence(self, silence: float) -> None:
        """Set how long the service thread has been silent [s]: without it the rig could not be stopped."""
        with self._lock:
            self._services_silent.look(not silence <= MAX_SILENCE, silence, MAX_SILENCE)

    def step(self, time: float) -> float:
        """Return the command to write; call it once per cycle, whatever was received.

        Args:
            time: monotonic time; in lockstep the time of the cycle [s].

        Returns:
            The spool command [m], finite and within the rig's limit.
        """
        moment = _number(time)
        with self._lock:
            elapsed = self._elapsed(moment)
            driven = self.driving or self.state in TAKEN_OVER
            self._gap.look(driven and elapsed > self._gap.limit + ROUNDING, elapsed, self._gap.limit)
            self._age(elapsed)
            worst = self._worst()
            self._react(worst, elapsed)
            self._move(elapsed)
            self._law.follow(self.output, elapsed)
            return self.output

    def _elapsed(self, time: float) -> float:
        """Return the time since the last step; one period if the clock is implausible."""
        elapsed = time - self._time
        sound = MIN_STEP * self._period < elapsed < math.inf
        first = math.isnan(self._time) and math.isfinite(time)
        self._clock_fault.look(not (sound or first), elapsed, 0.0)
        if math.isfinite(time):
            self._time = time
        if not sound:
            elapsed = self._period
        self._now += min(elapsed, NOTICE)
        return elapsed

    def _age(self, elapsed: float) -> None:
        """Age command and snapshot, unless they are new, and check whether they are stale."""
        p = self.parameters
        self._commands.advance_age(elapsed)
        self._snapshot_age = self._lag if self._sensed else self._snapshot_age + elapsed
        self._sensed = False
        age = self._age_of_command()
        # No command is due before the gate is enabled, nor while it drives the actuator itself.
        missed = self.state not in {DISABLED, *TAKEN_OVER} and age >= p.command_timeout - ROUNDING
        self._command_stale.look(missed, age, p.command_timeout)
        self._sensor_stale.look(self._snapshot_age >= p.sensor_timeout - ROUNDING, self._snapshot_age, p.sensor_timeout)

    def _age_of_command(self) -> float:
        return self._commands.age(self._newest, self._lag)

    def _worst(self) -> Detector | None:
        """Return the fault with the strongest reaction; None if all only warn."""
        worst, reaction = None, WARN_REACTION
        for detector in self._all:
            if detector.raised:
                detector.seen = self._now
                if detector.reaction > reaction:
                    worst, reaction = detector, detector.reaction
        return worst

    def _react(self, worst: Detector | None, elapsed: float) -> None:
        self._commands.clear_message_faults()
        # To a gate that drives the actuator itself, there is no command to hold.
        severe = worst is not None and worst.reaction > HOLD_REACTION
        if worst is not None and (self.state in {RAMPING, CUT, STOPPED} or (severe and self.state in TAKEN_OVER)):
            self._trip(worst, worst.reaction)
        elif self.driving:
            if worst is None:
                self.state = ACTIVE if self._blend >= 1.0 else ENABLING
                self._held = max(0.0, self._held - RECOVERY * elapsed)
            elif worst.reaction > HOLD_REACTION:
                self._trip(worst, worst.reaction)
            else:
                self.state = HOLDING
                self._held += elapsed
                if self._held > self.parameters.hold_time + ROUNDING:
                    self._trip(worst, RAMP_REACTION)

    def _trip(self, worst: Detector, reaction: int) -> None:
        """Latch a fault together with all others present; a stronger reaction overrides a weaker one."""
        others = [d for d in self._all if d.raised and d.reaction >= HOLD_REACTION and d is not worst]
        for detector in (worst, *others):
            if all(cause.detector != detector.name for cause in self.causes):
                named = REACTIONS[max(reaction if detector is worst else detector.reaction, HOLD_REACTION)]
                self.causes.append(
                    Cause(detector.name, named, self._time, detector.value, detector.limit, detector.unit, detector.subject)
                )
        state = TRIPPED.get(reaction, self.state)
        if STATES.index(state) > STATES.index(self.state):
            self._enter(state)

    def _enter(self, state: str) -> None:
        """Begin a reaction that is latched."""
        if state in TAKEN_OVER:
            self._law.start()
            # As fast as a ramp from the largest opening: one from the present opening may be slower than the load's motion.
            ramp_time, rate = self.parameters.ramp_time, self.parameters.command_rate
            self._slope = min(self._limit / ramp_time, rate) if ramp_time > 0.0 else rate
            self._taken_for = 0.0
            self.state = state
        elif state == RAMPING:
            self._ramp(RAMPING)
        else:
            self.state = state

    def _ramp(self, state: str) -> None:
        """Start the ramp to null."""
        self.state = state
        self._slope = abs(self.output) / self.parameters.ramp_time if self.parameters.ramp_time > 0.0 else math.inf

    def _move(self, elapsed: float) -> None:
        """Move the output as the state requires."""
        if not self._begun or self.state in {CUT, STOPPED}:
            self.output = 0.0
        elif self.state in {ENABLING, ACTIVE}:
            passed = min(elapsed, MAX_PERIODS * self._period)
            goal = self._commands.value
            if self.state == ENABLING:
                enable_time = self.parameters.enable_time
                self._blend = min(1.0, self._blend + passed / enable_time) if enable_time > 0.0 else 1.0
                goal = self._start + self._blend * (goal - self._start)
                if self._blend >= 1.0:
                    self.state, goal = ACTIVE, self._commands.value
            self._approach(goal, self.parameters.command_rate * max(passed, self._period))
        elif self.state in TAKEN_OVER:
            self._control(min(elapsed, MAX_PERIODS * self._period))
        elif self.state != HOLDING:
            self._close(elapsed)

    def _approach(self, goal: float, reach: float) -> None:
        """Move the output towards a goal, by a largest step [m]."""
        if abs(goal - self.output) > reach:
            goal = self.output + math.copysign(reach, goal - self.output)
        self.output = min(max(goal, -self._limit), self._limit)

    def _close(self, elapsed: float) -> None:
        """Ramp the output to null."""
        left = abs(self.output) - self._slope * elapsed
        self.output = math.copysign(left, self.output) if left > 0.0 else 0.0

    def _control(self, elapsed: float) -> None:
        """Hold the piston or unload it; without a plausible reading, or when it is unloaded, ramp to null."""
        position = self._readings.position
        if self.state == POSITION_CONTROL:
            goal = self._law.hold(position)
        else:
            goal = self._law.unload(self._readings.pressure, position, elapsed)
            self._taken_for += elapsed
        late = self._taken_for > self.parameters.unload_time + ROUNDING
        over = self.state == UNLOADING and (self._law.unloaded or late)
        if math.isnan(goal):
            self.causes.append(Cause(READING_LOST, RAMP_NAME, self._time))
        if over or math.isnan(goal):
            self._ramp(RAMPING if self.causes else DISABLED)
            self._close(elapsed)
        else:
            self._approach(goal, self._slope * max(elapsed, self._period))

    def enable(self) -> str | None:
        """Let commands through from the next step, blended in over ``enable_time``.

        Returns:
            None, or the reason for refusal: tripped, no fresh command or snapshot, or a fault that would trip the gate at once.
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
        if not self._begun or self.state == UNLOADING:
            return "unloading" if self._begun else "the node is not active"
        if self.state == STOPPED:
            return f"{self.stop} is engaged; acknowledge_stop first"
        if self.causes:
            return f"tripped by {self.causes[0]}; {'unload, then ' * (self.state == POSITION_CONTROL)}reset_trips first"
        fault = self._fault()
        if fault is not None:
            return f"{fault.name} persists"
        if not self._sensed and self._snapshot_age >= self.parameters.sensor_timeout - ROUNDING:
            return "no fresh snapshot"
        return "no fresh command" if self._age_of_command() >= self.parameters.command_timeout - ROUNDING else None

    def _fault(self) -> Detector | None:
        """Return a present fault that does more than warn, if there is one."""
        return next((d for d in self._all if d.raised and d.reaction >= HOLD_REACTION), None)

    def disable(self) -> None:
        """Ramp the output to null, whoever drives the actuator, and release the owner."""
        with self._lock:
            self._commands.owner = None
            if self.driving or self.state in TAKEN_OVER:
                self._ramp(RAMPING if self.causes else DISABLED)

    def unload(self) -> str | None:
        """Let the load pressure decay, then ramp the output to null; the owner is released.

        Returns:
            None, or the reason for refusal: the gate is closed, or neither load pressure nor force has a plausible reading.
        """
        with self._lock:
            if self.state == UNLOADING:
                return None
            if not self.driving and self.state != POSITION_CONTROL:
                return f"the gate is {self.state}: the valve is closed"
            if math.isnan(self._readings.pressure):
                return "neither load pressure nor force has a plausible reading"
            self._commands.owner = None
            self._enter(UNLOADING)
            return None

    def emergency_stop(self) -> str:
        """Cut and latch until acknowledged.

        Returns:
            The name of the stop; a stop during another has a separate name and time.
        """
        with self._lock:
            self._stops += 1
            self._stopped_at = self._clock()
            self.state = STOPPED
            if all(cause.detector != STOP for cause in self.causes):
                self.causes.append(Cause(STOP, CUT_NAME, self._time))
            return self.stop

    def acknowledge(self, stop: str) -> str | None:
        """Release an emergency stop; the trip stays latched until the reset.

        Args:
            stop: its name.

        Returns:
            None, or the reason for refusal: another stop is engaged, or it is younger than :data:`STOP_TIME`.
        """
        with self._lock:
            if self.state != STOPPED:
                return "no emergency stop is engaged"
            if stop != self.stop:
                return f"the engaged stop is {self.stop}, not {stop!r}"
            lasted = self._clock() - self._stopped_at
            if lasted < STOP_TIME:
                return f"{self.stop} is {lasted:.1f} s old; it lasts at least {STOP_TIME:g} s"
            self.state = CUT
            return None

    def reset(self) -> str | None:
        """Clear the trip once its causes are gone; the gate is then disabled, at null.

        Returns:
            None, or the reason for refusal.
        """
        with self._lock:
            if not self.causes:
                return None
            if self.state == STOPPED:
                return f"{self.stop} is engaged; acknowledge_stop first"
            if self.state == POSITION_CONTROL:
                return "the piston is held in position control; unload first"
            if self.state == UNLOADING or self.output != 0.0:
                return "not at null yet"
            fault = self._fault()
            if fault is not None:
                return f"{fault.name} persists"
            self.causes.clear()
            self.state, self._commands.owner = DISABLED, None
            return None

    def health(self) -> tuple[int, str, dict[str, float | str]]:
        """Return level, message and figures for diagnostics, with every limit, reaction and count."""
        with self._lock:
            lately = [d for d in self._all if d.raised or self._now - d.seen < NOTICE]
            if self.causes and self.causes[0].detector == LEFT:
                level, message = OK, f"{self.state}; reset_trips, then enable to go on"
            elif self.causes:
                first = (
                    f"acknowledge_stop {self.stop}, then " if self.stop else "unload, then " * (self.state == POSITION_CONTROL)
                )
                level, message = ERROR, f"{self.state}, tripped by {self.causes[0]}; {first}reset_trips and enable to go on"
            elif lately:
                level, message = WARN, f"{self.state}; {', '.join(d.name for d in lately)}"
            else:
                level, message = OK, self.state
            figures: dict[str, float | str] = {
                "state": self.state,
                "stop": self.stop,
                "output_m": self.output,
                "output_limit_m": self._limit,
                "owner": self.owner if self.owner is not None else "nobody",
                "command_age_s": self._age_of_command(),
                "snapshot_age_s": self._snapshot_age,
                "held_s": self._held,
            }
            for number, cause in enumerate(self.causes, 1):
                figures[f"cause_{number}"] = f"{cause} at {cause.time:.6f} s, {cause.reaction}"
            for number, change in enumerate(self._changes, 1):
                figures[f"change_{number}"] = change
            for detector in self._all:
                figures[f"fault_{detector.name}"] = _line(detector)
            figures |= self.parameters._asdict()
            return level, message, figures


def _line(detector: Detector) -> str:
    limit = f" beyond {detector.limit:.6g} {detector.unit}".rstrip() if math.isfinite(detector.limit) else ""
    now = ", now" if detector.raised else ""
    return f"{REACTIONS[detector.reaction]}{limit}, {detector.count} times{now}"


def _number(value: Any) -> float:
    """Convert a value to float; NaN if that is impossible."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _integer(value: Any) -> int | None:
    """Convert a value to an integer of 64 bits; None if that is impossible."""
    try:
        number = operator.index(value)
    except TypeError:
        return None
    return number if abs(number) < MAX_CYCLE else None


def _readings(measured: Any) -> Sequence[float]:
    """Return a snapshot's readings, finite or NaN, so that an infinite one exceeds no limit; all NaN if the length is wrong."""
    try:
        values = [_number(reading) for reading in measured]
    except TypeError:
        return NO_READINGS
    return [value if math.isfinite(value) else math.nan for value in values] if len(values) == len(SENSED) else NO_READINGS


def _checked(parameters: Parameters) -> Parameters:
    """Check a parameter set, which may have been built without checks."""
    return parse(Parameters, parameters._asdict(), "safety gate")


def watched(measured: Collection[str]) -> tuple[str, ...]:
    """Return those of a rig's measured signals that a gate watches: the signals of every rig, in the order of ``SENSED``."""
    return tuple(signal for signal in SENSED if signal in measured)


def _check_rig(rig: Rig, period: float, measured: Collection[str]) -> None:
    if not 0.0 < _number(period) <= 0.1:
        raise BadInput(f"period is {period!r}", "safety gate", "a number above 0 and at most 0.1 s")
    for signal in measured:
        if signal not in SENSED:
            raise BadInput(f"signal {signal!r} is unknown", "safety gate", f"one of {', '.join(SENSED)}")
    limits = rig.limits
    for name in ("spool", "force", "load_pressure", "velocity"):
        if not 0.0 < _number(getattr(limits, name)) < math.inf:
            raise BadInput(f"{name} is {getattr(limits, name)!r}", "safety gate: limits", "a finite number above 0")
    if not -math.inf < limits.position[0] < limits.position[1] < math.inf:
        raise BadInput(f"position is {list(limits.position)}", "safety gate: limits", "two finite numbers [min, max]")
