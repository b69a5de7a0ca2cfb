"""The in-process loop and a stepped controller call companions in the same way, each after the previous one."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from ehls_ros.control.companion_chain import CompanionChain
from ehls_ros.control.companions import COMPANIONS
from ehls_ros.control.companions.base import Past, Upcoming
from ehls_ros.control.controller import Controller, Outlook
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.controllers.base import FORCE_ERROR, Model, model_of
from ehls_ros.experiments.loop import CHUNK, ClosedLoop, sampled, simulator_of
from ehls_ros.experiments.spec import Spec, Use, company_of, load_spec
from ehls_ros.physics.kernel_cache import PREFIX
from ehls_ros.physics.rig import SENSED
from ehls_ros.physics.sensors import FORCE

EXPERIMENTS = Path(__file__).parents[2] / "config" / "experiments"
CYCLES = CHUNK + 501


class Made:
    """A companion that applies given changes to rows and model, and records its calls."""

    def __init__(
        self,
        change: Callable[[Upcoming], Any] = lambda upcoming: None,
        model: Callable[[Model], Model] = lambda model: model,
        room: int = CHUNK,
    ) -> None:
        self.change, self.model, self.most = change, model, room
        self.seen: list[Past] = []
        self.calls: list[str] = []

    def prepare(self) -> None:
        self.calls.append("prepare")

    def room(self, first: int, place: np.ndarray) -> int:
        return min(self.most, len(place))

    def ahead(self, upcoming: Upcoming) -> None:
        self.calls.append("ahead")
        self.change(upcoming)

    def done(self, past: Past, model: Model) -> Model:
        self.calls.append("done")
        # The loop reuses the memory.
        self.seen.append(Past(past.first, *(np.array(part) for part in past[1:])))
        return self.model(model)

    def interrupt(self) -> None:
        self.calls.append("interrupt")

    def report(self) -> dict[str, float | str]:
        return {"calls": float(len(self.calls))}


def column(past: list[Past], name: str) -> np.ndarray:
    return np.concatenate([getattr(part, name) for part in past])


def raised(force: float) -> Callable[[Upcoming], None]:
    """Return a function that adds a force [N] to the reference."""

    def change(upcoming: Upcoming) -> None:
        upcoming.rows[:, 0] += force

    return change


def doubled(upcoming: Upcoming) -> None:
    upcoming.rows[:, 0] *= 2.0


@pytest.fixture
def spec() -> Spec:
    law = CONTROLLERS.load("fasmc_predictive")
    found = load_spec(EXPERIMENTS / "sine_fd2.yaml")._replace(controller=Use("fasmc_predictive", law.Parameters()))
    return found._replace(settings=found.settings._replace(duration=(CYCLES - 1) * 1e-3))


def looped(spec: Spec, **members: Any) -> None:
    """Run an experiment in one process beside these companions."""
    loop = ClosedLoop(spec)
    loop.company = CompanionChain(members)
    for _ in loop.blocks():
        pass


def stepped(spec: Spec, **members: Any) -> Controller:
    """Run the experiment cycle by cycle."""
    plant, random = simulator_of(spec), np.random.default_rng(spec.settings.seed)
    wanted, force = sampled(spec.reference, 1e-3), sampled(spec.disturbance.signal, 1e-3)
    model = model_of(spec.controller_rig, 1e-3)
    controller = Controller(spec.controller.name, spec.controller.parameters, model, CompanionChain(members))
    for k in range(spec.cycles):
        measured = plant.measure(random.standard_normal(len(SENSED)))
        command = controller.step(measured, wanted.row(k), np.zeros(2), outlook=Outlook(k, wanted.place(k, 1)[0]))
        plant.advance(command, *force.row(k)[:2], 0.0, 0.0)
    return controller


def test_each_changes_what_the_one_before_it_left(spec):
    first, second = Made(raised(100.0)), Made(doubled)
    looped(spec, first=first, second=second)
    rows, wanted = column(first.seen, "rows"), column(first.seen, "wanted")
    assert np.array_equal(rows[:, 0], 2.0 * (wanted[:, 0] + 100.0))
    assert np.isnan(rows[:, 3:]).all()
    assert np.array_equal(wanted, sampled(spec.reference, 1e-3).rows(0, CYCLES))


def test_no_more_cycles_run_than_the_narrowest_has_room_for_and_none_is_left_out(spec):
    wide, narrow = Made(), Made(room=700)
    looped(spec, wide=wide, narrow=narrow)
    for member in (wide, narrow):
        assert max(len(past.rows) for past in member.seen) == 700
        assert [past.first for past in member.seen] == [0, 700, 1400, 2100]
        assert sum(len(past.rows) for past in member.seen) == CYCLES
        assert member.calls == ["ahead", "done"] * 4


def test_the_loop_in_one_process_and_a_controller_that_is_stepped_come_to_the_same(spec):
    blocks, cycles = Made(raised(50.0)), Made(raised(50.0))
    looped(spec, made=blocks)
    stepped(spec, made=cycles)
    assert len(cycles.seen) == CYCLES > len(blocks.seen)
    for name in ("rows", "wanted", "place"):
        assert np.array_equal(column(blocks.seen, name), column(cycles.seen, name), equal_nan=True)
    for name in ("measured", "command", "status"):
        one, other = column(blocks.seen, name), column(cycles.seen, name)
        assert np.max(np.abs(one - other)) <= 1e-9 * np.max(np.abs(one))


def test_the_force_error_is_that_to_the_reference_wanted(spec):
    made = Made(raised(500.0))
    looped(spec, made=made)
    error = column(made.seen, "measured")[:, FORCE] - column(made.seen, "wanted")[:, 0]
    assert column(made.seen, "status")[:, FORCE_ERROR] == pytest.approx(error, abs=1e-8)
    # The reference followed is 500 N larger.
    assert np.mean(error[CYCLES // 2 :]) == pytest.approx(500.0, abs=20.0)


def test_the_model_it_returns_is_the_laws_from_the_next_cycle_on(spec):
    made = Made(model=lambda model: model._replace(spool_limit=1e-5), room=600)
    looped(spec, made=made)
    first, second = (np.abs(past.command) for past in made.seen[:2])
    assert first.max() > 1e-5 >= second.max()
    stepped_on = stepped(spec._replace(settings=spec.settings._replace(duration=0.1)), made=made)
    assert stepped_on.model.spool_limit == 1e-5


def test_a_controller_that_forgets_tells_its_companions_and_reports_each_by_name(spec):
    made, other = Made(), Made()
    controller = stepped(spec._replace(settings=spec.settings._replace(duration=0.01)), made=made, other=other)
    made.calls.clear()
    controller.reset()
    assert made.calls == ["interrupt"]
    assert controller.companions.report().keys() == {"made.calls", "other.calls"}
    assert controller.companions.report()["made.calls"] == 1.0


def kernels() -> dict[str, list[Any]]:
    """Return the signatures for which each generated kernel has been compiled or loaded."""
    modules = [module for name, module in sys.modules.items() if name.startswith(PREFIX)]
    found = ((f"{module.__name__}.{name}", entry) for module in modules for name, entry in vars(module).items())
    return {name: list(entry.signatures) for name, entry in found if isinstance(entry, Dispatcher)}


@pytest.mark.parametrize("name", COMPANIONS.names())
def test_no_cycle_waits_for_a_kernel_and_preparing_changes_nothing(name, monkeypatch):
    for module in [module for module in sys.modules if module.startswith(PREFIX)]:
        # Other tests may have needed the same kernels.
        monkeypatch.delitem(sys.modules, module)
    spec = load_spec(EXPERIMENTS / "measured_sine_fd2_preview.yaml")
    spec = spec._replace(companions=(Use(name, COMPANIONS.load(name).Parameters()),))
    model, wanted, motion = (
        model_of(spec.controller_rig, 1e-3),
        sampled(spec.reference, 1e-3),
        sampled(spec.disturbance.signal, 1e-3),
    )
    one, other = (
        Controller(spec.controller.name, spec.controller.parameters, model, company_of(spec, model, "test")) for _ in range(2)
    )
    ready = kernels()
    random, usual = np.random.default_rng(0), np.array([0.0, 0.0, 4e6, 0.0, 1e4, 7e6, 313.0])
    for k in range(30):
        seen = usual + 1e-4 * random.standard_normal(len(SENSED)), wanted.row(k), np.zeros(2)
        outlook = Outlook(k, None, motion.row(k))
        other.companions.prepare()
        # Cycles may be missed, too.
        elapsed = 1 + k % 3 // 2
        assert one.step(*seen, elapsed, outlook) == other.step(*seen, elapsed, outlook)
    assert kernels() == ready
    assert one.companions.report() == other.companions.report()


def test_the_loop_and_a_controller_prepare_their_companions(spec, monkeypatch):
    made = Made()
    controller = stepped(spec._replace(settings=spec.settings._replace(duration=2e-3)), made=made)
    assert controller.companions.members["made"].calls.count("prepare") == 1
    assert made.calls.index("prepare") < made.calls.index("ahead")
    looping = Made()
    monkeypatch.setattr("ehls_ros.experiments.loop.company_of", lambda *_: CompanionChain({"made": looping}))
    ClosedLoop(spec)
    assert looping.calls == ["prepare"]


def test_no_company_is_as_good_as_one_that_does_nothing(spec):
    short = spec._replace(settings=spec.settings._replace(duration=0.3))
    made = Made()
    looped(short, made=made)
    loop = ClosedLoop(short)
    assert not loop.company
    record = np.concatenate([block.record[:, loop.columns.command].copy() for block in loop.blocks()])
    assert np.array_equal(record, column(made.seen, "command"))
