"""Test programmes: expansion without unrolling, continuity, positions, stop and resume, counting and limits."""

import itertools
import math
import tracemalloc

import numpy as np
import pytest

from ehls_ros.control.programme.blocks import BLOCKS
from ehls_ros.control.programme.counting import Counter, Sample
from ehls_ros.control.programme.declaration import Parameters
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.control.programme.motion import Runner, State
from ehls_ros.control.references import REFERENCES, ramp
from ehls_ros.errors import BadInput
from ehls_ros.schema import parse

PERIOD = 1e-3
CYCLES = {"block": "cycles", "mean": 1e3, "amplitude": 500.0, "frequency": 10.0, "count": 7}
OTHER = {"block": "cycles", "waveform": "haversine", "mean": 2e3, "amplitude": 300.0, "frequency": 5.0, "count": 3}
NOISE = {"block": "random", "rms": 100.0, "lowest_frequency": 1.0, "highest_frequency": 4.0, "mean": 500.0, "period": 2.0}
RECORDED = {"block": "spectrum", "points": [[0.0, 10.0], [0.5, 900.0], [1.1, -200.0]], "count": 2}
CHIRP = {"block": "signal", "reference": {"name": "chirp", "amplitude": 100.0, "sweep": 1.0}, "time": 1.5}
NESTED = [
    {"block": "ramp", "to": 400.0, "rate": 2e3},
    {"repeat": 3, "blocks": [CYCLES, {"block": "dwell", "time": 0.25}, {"repeat": 2, "blocks": [OTHER, NOISE]}, RECORDED]},
    CHIRP,
]


def programme(blocks, **settings):
    return Programme(parse(Parameters, {"blocks": blocks, **settings}, "test"), "test")


def unrolled(entries, value, transition):
    """Yield the blocks and ramps in sequence, as a naive unrolling would: start value, kind, parameters."""
    for entry in entries:
        if "repeat" in entry:
            for _ in range(entry["repeat"]):
                value = yield from unrolled(entry["blocks"], value, transition)
            continue
        member = BLOCKS.load(entry["block"])
        p = parse(member.Parameters, {key: own for key, own in entry.items() if key not in {"block", "name", "limits"}}, "test")
        course = member.course(p, value)
        if course.begin != value:
            yield transition, 0, lambda t, a=value, b=course.begin: ramp.sample(t, ramp.Parameters(a, b, transition))
        yield course.duration, course.count, lambda t, m=member, p=p, v=course.begin: m.sample(t, p, v)
        value = course.end
    return value


def test_nested_repeats_are_what_unrolling_gives():
    whole = programme(NESTED)
    parts = list(unrolled(NESTED, 0.0, whole.parameters.transition))
    ends = np.cumsum([duration for duration, _, _ in parts])
    assert whole.duration == pytest.approx(ends[-1], rel=1e-12)
    assert whole.load_cycles == sum(count for _, count, _ in parts) == 3 * (7 + 2 * (3 + 1) + 2)
    for begin, end, (_, _, sample) in zip([0.0, *ends[:-1]], ends, parts, strict=True):
        t = np.linspace(begin + 1e-6, end - 1e-6, 23)
        assert np.allclose(whole.sample(t), sample(t - begin), rtol=1e-9, atol=1e-4)


def test_value_and_rate_have_no_step_anywhere():
    whole = programme(NESTED)
    t = np.arange(-0.1, whole.duration + 0.1, 1e-4)
    value, rate, bend = whole.sample(t).T
    assert np.abs(np.diff(value)).max() <= 1.01e-4 * np.abs(rate).max()
    assert np.abs(np.diff(rate)).max() <= 1.01e-4 * np.abs(bend).max()
    assert value[-1] == whole.end


def test_ten_million_load_cycles_take_no_memory_and_each_is_counted_once():
    tracemalloc.start()
    whole = programme([{"repeat": 1000, "blocks": [{**CYCLES, "count": 10_000}, {**OTHER, "count": 10}]}])
    rng = np.random.default_rng(1)
    t = np.sort(rng.uniform(0.0, whole.duration, 2000))
    points = whole.points(t)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 5e6
    assert whole.load_cycles == 10_010_000
    # The count rises by one at the end of each load cycle, also where passes join after ten million.
    assert (np.diff(points.load_cycles) >= 0).all()
    for boundary in (whole.spot(t[700]), whole.spot(t[-1])):
        course = boundary.segment.course
        ends = boundary.since + course.cycle * np.arange(1, min(course.count, 50) + 1)
        before, after = whole.points(ends - 1e-3), whole.points(ends + 1e-3)
        assert (after.load_cycles - before.load_cycles == 1).all()
        assert (whole.points(ends).load_cycles == after.load_cycles).all()


@pytest.mark.parametrize("name", ["sine", "triangle", "haversine"])
def test_load_cycles_go_from_valley_to_valley_at_rest(name):
    whole = programme([{**CYCLES, "waveform": name}], start=500.0)
    rows = whole.sample(np.linspace(0.0, whole.duration, 7001))
    begin = whole.duration - 0.7
    valleys, peaks = whole.sample(begin + 0.1 * np.arange(8)), whole.sample(begin + 0.05 + 0.1 * np.arange(7))
    assert np.allclose(valleys[:, 1], 0.0, atol=1e-6)
    assert np.allclose(valleys[:, 0], rows[:, 0].min() if name == "sine" else valleys[0, 0])
    assert np.allclose(peaks[:, 0], rows[:, 0].max())
    assert np.ptp(valleys[:, 0]) < 1e-9
    assert 0.5 * (valleys[0, 0] + peaks[0, 0]) == pytest.approx(1e3)


def test_the_place_is_block_and_load_cycles_with_their_fraction():
    member = REFERENCES.load("programme")
    p = parse(member.Parameters, {"blocks": [{"block": "dwell", "time": 1.0}, CYCLES], "start": 500.0}, "test")
    place = member.place(np.array([0.5, 1.0, 1.25, 1.7, 9.0]), p)
    assert np.allclose(place, [[0, np.nan], [1, 0.0], [1, 2.5], [1, np.nan], [1, np.nan]], equal_nan=True)
    sine = REFERENCES.load("sine")
    assert np.allclose(sine.place(np.array([0.25]), sine.Parameters(frequency=3.0)), [[0.0, 0.75]])


def runner_of(whole, first=0):
    return Runner(whole, PERIOD, (Runner.beginning(whole, first),))


def test_an_undisturbed_run_is_the_reference_bit_for_bit():
    whole = programme(NESTED)
    cycles = np.arange(9000)
    rows = runner_of(whole).rows(0, 9000)
    assert np.array_equal(rows.reference, whole.sample(cycles * PERIOD))
    assert set(rows.state.tolist()) == {State.RUNNING}


def test_stop_and_resume_lose_nothing_and_are_smooth_at_any_moment():
    whole = programme([CYCLES, OTHER], start=500.0, hold=100.0, stop_time=0.05, hold_time=0.1)
    plain = whole.sample(np.arange(0.0, whole.duration, PERIOD))
    for stop, resume in itertools.product((250, 333), (10, 60, 400)):
        runner = runner_of(whole)
        assert runner.stop(stop, "asked for")
        assert not runner.stop(stop + 1, "again")
        assert runner.resume(stop + resume)
        # Also while it resumes.
        assert runner.stop(stop + resume + 30, "asked for")
        assert runner.resume(stop + resume + 330)
        rows = runner.rows(0, 3000)
        value, rate, bend = rows.reference.T
        assert np.abs(np.diff(value) - 0.5 * PERIOD * (rate[1:] + rate[:-1])).max() < 0.3
        assert np.abs(np.diff(rate)).max() <= 1.2 * PERIOD * np.abs(bend).max()
        assert value.min() >= min(100.0, plain[:, 0].min()) - 20.0
        assert value.max() <= plain[:, 0].max() + 1e-6
        on_path = rows.points.load_cycles[~np.isnan(rows.points.phase)]
        assert (np.diff(on_path) >= 0).all()
        assert sorted(set(on_path.tolist())) == list(range(10))
        assert rows.points.load_cycles[-1] == 10
        assert rows.state[-1] == State.FINISHED
        # It continues where it stopped.
        assert runner.at(stop + resume + 320)[1] == State.STOPPED


def test_skipped_load_cycles_are_not_counted():
    whole = programme([CYCLES, OTHER], start=500.0, stop_time=0.05, hold_time=0.1)
    runner = runner_of(whole)
    assert runner.skip(250)
    rows = runner.rows(0, 3000)
    assert rows.points.load_cycles[-1] == 2 + 3
    assert rows.points.block[-1] == 1
    assert (np.diff(rows.points.load_cycles) >= 0).all()


@pytest.mark.parametrize("first", [("skip", "skip"), ("skip", "stop"), ("stop", "skip"), ("skip", "stop", "resume", "skip")])
@pytest.mark.parametrize("apart", [1, 30, 90])
def test_what_is_left_while_a_block_is_being_left_is_left_once(first, apart):
    """Requests that follow each other before the programme has come to rest."""
    whole = programme([CYCLES, OTHER, {**CYCLES, "count": 5}], start=500.0, stop_time=0.05, hold_time=0.1)
    runner, cycle, counts = runner_of(whole), 250, []
    counts.append(runner.rows(0, cycle).points.load_cycles)
    for request in (*first, "resume"):
        runner.stop(cycle, "test") if request == "stop" else getattr(runner, request)(cycle)
        counts.append(runner.rows(cycle, apart).points.load_cycles)
        cycle += apart
    counts.append(runner.rows(cycle, 4000).points.load_cycles)
    found = np.concatenate(counts)
    assert (np.diff(found) >= 0).all()
    # Of the first block two load cycles are complete; each request to skip leaves one block.
    assert found[-1] == {1: 2 + 3 + 5, 2: 2 + 5}[first.count("skip")]


def counted(whole, runner, count, measure, counter=None):
    """Return the load cycles of a run in which ``measure`` gives value and position from the reference."""
    counter = counter or Counter(whole)
    rows, found = runner.rows(0, count), []
    for k in range(count):
        reference, points = float(rows.reference[k, 0]), [int(column[k]) for column in rows.points[:3]]
        sample = Sample(k, *points, float(rows.points.phase[k]), int(rows.state[k]), reference, *measure(k, reference))
        found += counter.add(sample)
        if counter.complaint:
            break
    return counter, found


def test_load_cycles_are_measured_and_counted_once():
    whole = programme([CYCLES, OTHER], start=500.0)
    counter, found = counted(whole, runner_of(whole), 2000, lambda k, force: (force + 3.0, 1e-6 * force))
    assert [cycle.load_cycle for cycle in found] == list(range(1, 11))
    assert [cycle.samples for cycle in found] == [100] * 7 + [200] * 3
    assert [cycle.cycle for cycle in found] == [1, 2, 3, 4, 5, 6, 7, 1, 2, 3]
    assert found[2].peak == pytest.approx(1503.0)
    assert found[2].valley == pytest.approx(503.0)
    assert found[2].mean == pytest.approx(1003.0)
    assert found[2].error == pytest.approx(3.0)
    assert found[2].stiffness == pytest.approx(1e6)
    assert not counter.complaint


def test_what_was_logged_before_is_not_counted_again():
    whole = programme([CYCLES], start=500.0)
    _, found = counted(whole, runner_of(whole), 800, lambda k, force: (force, 0.0), Counter(whole, done=4))
    assert [cycle.load_cycle for cycle in found] == [5, 6, 7]


LIMITS = {
    "peak": ({"peak": [1490.0, 1510.0]}, lambda k, f: (1.02 * f, 0.0), "the peak is 1530"),
    "valley": ({"valley": [480.0, 520.0]}, lambda k, f: (f - 30.0, 0.0), "the valley is 470"),
    "peak error": ({"peak_error": 20.0}, lambda k, f: (1.02 * f, 0.0), "the peak is 30 off"),
    "valley error": ({"valley_error": 20.0}, lambda k, f: (f - 30.0, 0.0), "the valley is 30 off"),
    "error": (
        {"error": 20.0},
        lambda k, f: (f - 30.0 * (k == 333), 0.0),
        "the error is 30, its limit 20 (cycles 0, control cycle 333",
    ),
    "position": ({"position": [-0.1, 0.1]}, lambda k, f: (f, 0.2 * (k == 444)), "the position is 0.2 m"),
    "stiffness": (
        {"stiffness_change": 20.0, "stiffness_cycles": 2},
        lambda k, f: (f, 1e-6 * f * (1.0 if k < 400 else 1.0 / 0.7)),
        "the stiffness has changed by -30 %",
    ),
}


def test_a_force_that_stands_still_for_ten_load_cycles_ends_no_counting():
    """A stuck sensor, or a closed gate: without a limit on the stiffness it is logged, with one it is a violation."""
    whole = programme([{**CYCLES, "count": 30}], start=500.0)
    counter, found = counted(whole, runner_of(whole), 3000, lambda k, force: (1e3, 1e-6 * force))
    assert len(found) == 29
    assert found[-1].stiffness == 0.0
    assert counter.stiffness == ()
    limited = programme([{**CYCLES, "count": 30, "limits": {"stiffness_change": 20.0}}], start=500.0)
    counter, found = counted(limited, runner_of(limited), 3000, lambda k, force: (1e3, 1e-6 * force))
    assert "the stiffness cannot be judged: the measured value does not change (cycles 0, load cycle 1)" in counter.complaint
    # A specimen that breaks later has zero stiffness.
    counter, found = counted(limited, runner_of(limited), 3000, lambda k, force: (force if k < 1500 else 1e3, 1e-6 * force))
    assert "the stiffness has changed by -100 %" in counter.complaint
    counter, _ = counted(limited, runner_of(limited), 3000, lambda k, force: (force, 0.0))
    assert "the position of the piston does not change" in counter.complaint


ON_FORCE = [limit for limit in LIMITS if limit != "position"]


@pytest.mark.parametrize("limit", ON_FORCE)
@pytest.mark.parametrize("nothing", [math.nan, math.inf, -math.inf])
def test_a_force_that_is_not_measured_violates_each_limit_on_it(limit, nothing):
    whole = programme([{**CYCLES, "limits": LIMITS[limit][0]}], start=500.0)
    counter, _ = counted(whole, runner_of(whole), 700, lambda k, force: (force if k < 333 else nothing, 1e-6 * force))
    if limit == "error" and math.isinf(nothing):
        assert "the error is inf" in counter.complaint
    else:
        assert "the measured value has been missing for 10 control cycles (cycles 0, control cycle 342)" in counter.complaint


@pytest.mark.parametrize("limit", ON_FORCE)
def test_a_reading_that_is_lost_now_and_then_violates_nothing(limit):
    whole = programme([{**CYCLES, "limits": LIMITS[limit][0]}], start=500.0)
    counter, _ = counted(
        whole, runner_of(whole), 700, lambda k, force: (math.nan if 12 <= k % 50 < 15 else force, 1e-6 * force)
    )
    assert not counter.complaint


def test_a_position_that_is_not_measured_violates_its_limit_and_nothing_is_judged_without_limits():
    whole = programme([{**CYCLES, "limits": {"position": [-0.1, 0.1]}}], start=500.0)
    counter, _ = counted(whole, runner_of(whole), 700, lambda k, force: (force, math.nan))
    assert "the position of the piston has been missing for 10 control cycles" in counter.complaint
    free = programme([CYCLES], start=500.0)
    counter, found = counted(free, runner_of(free), 750, lambda k, force: (math.nan, math.nan))
    assert not counter.complaint
    assert len(found) == 7
    assert all(math.isnan(cycle.peak) for cycle in found)
    # The load cycle is so short that the time is not over before its end.
    short = programme([{**CYCLES, "frequency": 200.0, "limits": {"peak": [0.0, 2e3]}}], start=500.0)
    counter, _ = counted(short, runner_of(short), 30, lambda k, force: (math.nan, 0.0))
    assert "the measured value is missing (cycles 0, load cycle 1)" in counter.complaint


def test_load_cycles_of_which_nothing_was_received_are_not_judged():
    whole = programme([{**CYCLES, "limits": {"peak": [1490.0, 1510.0], "stiffness_change": 20.0}}], start=500.0)
    counter, rows = Counter(whole), runner_of(whole).rows(0, 800)
    for k in (*range(150), *range(450, 660)):
        points = [int(column[k]) for column in rows.points[:3]]
        force = float(rows.reference[k, 0])
        counter.add(Sample(k, *points, float(rows.points.phase[k]), int(rows.state[k]), force, force, 1e-6 * force))
    assert counter.done == 6
    assert not counter.complaint


@pytest.mark.parametrize("limit", LIMITS)
def test_limits_stop_and_only_what_is_out_of_them(limit):
    limits, measure, said = LIMITS[limit]
    whole = programme([{**CYCLES, "limits": limits}], start=500.0)
    counter, found = counted(whole, runner_of(whole), 800, measure)
    assert said in counter.complaint
    counter, found = counted(whole, runner_of(whole), 800, lambda k, f: (f, 1e-6 * f))
    assert len(found) == 7
    assert not counter.complaint
    # The first load cycles of a block may be exempt.
    settled = programme([{**CYCLES, "limits": {**limits, "settling": 7}}], start=500.0)
    counter, _ = counted(settled, runner_of(settled), 690, measure)
    assert limit == "stiffness" or not counter.complaint


@pytest.mark.parametrize(
    ("blocks", "said"),
    [
        ([], "list of one block or more"),
        ([{"block": "cycle"}], "did you mean 'cycles'"),
        ([{"block": "cycles", "count": 1}], "blocks[0]: cycles: key 'frequency' is missing"),
        ([{**CYCLES, "waveform": "chirp"}], "one of haversine, sine, triangle"),
        ([{**CYCLES, "shape": {"corner": 0.1}}], "'corner' is unknown"),
        ([{"repeat": 2, "blocks": [CYCLES, {"block": "dwell", "time": -1.0}]}], "blocks[0]: blocks[1]: dwell: time is -1.0"),
        ([{"repeat": 0, "blocks": [CYCLES]}], "repeat is 0"),
        ([{"repeat": 2, "block": "dwell"}], "with 'repeat' and 'blocks'"),
        ([{"block": "ramp", "to": 1.0, "time": 1.0, "rate": 1.0}], "block 0 (ramp 0): ramp: time is 1.0, rate is 1.0"),
        ([{**CYCLES, "limits": {"peek": 1.0}}], "'peek' is unknown"),
        ([{**CYCLES, "count": 10**12}], "the programme takes 1e+11 s"),
    ],
)
def test_a_wrong_programme_is_refused_with_its_place(blocks, said):
    with pytest.raises(BadInput) as caught:
        programme(blocks)
    assert said in str(caught.value)
    assert math.isfinite(len(str(caught.value)))
