"""Null pacing: a programme that waits for its peaks, or slows down for them, on a rig that falls short of them."""

import json
import math
from typing import NamedTuple

import numpy as np
import pytest

from ehls_ros.control.programme.counting import Counter, LoadCycle, Sample
from ehls_ros.control.programme.declaration import Parameters
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.control.programme.motion import Motion, Runner, State
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
            {**motion._asdict(), "legs": [leg._asdict() for leg in motion.legs], "skipped": [s._asdict() for s in motion.skipped]}
            for motion in self.runner.motions
        ]
        self.saved = Saved(json.dumps(motions), end, counting)
        self.remember(self.next, end)
        self.next = end

    def step(self, poll=5):
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


def test_x():
    for pacing in (None, STATIC, DYNAMIC):
        whole = programme(RAMP, CYCLES, pacing=pacing)
        run = Station(whole).run(60.0)
        print(pacing, len(run.log), shortfall(run.log), shortfall(run.log, 15), shortfall(run.log,5), len(run.rows) * PERIOD, run.reason, is_smooth(run), np.abs(run.rows[:,2]).max(), set(run.states.tolist()))
        print([round(4e3-c.peak,1) for c in run.log])
        print([c.samples for c in run.log])
    assert 0
