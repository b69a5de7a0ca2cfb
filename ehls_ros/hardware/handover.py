"""Hand-over of the valve between controllers: role of the plant, and role of each controller.

The driver is the controller whose commands the safety gate accepts. The plant selects it, and announces it on the topic
``driver`` together with its first cycle. Every other controller stands by. Its law follows each cycle, and its command goes to
the topic ``standby_command``.

* :class:`PlantHandover`, the role of the plant. Its inputs at the opening of a cycle are the owner of the gate, and whether the
  gate is vacant.
* :class:`ControllerHandover`, the role of each controller. Its inputs are the announcements, and the commands of other
  controllers.

The roles share no state: they exchange messages only, which may arrive out of order. Each role has a table of states and
events, shown in docs/how_to/switching.md. Times are arguments, so neither role reads a clock.
"""

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping
from enum import Enum
from typing import NamedTuple, TypeVar

from ehls_ros.errors import BadInput
from ehls_ros.hardware.safety_gate import Gate

RELAY_TIME = 0.5
"""Maximum time from the announcement of a controller to its first command; a slower driver may be a relay [s]."""

MAX_MESSAGES = 100
"""Number of stored announcements, and of stored commands; a controller lags by far fewer cycles."""

SAME, IMPOSSIBLE = "·", "–"
"""In the tables: no change of the state; the event cannot occur in the state."""

State = TypeVar("State", bound=Enum)
Event = TypeVar("Event", bound=Enum)


def _table(states: type[State], rows: Mapping[Event, str]) -> Mapping[State, Mapping[Event, State]]:
    """Return the next state by state and event.

    Args:
        states: the states.
        rows: next states by event, one word per state in the order of the states.
    """
    cells = {event: dict(zip(states, row.split(), strict=True)) for event, row in rows.items()}
    for row in cells.values():
        row.update({state: state.value for state, cell in row.items() if cell == SAME})
    return {state: {event: states(row[state]) for event, row in cells.items() if row[state] != IMPOSSIBLE} for state in states}


class PlantState(Enum):
    """State of the plant's role."""

    VACANT = "vacant"
    """No controller drives; the first to answer is selected."""
    SELECTED = "selected"
    """The gate accepts a controller that has not been announced yet."""
    DRIVEN = "driven"
    """The gate accepts the announced driver."""
    SWITCHING = "switching"
    """A successor takes over in the next cycle."""


class PlantEvent(Enum):
    """Event of the plant's role."""

    ACCEPTED = "first command of a new owner accepted"
    SUCCESSOR = "successor chosen"
    NO_SUCCESSOR = "driver ends, none or several stand by"
    OWNED = "cycle opens, the gate has an owner"
    VACATED = "cycle opens, the gate is vacant"


# fmt: off
PLANT_TABLE = _table(PlantState, {
    #                         vacant     selected   driven     switching
    PlantEvent.ACCEPTED:     "selected   ·          ·          ·",
    PlantEvent.SUCCESSOR:    "switching  switching  switching  ·",
    PlantEvent.NO_SUCCESSOR: "·          ·          ·          selected",
    PlantEvent.OWNED:        "driven     driven     ·          driven",
    PlantEvent.VACATED:      "·          vacant     vacant     vacant",
})
# fmt: on
"""Next state of the plant's role by state and event."""


class Succession(NamedTuple):
    """Result of the end of a driver.

    Attributes:
        text: for the log.
        expected: whether no other controller was present, which is normal at the end of a run with one controller.
    """

    text: str
    expected: bool


class Standby:
    """The controllers that have recently sent standby commands.

    Attributes:
        cycle: the newest cycle.
    """

    def __init__(self, patience: int) -> None:
        """Start without controllers.

        Args:
            patience: cycles without an answer after which a controller no longer counts as standby.
        """
        self._patience = patience
        self._answered: dict[str, int] = {}
        self.cycle = -1

    def note(self, sender: str, cycle: int) -> None:
        """Record a controller's standby command for a cycle."""
        self._answered[sender] = cycle

    def remove(self, sender: str) -> None:
        """Remove a controller that has left."""
        self._answered.pop(sender, None)

    @property
    def behind(self) -> list[str]:
        """Controllers that have not answered the newest cycle."""
        return [sender for sender in self.ready if self._answered.get(sender, -math.inf) < self.cycle]

    @property
    def ready(self) -> list[str]:
        """Controllers that could take over, sorted."""
        return sorted(sender for sender, cycle in self._answered.copy().items() if cycle >= self.cycle - self._patience)

    def named(self, name: str) -> str:
        """Return the sender of a controller.

        Args:
            name: its node, by full name or last part, or the sender itself.

        Raises:
            BadInput: no standby controller has this name, or several have.
        """
        ready = self.ready
        found = [sender for sender in ready if sender == name or belongs_to_node(sender, name)]
        if len(found) == 1:
            return found[0]
        expected = f"one of those that stand by: {', '.join(found or ready) or 'none'}"
        what = f"several controllers are named '{name}'" if found else f"'{name}' does not stand by"
        raise BadInput(what, "switch_controller", expected)


def belongs_to_node(sender: str, name: str) -> bool:
    """Return whether a sender belongs to a node.

    Args:
        sender: ``<full name of the node>-<process>``.
        name: full name of the node, or its last part.
    """
    node = sender.rpartition("-")[0]
    return bool(name) and (node == name or node.endswith(f"/{name.strip('/')}"))


class PlantHandover:
    """The plant's role: selection of the driver, and succession.

    The methods are called by the loop, except :meth:`request`, which is thread-safe.

    Attributes:
        state: of the role.
        standby: the controllers that could take over.
        announced: the announced driver; empty: none drives; None: nothing has been announced.
        drives_from: first cycle of the announced driver.
        take_over_after: silence of the driver after which the standby controller takes over [s]; 0: never.
    """

    def __init__(self, gate: Gate, *, grace: int, patience: int, take_over_after: float = 0.0) -> None:
        """Begin without an announcement.

        Args:
            gate: the safety gate of the valve.
            grace: number of cycles after the first announcement of a driver that other controllers may still answer.
            patience: cycles without an answer after which a controller no longer counts as standby.
            take_over_after: silence of the driver after which the standby controller takes over [s]; 0: never.
        """
        self._gate = gate
        self._grace = grace
        self.take_over_after = take_over_after
        self._lock = threading.Lock()
        self._successor = ""
        # Last driver that ended or timed out.
        self._departed = ""
        # First cycle answered by the gate's owner, and last cycle that others may answer before the announcement reaches them.
        self._first = 0
        self._unaware_until = -1
        self.state = PlantState.VACANT
        self.standby = Standby(patience)
        self.announced: str | None = None
        self.drives_from = 0

    def take(self, sender: str, answered: int, spool: float, cycle: int) -> bool:
        """Pass a command to the gate, except one sent before the announcement of another driver.

        Args:
            sender: name of the sender.
            answered: the cycle that the command answers.
            spool: spool command [m].
            cycle: the present cycle.

        Returns:
            Whether the gate accepts the sender. The command then counts as an answer, even if the gate refuses its value.
        """
        gate = self._gate
        owner = gate.owner
        if not (owner is None or owner == sender or gate.vacant):
            if not self.announced:
                # Another controller has owned the gate since this cycle, so this one stands by from the next cycle on.
                self.standby.note(sender, answered)
                return False
            if answered <= self._unaware_until:
                return False
        gate.take(answered, spool, sender)
        if gate.owner != owner:
            self._first = min(answered, cycle)
            with self._lock:
                self._move(PlantEvent.ACCEPTED)
        return sender == gate.owner

    def note_standby(self, sender: str, cycle: int) -> None:
        """Record a standby command of a controller for a cycle."""
        if sender != self._gate.owner:
            self.standby.note(sender, cycle)

    def request(self, name: str) -> str:
        """Schedule the takeover of a standby controller for the next cycle.

        Args:
            name: its node, by full name or last part, or the sender itself.

        Returns:
            Text of the answer to the request.

        Raises:
            BadInput: no standby controller has this name, or several have.
        """
        owner = self._gate.owner or ""
        if name and (name == owner or belongs_to_node(owner, name)):
            return f"{owner} drives already"
        successor = self.standby.named(name)
        with self._lock:
            self._successor = successor
            self._move(PlantEvent.SUCCESSOR)
        return f"{successor} takes over"

    def end(self, sender: str) -> Succession | None:
        """Process the end of a controller, and choose a successor if it was the driver.

        Returns:
            The result; None if it was not the driver.
        """
        self.standby.remove(sender)
        return self._choose_successor(sender, "leaves") if sender == self._gate.owner else None

    def replace_silent(self) -> Succession | None:
        """Choose a successor for a silent driver.

        Returns:
            The result; None unless the driver is silent for too long and another controller stands by.
        """
        gate = self._gate
        if self.take_over_after <= 0.0 or self.state is PlantState.SWITCHING or not gate.driving:
            return None
        silence, owner = gate.command_age, gate.owner
        if owner and silence >= self.take_over_after and self.standby.ready:
            return self._choose_successor(owner, f"has been silent for {silence:.3f} s")
        return None

    def _choose_successor(self, owner: str, reason: str) -> Succession:
        """Choose the only standby controller as successor; without one, the gate reacts to the missing commands."""
        ready = [sender for sender in self.standby.ready if sender != owner]
        with self._lock:
            self._departed = owner
            self._successor = ready[0] if len(ready) == 1 else ""
            self._move(PlantEvent.SUCCESSOR if self._successor else PlantEvent.NO_SUCCESSOR)
        if not ready:
            return Succession(f"{owner} {reason}; no other controller stands by", expected=True)
        count = len(ready)
        result = f"{ready[0]} takes over" if count == 1 else f"no takeover: {count} controllers stand by, one is needed"
        return Succession(f"{owner} {reason}; {result}", expected=False)

    def decide(self, cycle: int) -> bool:
        """Hand the valve to the successor, if any, and determine the driver from a cycle on.

        Args:
            cycle: first cycle of that driver.

        Returns:
            Whether the driver has changed and must be announced.
        """
        state, gate = self.state, self._gate
        driver = "" if gate.vacant else gate.owner
        if (state is PlantState.DRIVEN or state is PlantState.VACANT) and (driver is None or driver == self.announced):
            return False
        with self._lock:
            if self.state is PlantState.SWITCHING:
                self._hand_over(cycle)
            # The controller that drives by the gate; empty: the first to answer will; None: the gate was just disabled.
            driver = "" if gate.vacant else gate.owner
            if driver is None:
                return False
            self._move(PlantEvent.OWNED if driver else PlantEvent.VACATED)
        if driver == self.announced:
            return False
        if driver and not self.announced:
            # Before this announcement, the other controllers answered too.
            self._unaware_until = cycle + self._grace
        self.announced = driver
        self.standby.remove(driver)
        self.drives_from = self._first if driver else cycle
        return True

    def _hand_over(self, cycle: int) -> None:
        before, departed = self._gate.owner, self._departed
        self._gate.hand_over(self._successor)
        if before and before != departed and cycle > self.standby.cycle:
            # From the first cycle of its successor on, the former driver is awaited like any standby controller.
            self.standby.note(before, cycle - 1)
        self._successor, self._departed, self._first = "", "", cycle

    def _move(self, event: PlantEvent) -> None:
        self.state = PLANT_TABLE[self.state][event]


class ControllerState(Enum):
    """State of a controller's role."""

    UNANNOUNCED = "unannounced"
    """No announcement has arrived."""
    VACANT = "vacant"
    """No controller drives; the first to answer is selected."""
    CLAIMING = "claiming"
    """This controller has answered a vacant plant; the announcement is pending."""
    UNCONTESTED = "uncontested"
    """No announcement followed the answer; this controller answers each cycle."""
    DRIVING = "driving"
    """This controller drives."""
    EXPECTING = "expecting"
    """Another driver is announced; none of its commands has arrived."""
    STANDBY = "standby"
    """Another controller drives."""
    RELAYED = "relayed"
    """The announced driver is a relay, which passes this controller's commands on to the plant."""


class ControllerEvent(Enum):
    """Event of a controller's role."""

    VACANCY = "announced: none drives"
    SELF = "announced: this controller"
    UNKNOWN = "announced: another, without commands so far"
    OTHER = "announced: another, whose commands arrive"
    RELAY = "announced: a known relay"
    ANSWERED = "this controller answers a cycle"
    UNDECIDED = "no announcement within the patience"
    COMMAND = "command of the announced driver"
    NO_COMMAND = "no command in time, the plant does not read this controller's"


# fmt: off
CONTROLLER_TABLE = _table(ControllerState, {
    #                            unannounced  vacant     claiming     uncontested  driving    expecting  standby    relayed
    ControllerEvent.VACANCY:    "vacant       ·          vacant       vacant       vacant     vacant     vacant     vacant",
    ControllerEvent.SELF:       "driving      driving    driving      driving      ·          driving    driving    driving",
    ControllerEvent.UNKNOWN:    "expecting    expecting  expecting    expecting    expecting  ·          expecting  expecting",
    ControllerEvent.OTHER:      "standby      standby    standby      standby      standby    standby    ·          standby",
    ControllerEvent.RELAY:      "–            relayed    relayed      relayed      relayed    relayed    relayed    ·",
    ControllerEvent.ANSWERED:   "·            claiming   ·            ·            ·          ·          ·          ·",
    ControllerEvent.UNDECIDED:  "·            ·          uncontested  ·            ·          ·          ·          ·",
    ControllerEvent.COMMAND:    "·            ·          ·            ·            ·          standby    ·          standby",
    ControllerEvent.NO_COMMAND: "·            ·          ·            ·            ·          relayed    ·          ·",
})
# fmt: on
"""Next state of a controller's role by state and event."""

_BLOCKED = frozenset({ControllerState.UNANNOUNCED, ControllerState.CLAIMING, ControllerState.EXPECTING})
_FOLLOWING = frozenset({ControllerState.EXPECTING, ControllerState.STANDBY, ControllerState.RELAYED})


class _Command(NamedTuple):
    """Command of another controller."""

    cycle: int
    spool: float
    sender: str


class ControllerHandover:
    """Role of a controller: permission to answer a cycle, destination of the answer, and commands of the driver.

    Attributes:
        state: of the role.
        may_answer: whether cycles may be answered in this state.
        follows: whether another driver is announced and its commands are read.
        valve_follows: whether commands reach the valve, by the newest announcement.
    """

    def __init__(self, sender: str, patience: float) -> None:
        """Begin without an announcement.

        Args:
            sender: name of this controller in messages.
            patience: longest wait for the announcement after an answer to a vacant plant [s].
        """
        self._sender = sender
        self._patience = patience
        self._announcements: deque[tuple[int, str]] = deque(maxlen=MAX_MESSAGES)
        self._commands: deque[_Command] = deque(maxlen=MAX_MESSAGES)
        self._controllers: set[str] = set()
        self._relays: set[str] = set()
        self._since = 0.0
        self.valve_follows = True
        self._enter(ControllerState.UNANNOUNCED)

    def announce(self, first: int, sender: str, *, driving: bool, now: float) -> None:
        """Process an announcement of the plant.

        Args:
            first: first cycle of the driver.
            sender: the driver; empty: none drives.
            driving: whether commands reach the valve.
            now: monotonic time [s].
        """
        self.valve_follows = driving
        if self._announcements and self._announcements[-1] == (first, sender):
            return
        self._announcements.append((first, sender))
        self._since = now
        if not sender:
            event = ControllerEvent.VACANCY
        elif sender == self._sender:
            event = ControllerEvent.SELF
        elif sender in self._controllers:
            event = ControllerEvent.OTHER
        else:
            event = ControllerEvent.RELAY if sender in self._relays else ControllerEvent.UNKNOWN
        self._move(event)

    def answer(self, now: float) -> None:
        """Record an answer of this controller to a cycle at a monotonic time [s]."""
        if self.state is ControllerState.VACANT:
            self._since = now
            self._move(ControllerEvent.ANSWERED)

    def is_overdue(self, now: float) -> bool:
        """Return whether the awaited message is overdue at a monotonic time [s]; see :meth:`give_up`."""
        if self.state is ControllerState.CLAIMING:
            return now - self._since >= self._patience
        return self.state is ControllerState.EXPECTING and now - self._since > RELAY_TIME

    def give_up(self, plant_reads_commands: Callable[[], bool]) -> None:
        """Stop waiting for an overdue message: announcement, or command of the announced driver.

        Args:
            plant_reads_commands: returns whether the plant reads the commands of this controller directly, without a relay.
        """
        if self.state is ControllerState.CLAIMING:
            self._move(ControllerEvent.UNDECIDED)
        elif self.state is ControllerState.EXPECTING and not plant_reads_commands():
            self._relays.add(self._announcements[-1][1])
            self._move(ControllerEvent.NO_COMMAND)

    def take_command(self, cycle: int, spool: float, sender: str) -> None:
        """Record a command [m] from the topic of the valve commands; its sender is a controller and no relay."""
        self._commands.append(_Command(cycle, spool, sender))
        self._controllers.add(sender)
        self._relays.discard(sender)
        if self.follows and self.state is not ControllerState.STANDBY and sender == self._announcements[-1][1]:
            self._move(ControllerEvent.COMMAND)

    def forget_commands(self) -> None:
        """Drop the commands of other controllers: the plant has restarted."""
        self._commands.clear()

    def driver_of(self, cycle: int) -> str:
        """Return the driver of a cycle; empty if it is the first controller to answer, or a relay."""
        for first, sender in reversed(self._announcements):
            if cycle >= first:
                return "" if sender in self._relays else sender
        return ""

    def has_command(self, driver: str, since: int) -> bool:
        """Return whether a command of a driver for a cycle or a later one has arrived."""
        return any(command.cycle >= since for command in self._commands if command.sender == driver)

    def command_of(self, driver: str, first: int, last: int) -> float | None:
        """Return a driver's newest command [m] for the cycles from ``first`` to ``last``; None if there is none."""
        given = [command[:2] for command in self._commands if command.sender == driver and first <= command.cycle <= last]
        return max(given)[1] if given else None

    def _move(self, event: ControllerEvent) -> None:
        self._enter(CONTROLLER_TABLE[self.state][event])

    def _enter(self, state: ControllerState) -> None:
        self.state = state
        self.may_answer = state not in _BLOCKED
        self.follows = state in _FOLLOWING
