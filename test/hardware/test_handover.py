"""Hand-over between controllers: both tables of docs/how_to/switching.md entry by entry, and standby controllers by name."""

from pathlib import Path

import pytest

from ehls_ros.errors import BadInput
from ehls_ros.hardware.handover import (
    CONTROLLER_TABLE,
    PLANT_TABLE,
    RELAY_TIME,
    ControllerEvent,
    ControllerHandover,
    ControllerState,
    PlantEvent,
    PlantHandover,
    PlantState,
    Standby,
)

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "switching.md"
SAME, IMPOSSIBLE = "·", "–"
SIC, FASMC, OTHER = "/ehls/sic_node-17", "/ehls/fasmc_node-4", "/ehls/fasmc_node-5"
PID, RELAY = "/ehls/pid_node-9", "/ehls/relay_node-3"
GRACE, PATIENCE = 100, 10.0


def table(role):
    """Return the next state for each event and state."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    header = next(line for line in lines if line.startswith(f"| {role} |"))
    states = [cell.strip() for cell in header.split("|")[2:-1]]
    found = {}
    for row in lines[lines.index(header) + 2 :]:
        if not row.startswith("|"):
            break
        event, *cells = (cell.strip() for cell in row.split("|")[1:-1])
        found[event] = dict(zip(states, cells, strict=True))
    return found


def entries(role):
    found = [(event, state, next_state) for event, row in table(role).items() for state, next_state in row.items()]
    return [entry for entry in found if entry[2] != IMPOSSIBLE]


def assert_same_table(role, states, events, made):
    """Compare the table on the page with that of the module, whose events have the same order."""
    for event, row in zip(events, table(role).values(), strict=True):
        for state in states:
            cell = row[state.value]
            expected = None if cell == IMPOSSIBLE else state if cell == SAME else states(cell)
            assert made[state].get(event) is expected, (event, state)


# --- the plant's role ---------------------------------------------------------------------------


class Gate:
    """The part of the safety gate that decides on senders; closed and silent at first."""

    def __init__(self):
        self.owner, self.vacant, self.driving, self.command_age = None, True, False, 0.0
        self.refused = []

    def take(self, answered, spool, sender):
        if self.owner is None or self.vacant:
            self.owner, self.vacant = sender, False
        elif sender != self.owner:
            self.refused.append(sender)

    def hand_over(self, sender):
        self.owner = sender


class Plant:
    """A plant's role in cycle 10, with SIC on standby."""

    def __init__(self, **options):
        self.gate = Gate()
        self.role = PlantHandover(self.gate, grace=GRACE, patience=10, **options)
        self.cycle = 10
        self.role.standby.cycle = 9
        self.published = []
        self.open_cycle()

    def open_cycle(self):
        if self.role.decide(self.cycle):
            self.published.append((self.role.drives_from, self.role.announced))
        self.role.standby.cycle = self.cycle
        self.role.standby.note(SIC, self.cycle)
        self.cycle += 1

    def command(self, sender, answered=None):
        return self.role.take(sender, self.cycle - 1 if answered is None else answered, 0.0, self.cycle - 1)

    def vacate(self):
        self.gate.vacant = True


def selected(plant):
    assert plant.command(FASMC)


def driven(plant):
    selected(plant)
    plant.open_cycle()


def switching(plant):
    driven(plant)
    assert plant.role.request("sic_node") == f"{SIC} takes over"


IN_PLANT_STATE = {"vacant": lambda _: None, "selected": selected, "driven": driven, "switching": switching}


def accept_new_owner(plant):
    plant.vacate()
    assert plant.command(PID)


def end_of_driver(plant):
    plant.role.standby.note(PID, plant.cycle - 1)
    plant.gate.owner = plant.gate.owner or FASMC
    text, expected = plant.role.end(plant.gate.owner)
    assert not expected
    assert "2 controllers stand by" in text


def open_with_owner(plant):
    plant.gate.owner, plant.gate.vacant = plant.gate.owner or FASMC, False
    plant.open_cycle()


def open_vacant(plant):
    plant.vacate()
    plant.open_cycle()


PLANT_EVENTS = {
    "first command of a new owner accepted": accept_new_owner,
    "successor chosen, on request or as the driver ends": lambda plant: plant.role.request(SIC),
    "the driver ends; none or several stand by": end_of_driver,
    "a cycle opens, the gate has an owner": open_with_owner,
    "a cycle opens, the gate is vacant": open_vacant,
}


def test_the_plants_table_has_every_state_and_every_event():
    assert list(table("plant")) == list(PLANT_EVENTS)
    assert all(list(row) == list(IN_PLANT_STATE) for row in table("plant").values())
    assert_same_table("plant", PlantState, PlantEvent, PLANT_TABLE)


@pytest.mark.parametrize(("event", "state", "next_state"), entries("plant"))
def test_each_entry_of_the_plants_table_is_true(event, state, next_state):
    plant = Plant()
    IN_PLANT_STATE[state](plant)
    assert plant.role.state.value == state
    PLANT_EVENTS[event](plant)
    assert plant.role.state.value == (state if next_state == SAME else next_state)


def test_the_first_to_answer_is_published_with_its_first_cycle_and_the_others_stand_by():
    plant = Plant()
    assert plant.published == [(10, "")]
    assert plant.command(FASMC)
    assert not plant.command(PID)
    assert plant.gate.refused == []
    plant.open_cycle()
    assert plant.published[1:] == [(10, FASMC)]
    assert PID in plant.role.standby.ready
    # For a while the other may not know; after that the gate reports it.
    assert not plant.command(PID)
    assert plant.gate.refused == []
    plant.command(PID, answered=11 + GRACE + 1)
    assert plant.gate.refused == [PID]


def test_a_successor_drives_from_the_next_cycle_on_and_the_former_driver_stands_by_from_then_on():
    plant = Plant()
    switching(plant)
    first = plant.cycle
    assert plant.gate.owner == FASMC
    plant.open_cycle()
    assert plant.gate.owner == SIC
    assert plant.published[-1] == (first, SIC)
    assert plant.role.standby.behind == [FASMC]
    assert plant.role.request("sic_node") == f"{SIC} drives already"


def test_the_only_standby_controller_succeeds_a_driver_that_ends_and_the_ended_one_is_not_awaited():
    plant = Plant()
    driven(plant)
    text, expected = plant.role.end(FASMC)
    assert (text, expected) == (f"{FASMC} leaves; {SIC} takes over", False)
    plant.open_cycle()
    assert plant.gate.owner == SIC
    assert FASMC not in plant.role.standby.ready


def test_without_a_standby_controller_the_end_of_the_driver_changes_nothing():
    plant = Plant()
    driven(plant)
    plant.role.standby.remove(SIC)
    assert plant.role.end(FASMC).expected
    assert plant.role.end(PID) is None
    assert plant.role.state is PlantState.DRIVEN
    assert plant.gate.owner == FASMC


@pytest.mark.parametrize(
    ("option", "driving", "age", "succeeds"),
    [(0.0, True, 1.0, False), (0.1, True, 0.05, False), (0.1, True, 0.1, True), (0.1, False, 0.1, False)],
)
def test_a_silent_driver_is_replaced_only_if_the_option_and_an_open_gate_permit_it(option, driving, age, succeeds):
    plant = Plant(take_over_after=option)
    driven(plant)
    plant.gate.driving, plant.gate.command_age = driving, age
    succession = plant.role.replace_silent()
    assert (succession is not None) == succeeds
    assert plant.role.state is (PlantState.SWITCHING if succeeds else PlantState.DRIVEN)
    if succeeds:
        assert succession.text == f"{FASMC} has been silent for 0.100 s; {SIC} takes over"
        assert plant.role.replace_silent() is None


def test_a_gate_that_was_disabled_keeps_the_published_driver_until_another_answers():
    plant = Plant()
    driven(plant)
    plant.gate.owner = None
    plant.open_cycle()
    assert plant.role.announced == FASMC
    plant.command(PID)
    first = plant.cycle - 1
    plant.open_cycle()
    assert plant.published[-1] == (first, PID)


# --- a controller's role ---------------------------------------------------------------------------


class Controller:
    """A controller's role; SIC and PID are known controllers, RELAY is a known relay."""

    def __init__(self):
        self.role = ControllerHandover(FASMC, PATIENCE)
        self.first, self.now, self.plant_reads = 0, 100.0, False

        # Commands may arrive before the first announcement; a relay is known only after one.
        for sender in (SIC, PID):
            self.role.take_command(0, 0.0, sender)

    def know_relay(self):
        self.announce(RELAY)
        self.overdue()

    def announce(self, sender, *, driving=True):
        self.first += 10
        self.role.announce(self.first, sender, driving=driving, now=self.now)

    def overdue(self):
        self.now += PATIENCE
        if self.role.is_overdue(self.now):
            self.role.give_up(lambda: self.plant_reads)


def claiming(controller):
    controller.announce("")
    controller.role.answer(controller.now)


def uncontested(controller):
    claiming(controller)
    controller.overdue()


IN_CONTROLLER_STATE = {
    "unannounced": lambda _: None,
    "vacant": lambda controller: controller.announce(""),
    "claiming": claiming,
    "uncontested": uncontested,
    "driving": lambda controller: controller.announce(FASMC),
    "expecting": lambda controller: controller.announce(OTHER),
    "standby": lambda controller: controller.announce(SIC),
    "relayed": lambda controller: controller.announce(RELAY),
}


def command_of_driver(controller):
    driver = controller.role.driver_of(controller.first) or RELAY
    controller.role.take_command(controller.first, 0.0, driver)


def no_announcement(controller):
    controller.plant_reads = True
    controller.overdue()


def no_command(controller):
    if controller.role.state is not ControllerState.CLAIMING:
        controller.overdue()


CONTROLLER_EVENTS = {
    "announced: none drives": lambda controller: controller.announce(""),
    "announced: this controller": lambda controller: controller.announce(FASMC),
    "announced: another, without commands so far": lambda controller: controller.announce("/ehls/new_node-8"),
    "announced: another, whose commands arrive": lambda controller: controller.announce(PID),
    "announced: a known relay": lambda controller: controller.announce(RELAY),
    "it answers a cycle": lambda controller: controller.role.answer(controller.now),
    "no announcement in time": no_announcement,
    "command of the announced driver": command_of_driver,
    "no command in time, the plant does not read this controller's": no_command,
}


def test_the_controllers_table_has_every_state_and_every_event():
    assert list(table("controller")) == list(CONTROLLER_EVENTS)
    assert all(list(row) == list(IN_CONTROLLER_STATE) for row in table("controller").values())
    assert_same_table("controller", ControllerState, ControllerEvent, CONTROLLER_TABLE)


@pytest.mark.parametrize(("event", "state", "next_state"), entries("controller"))
def test_each_entry_of_the_controllers_table_is_true(event, state, next_state):
    controller = Controller()
    if state != "unannounced":
        controller.know_relay()
    IN_CONTROLLER_STATE[state](controller)
    assert controller.role.state.value == state
    CONTROLLER_EVENTS[event](controller)
    assert controller.role.state.value == (state if next_state == SAME else next_state)


@pytest.mark.parametrize("state", IN_CONTROLLER_STATE)
def test_no_cycle_is_answered_while_a_message_is_awaited(state):
    controller = Controller()
    if state != "unannounced":
        controller.know_relay()
    IN_CONTROLLER_STATE[state](controller)
    assert controller.role.may_answer == (state not in {"unannounced", "claiming", "expecting"})
    assert controller.role.follows == (state in {"expecting", "standby", "relayed"})


def test_a_repeated_announcement_changes_the_gates_state_only():
    controller = Controller()
    claiming(controller)
    controller.role.announce(controller.first, "", driving=False, now=controller.now)
    assert controller.role.state is ControllerState.CLAIMING
    assert not controller.role.valve_follows


def test_in_realtime_the_announcement_is_not_awaited():
    role = ControllerHandover(FASMC, 0.0)
    role.announce(0, "", driving=True, now=100.0)
    role.answer(100.0)
    assert role.is_overdue(100.0)
    role.give_up(lambda: False)
    assert role.may_answer


def test_a_driver_is_taken_for_a_relay_only_after_a_while_and_if_the_plant_does_not_read_the_commands():
    controller = Controller()
    controller.announce(OTHER)
    assert not controller.role.is_overdue(controller.now + RELAY_TIME)
    controller.plant_reads = True
    controller.overdue()
    assert controller.role.state is ControllerState.EXPECTING
    controller.plant_reads = False
    controller.overdue()
    assert controller.role.state is ControllerState.RELAYED
    assert controller.role.driver_of(controller.first) == ""
    controller.role.take_command(controller.first, 0.0, OTHER)
    assert controller.role.driver_of(controller.first) == OTHER


def test_each_cycle_has_the_driver_that_was_announced_for_it():
    controller = Controller()
    for sender in ("", SIC, FASMC):
        controller.announce(sender)
    drivers = [controller.role.driver_of(cycle) for cycle in (5, 15, 20, 29, 30)]
    assert drivers == ["", "", SIC, SIC, FASMC]


def test_the_newest_command_of_the_driver_within_the_cycles_is_followed():
    role = ControllerHandover(FASMC, PATIENCE)
    for cycle, spool, sender in ((3, 3e-4, SIC), (5, 5e-4, SIC), (4, 4e-4, SIC), (5, 9e-4, PID), (7, 7e-4, SIC)):
        role.take_command(cycle, spool, sender)
    assert role.command_of(SIC, 3, 6) == 5e-4
    assert role.command_of(SIC, 6, 6) is None
    assert role.has_command(SIC, 7)
    assert not role.has_command(PID, 6)
    role.forget_commands()
    assert role.command_of(SIC, 3, 6) is None


# --- standby controllers ---------------------------------------------------------------------------


@pytest.fixture
def standby():
    made = Standby(patience=10)
    made.cycle = 100
    for sender in (SIC, FASMC):
        made.note(sender, 100)
    return made


@pytest.mark.parametrize("name", ["sic_node", "/ehls/sic_node", SIC])
def test_a_controller_is_found_by_any_of_its_names(standby, name):
    assert standby.named(name) == SIC


@pytest.mark.parametrize("name", ["", "node", "ic_node", "sic", "/other/sic_node", "sic_node-18"])
def test_another_name_is_refused_with_those_that_stand_by(standby, name):
    with pytest.raises(BadInput, match=f"does not stand by.*{FASMC}, {SIC}"):
        standby.named(name)


def test_two_of_one_name_need_the_process(standby):
    standby.note(OTHER, 100)
    with pytest.raises(BadInput, match=f"several controllers.*{FASMC}, {OTHER}"):
        standby.named("fasmc_node")
    assert standby.named(OTHER) == OTHER


def test_one_that_left_or_is_late_stands_by_no_more(standby):
    standby.remove(SIC)
    assert standby.ready == [FASMC]
    standby.cycle = 110
    assert (standby.ready, standby.behind) == ([FASMC], [FASMC])
    standby.cycle = 111
    assert standby.ready == []
