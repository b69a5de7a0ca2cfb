"""Null pacing: a programme that waits for its peaks, or slows down for them, on a rig that falls short of them."""

import itertools
import json
import math
from typing import NamedTuple

import numpy as np
import pytest
from tiers import tiered

from ehls_ros.control.programme.counting import Counter, LoadCycle, Sample
from ehls_ros.control.programme.declaration import Parameters
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.control.programme.motion import Motion, Runner, State, point_signals
from ehls_ros.control.programme.motion_check import check_motions
from ehls_ros.control.programme.pacing import Pacer
from ehls_ros.errors import BadInput
from ehls_ros.schema import fitted, parse

PERIOD = 1e-3
LEAD, MIN_LEAD = 200, 20
CYCLES = {"block": "cycles", "mean": 3e3, "amplitude": 1e3, "frequency": 4.0, "count": 30}
RAMP = {"block": "ramp", "to": 2e3, "time": 0.5}
STATIC = {"mode": "static", "tolerance": 20.0, "timeout": 2.0}
DYNAMIC = {"mode": "dynamic", "tolerance": 20.0, "timeout": 2.0}
LAG = 0.02
"""Time constant of the rig: at 4 Hz, its amplitude is 1 / sqrt(1 + (2 pi 4 0.02)^2) = 0.893 of the reference's."""


def programme(*blocks, pacing=None, **settings):
    return Programme(parse(Parameters, {"blocks": blocks, "pacing": pacing, "stop_time": 0.1, **settings}, "test"), "test")


class Run(NamedTuple):
    """References with two derivatives, points and states by control cycle; measured values; log; reason of a stop."""

    rows: np.ndarray
    load_cycles: np.ndarray
    states: np.ndarray
    measured: np.ndarray
    log: list[LoadCycle]
    reason: str
    motions: list[Motion]


class Saved(NamedTuple):
    """What the node stores before it publishes."""

    motions: str
    published: int
    counting: int


class Station:
    """The node without its topics, in closed loop with a rig of first order; it may be killed at any control cycle."""

    def __init__(self, whole, *, lag=LAG, gain=1.0, lead=LEAD, start=0.0):
        self.whole, self.lag, self.gain, self.lead = whole, lag, gain, lead
        self.rows, self.points, self.states, self.measured, self.log = [], [], [], [], []
        self.value, self.reason = start, ""
        self.begin(Runner(whole, PERIOD, (Runner.beginning(whole, 0),)), 0, 0)

    def begin(self, runner, published, counting):
        self.runner, self.next, self.pacer = runner, published, Pacer(self.whole, PERIOD)
        self.counter, self.seen = Counter(self.whole, len(self.log)), counting
        self.made = {}
        self.remember(counting, published)

    def remember(self, first, end):
        rows = self.runner.rows(first, end - first)
        for i, cycle in enumerate(range(first, end)):
            point = (*(int(column[i]) for column in rows.points[:3]), float(rows.points.phase[i]), int(rows.state[i]))
            self.made[cycle] = tuple(rows.reference[i].tolist()), point

    def kill(self):
        """Start again from what is stored, as JSON."""
        motions = fitted(tuple[Motion, ...], json.loads(self.saved.motions))
        check_motions(motions, self.whole, PERIOD, (), -1e5, 1e5)
        self.begin(Runner(self.whole, PERIOD, motions), self.saved.published, self.saved.counting)

    def count(self, end):
        for cycle in range(self.seen, end):
            row, point = self.made.pop(cycle)
            sample = Sample(cycle, *point, row[0], self.measured[cycle], 0.0)
            finished = self.counter.add(sample)
            self.pacer.add(sample, finished)
            self.log += finished
        self.seen = end

    def publish(self, cycle):
        if complaint := self.pacer.follow(self.runner, self.next):
            self.reason = complaint
            assert self.runner.stop(self.next, complaint)
        end = max(self.runner.horizon(cycle, self.lead, MIN_LEAD) + 1, self.next)
        counting = self.seen if self.counter.since is None else self.counter.since
        self.runner.forget(min(counting, self.next))
        motions = [
            {
                **motion._asdict(),
                "legs": [leg._asdict() for leg in motion.legs],
                "skipped": [s._asdict() for s in motion.skipped],
            }
            for motion in self.runner.motions
        ]
        self.saved = Saved(json.dumps(motions), end, counting)
        self.remember(self.next, end)
        self.next = end

    def step(self, poll=10):
        cycle = len(self.measured)
        if cycle % poll == 0:
            self.count(cycle)
            self.publish(cycle)
        row, point = self.made[cycle]
        self.value += (self.gain * row[0] - self.value) * PERIOD / self.lag if self.lag else self.gain * row[0] - self.value
        self.rows.append(row)
        self.points.append(point[2])
        self.states.append(point[4])
        self.measured.append(self.value)

    def run(self, longest, until=lambda station: station.states[-1] in {State.FINISHED, State.STOPPED}):
        for _ in range(round(longest / PERIOD)):
            self.step()
            if until(self):
                break
        for _ in range(10):
            self.step()
        return self.outcome()

    def outcome(self):
        self.count(len(self.measured))
        return Run(
            *map(np.array, (self.rows, self.points, self.states, self.measured)), self.log, self.reason, self.runner.motions
        )


def shortfall(log, first=1):
    """Return the largest shortfall of the peaks and valleys from the programme's 4 and 2 kN, from a load cycle on."""
    return max(max(4e3 - cycle.peak, cycle.valley - 2e3) for cycle in log if cycle.load_cycle >= first)


def is_smooth(run):
    """Return whether value and rate are the integrals of their derivatives, and how far the second derivative jumps."""
    value, rate, bend = run.rows.T
    largest = np.abs(bend).max()
    assert np.abs(np.diff(value) - 0.5 * PERIOD * (rate[1:] + rate[:-1])).max() < PERIOD**2 * largest
    assert np.abs(np.diff(rate) - 0.5 * PERIOD * (bend[1:] + bend[:-1])).max() < 0.6 * PERIOD * largest
    return np.abs(np.diff(bend)).max() / largest


AMPLITUDE = 1e3
TURN = 2.0 * math.pi * CYCLES["frequency"] * PERIOD
GAIN = (PERIOD / LAG) / abs(complex(math.cos(TURN), math.sin(TURN)) - 1.0 + PERIOD / LAG)
"""Amplitude ratio at 4 Hz of the rig's recursion, by its transfer function."""


def test_peaks_that_fall_short_are_reached_with_pacing_and_each_load_cycle_is_counted_once():
    """Without pacing the peaks miss by 10 % of the amplitude; with it, they are within the 2 % of the tolerance."""
    runs = {}
    for name, pacing in (("none", None), ("static", STATIC), ("dynamic", DYNAMIC)):
        runs[name] = run = Station(programme(RAMP, {**CYCLES, "count": 12}, pacing=pacing)).run(30.0)
        assert [cycle.load_cycle for cycle in run.log] == list(range(1, 13)), name
        assert run.states[-1] == State.FINISHED
    assert shortfall(runs["none"].log, 2) == pytest.approx((1.0 - GAIN) * AMPLITUDE, abs=1.0)
    assert shortfall(runs["static"].log) < 5.0
    # Dynamic pacing misses the peaks that are published before the first is measured, and while the speed falls.
    missed = [cycle.load_cycle for cycle in runs["dynamic"].log if shortfall([cycle]) > 20.0]
    assert missed == [1, 2, 3]
    lengths = {name: run.log[-2].samples for name, run in runs.items()}
    assert lengths == pytest.approx({"none": 250, "static": 400, "dynamic": 653}, rel=0.02)
    # A wait belongs to its load cycle, in which each control cycle is counted.
    for run in runs.values():
        spans = [(cycle.first, cycle.last) for cycle in run.log]
        assert all(after[0] == before[1] + 1 for before, after in itertools.pairwise(spans))
        assert all(cycle.samples == cycle.last - cycle.first + 1 for cycle in run.log)


def test_the_reference_stays_smooth_where_pacing_changes_its_speed():
    unpaced, static, dynamic = (
        Station(programme(RAMP, {**CYCLES, "count": 6}, pacing=pacing)).run(30.0) for pacing in (None, STATIC, DYNAMIC)
    )
    # Unpaced, the second derivative jumps where load cycles begin and end; with waits there, it does not.
    assert is_smooth(unpaced) > 0.9
    assert is_smooth(static) < 0.15
    largest = np.abs(unpaced.rows[:, 2]).max()
    assert np.abs(static.rows[:, 2]).max() < 1.15 * largest
    waiting = static.rows[static.states == State.WAITING]
    assert np.ptp(waiting[:, 1:]) == 0.0
    assert set(np.round(waiting[:, 0], 3)) == {0.0, 2e3, 4e3}
    is_smooth(dynamic)
    later = dynamic.rows[(dynamic.load_cycles > 0) & (dynamic.load_cycles < 5), 2]
    assert np.abs(later).max() <= 1.01 * largest
    assert np.abs(np.diff(later)).max() < 0.05 * largest


def test_a_wait_costs_the_lead_on_a_rig_without_lag():
    run = Station(programme({**CYCLES, "mean": 1e3, "count": 5}, pacing=STATIC), lag=0.0).run(10.0)
    spent = {cycle.samples for cycle in run.log[1:-1]}
    # A load cycle of 250 control cycles, two times 25 for easing, and two waits: the lead, and what passes between two polls.
    assert min(spent) >= 250 + 2 * 25 + 2 * MIN_LEAD
    assert max(spent) <= 250 + 2 * 25 + 2 * (MIN_LEAD + 20)


@pytest.mark.parametrize("pacing", [STATIC, DYNAMIC], ids=["static", "dynamic"])
def test_a_killed_node_goes_on_bitwise(pacing):
    whole = programme(RAMP, {**CYCLES, "count": 6}, pacing=pacing)
    undisturbed = Station(whole)
    for _ in range(3000):
        undisturbed.step()
    killed = Station(whole)
    for k in range(3000):
        if k % 53 == 3:
            killed.kill()
        killed.step()
    assert undisturbed.rows == killed.rows
    assert undisturbed.states == killed.states
    assert undisturbed.log == killed.log
    assert len(killed.log) > 3


@pytest.mark.parametrize("pacing", [STATIC, DYNAMIC], ids=["static", "dynamic"])
@pytest.mark.parametrize("after", tiered([3, 130, 200], 130))
def test_a_paced_programme_stops_resumes_and_skips(pacing, after):
    whole = programme(RAMP, {**CYCLES, "count": 12}, {**CYCLES, "count": 4}, pacing=pacing, hold_time=0.1)
    station = Station(whole)
    requests = {
        1500: lambda: station.runner.stop(station.next, "test"),
        1500 + after: lambda: station.runner.resume(station.next),
        2400: lambda: station.runner.skip(station.next),
        2400 + after: lambda: station.runner.stop(station.next, "test"),
        3500: lambda: station.runner.resume(station.next),
    }
    for k in range(12_000):
        if k in requests:
            assert requests[k](), k
        station.step()
        if station.states[-1] == State.FINISHED:
            break
    run = station.outcome()
    is_smooth(run)
    assert not run.reason
    assert run.states[-1] == State.FINISHED
    assert (np.diff(run.load_cycles) >= 0).all()
    numbers = [cycle.load_cycle for cycle in run.log]
    assert numbers == list(range(1, len(numbers) + 1))
    assert [cycle.cycle for cycle in run.log if cycle.block == 2] == [1, 2, 3, 4]
    assert 4 < len(numbers) < 12
    if pacing is STATIC:
        # Where it stopped, it waits again before it goes on.
        assert shortfall([cycle for cycle in run.log if cycle.first > 4200]) < 20.0


@pytest.mark.parametrize("frequency", [0.5, 4.0, 20.0])
def test_a_stop_at_any_time_of_easing_stays_within_the_programmes_acceleration(frequency):
    whole = programme({**CYCLES, "mean": 1e3, "frequency": frequency}, pacing=STATIC, stop_time=0.5)
    largest = AMPLITUDE * (2.0 * math.pi * frequency) ** 2
    eased = Runner(whole, PERIOD, (Runner.beginning(whole, 0),))
    eased.run_to_reversal(1)
    for cycle in np.linspace(2, eased.arrival(), 40).astype(int).tolist():
        runner = Runner(whole, PERIOD, tuple(eased.motions))
        assert runner.stop(cycle, "test")
        check_motions(tuple(runner.motions), whole, PERIOD, (), -1e5, 1e5)
        rows = runner.rows(0, cycle + 1000).reference
        assert np.abs(np.diff(rows[:, 1]) - 0.5 * PERIOD * (rows[1:, 2] + rows[:-1, 2])).max() < 0.6 * PERIOD * largest
        assert np.abs(rows[:, 2]).max() < 1.5 * largest, cycle
        assert not rows[-1, 1:].any()


def test_a_stop_during_a_wait_holds_there_and_the_same_wait_goes_on_after_it():
    station = Station(programme(RAMP, CYCLES, pacing=STATIC))
    while not (station.states and station.states[-1] == State.WAITING and station.rows[-1][0] > 3.9e3):
        station.step()
    begun = len(station.rows)
    assert station.runner.stop(station.next, "test")
    for _ in range(500):
        station.step()
    assert station.runner.resume(station.next)
    for _ in range(50):
        station.step()
    rows = np.array(station.rows[begun:])
    assert np.ptp(rows[:540, 0]) == 0.0
    assert State.STOPPED in station.states[begun:]
    assert not rows[:540, 1:].any()


def test_a_static_wait_that_lasts_too_long_stops_the_programme_and_says_how_much_is_missing():
    whole = programme(RAMP, CYCLES, pacing={**STATIC, "tolerance": 150.0})
    run = Station(whole, gain=0.95).run(10.0)
    assert run.reason.startswith("the peak 4000 is not reached within 2 s: 200 short (cycles 1, load cycle 1); raise tolerance")
    assert run.states[-1] == State.STOPPED
    waited = np.count_nonzero((run.states == State.WAITING) & (run.rows[:, 0] > 3.9e3))
    assert 2000 < waited < 2000 + 2 * MIN_LEAD
    missing = Station(whole, gain=math.nan).run(10.0)
    assert "the value 0 is not reached within 2 s: the measured value is missing (ramp 0)" in missing.reason
    assert missing.log == []


def test_a_long_wait_is_said_while_it_lasts():
    station = Station(programme(RAMP, pacing=STATIC), gain=0.9)
    for _ in range(1500):
        station.step()
    assert station.pacer.remark == ""
    while len(station.rows) < 2500:
        station.step()
    assert station.pacer.remark == "waits for the peak 2000 (ramp 0): 200 short"
    station.gain = 1.0
    for _ in range(200):
        station.step()
    assert station.pacer.remark == ""


def test_peaks_that_are_missed_at_the_slowest_speed_stop_the_programme():
    station = Station(programme({**CYCLES, "mean": 1e3}, pacing={**DYNAMIC, "slowest": 0.5}), gain=0.95)
    run = station.run(20.0)
    # 5 % of 2 kN are missing at any speed.
    assert "the peak 2000 is not reached within 2 s at 50 % of the speed: 1" in run.reason
    assert run.reason.endswith("or lower slowest")
    assert run.motions[-1].speed == 0.5
    slowest = np.count_nonzero(run.states == State.RUNNING)
    assert 2500 < slowest < 5000


def test_the_speed_rises_again_and_one_missed_peak_at_the_slowest_speed_is_no_reason_to_stop():
    station = Station(programme({**CYCLES, "mean": 1e3, "count": 200}, pacing={**DYNAMIC, "slowest": 0.4, "tolerance": 26.0}))
    for k in range(9000):
        # Two load cycles fall short, with more than the timeout in tolerance between them.
        station.gain = 0.99 if k in range(3000, 3600) or k in range(8000, 8600) else 1.0
        station.step()
    assert station.reason == ""
    assert station.runner.motions[-1].speed == 0.4
    assert "runs at 40 % of its speed" in station.pacer.remark
    station.lag = 2e-3
    for _ in range(12_000):
        station.step()
        if station.runner.motions[-1].speed == 1.0:
            break
    assert station.runner.motions[-1].reason == ""
    assert station.runner.arrival() < 24_000


BLOCKS_OF_ALL_KINDS = (
    RAMP,
    {"block": "dwell", "time": 0.3},
    {**CYCLES, "count": 2},
    {**CYCLES, "waveform": "haversine", "count": 2, "shape": {"pulse": 0.6}},
    {**CYCLES, "waveform": "triangle", "count": 2},
    {"block": "ramp", "to": 500.0, "rate": 4e3},
    {"block": "spectrum", "points": [[0.0, 10.0], [0.5, 900.0], [1.1, -200.0]], "count": 2},
    {"block": "signal", "reference": {"name": "chirp", "amplitude": 100.0, "sweep": 1.0}, "time": 1.5},
)


def test_waits_are_where_the_value_turns_back_or_comes_to_rest():
    whole = programme(*BLOCKS_OF_ALL_KINDS, pacing=STATIC)
    found, after = [], 0.0
    while (time := whole.reversal(after)) is not None:
        found.append(time)
        after = time + 1e-6
    t = np.arange(0.0, whole.duration, 1e-4)
    value = whole.sample(t)[:, 0]
    # Between two waits it rises or falls, but for reversals within the tolerance.
    for begin, end in zip([0.0, *found], found, strict=False):
        within = value[(t >= begin) & (t <= end)]
        back = min(np.max(np.maximum.accumulate(within) - within), np.max(within - np.minimum.accumulate(within)))
        assert back <= STATIC["tolerance"] + 0.1, (begin, end)
    waits = whole.sample(np.array(found))[:, 0]
    assert np.abs(np.diff(waits)).min() > STATIC["tolerance"]
    # The ramp, and after the dwell the peaks and valleys of the two sines.
    assert found[:5] == pytest.approx([0.5, 0.925, 1.05, 1.175, 1.3], abs=1e-5)


def test_a_block_may_have_its_own_pacing():
    blocks = (
        {**RAMP, "pacing": {"mode": "none"}},
        {**CYCLES, "count": 3},
        {**CYCLES, "count": 12, "pacing": {"mode": "dynamic"}},
        {**CYCLES, "count": 2, "pacing": {"mode": "none"}},
        {**CYCLES, "count": 2, "pacing": {"tolerance": 50.0}},
    )
    whole = programme(*blocks, pacing=STATIC)
    assert [leaf.pacing.mode for leaf in whole.leaves] == ["none", "static", "dynamic", "none", "static"]
    assert whole.leaves[4].pacing == whole.leaves[1].pacing._replace(tolerance=50.0)
    run = Station(whole).run(40.0)
    is_smooth(run)
    assert not run.reason
    assert [cycle.load_cycle for cycle in run.log] == list(range(1, 20))
    short = {block: [shortfall([cycle]) for cycle in run.log if cycle.block == block] for block in range(1, 5)}
    assert max(short[1]) < 20.0
    assert max(short[2][6:]) < 20.0
    assert min(short[3]) > 20.0
    assert max(short[1]) < max(short[4]) < 50.0


@pytest.mark.parametrize("before", tiered([None, STATIC, DYNAMIC], STATIC), ids=["none", "static", "dynamic"])
@pytest.mark.parametrize("then", [None, STATIC, DYNAMIC], ids=["none", "static", "dynamic"])
def test_pacing_may_change_between_two_starts(before, then):
    blocks = RAMP, {**CYCLES, "count": 16}
    station = Station(programme(*blocks, pacing=before))
    while len(station.rows) < 2500:
        station.step()
    station.whole = programme(*blocks, pacing=then)
    station.kill()
    run = station.run(40.0)
    is_smooth(run)
    assert not run.reason
    assert run.states[-1] == State.FINISHED
    assert [cycle.load_cycle for cycle in run.log] == list(range(1, 17))
    if then is not None:
        assert shortfall(run.log[:-1], 13) < 20.0
    else:
        assert run.motions[-1].speed == 1.0


def test_a_run_without_measurements_ignores_pacing():
    blocks = RAMP, {**CYCLES, "count": 2}
    time = np.arange(0.0, 2.0, PERIOD)
    paced, unpaced = (
        point_signals(parse(Parameters, {"blocks": blocks, "pacing": pacing}, "test"), time, PERIOD)
        for pacing in (STATIC, None)
    )
    for name, signal in unpaced.items():
        assert np.array_equal(paced[name], signal, equal_nan=True), name
    assert unpaced["programme_state"][-1] == State.FINISHED


@pytest.mark.parametrize(
    ("pacing", "said"),
    [
        ({"mode": "static"}, "test: pacing: key 'tolerance' is missing"),
        ({"mode": "statik", "tolerance": 1.0}, "did you mean 'static'"),
        ({"mode": "static", "tolerance": 0.0}, "tolerance is 0.0"),
        ({"slowest": 2.0}, "slowest is 2.0"),
        ({"tolerence": 1.0}, "'tolerence' is unknown"),
    ],
)
def test_a_wrong_pacing_is_refused_with_its_place(pacing, said):
    with pytest.raises(BadInput) as caught:
        programme(RAMP, pacing=pacing)
    assert said in str(caught.value)
    with pytest.raises(BadInput) as caught:
        programme({**RAMP, "pacing": pacing})
    assert said.replace("test: ", "test: blocks[0]: ") in str(caught.value)
