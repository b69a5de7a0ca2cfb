import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest

from ehls_ros.control.programme.expansion import programme_of
from ehls_ros.control.references import REFERENCES, velocity_sweep
from ehls_ros.control.references._signals import eased_in
from ehls_ros.control.references.base import SampledReference
from ehls_ros.errors import BadInput
from ehls_ros.experiments.spec import Spec, spec_from_mapping
from ehls_ros.schema import declarations, parse

DURATION = 8.0
STEP_LEVELS = [1e3, 6e3, -4e3, -2e3]
SPECTRUM = [(0.5, 0.0), (1.2, 3e3), (2.0, -4e3), (2.6, 1e3), (4.0, 6e3), (5.5, 5e3), (6.0, 0.0)]


def no_corners(_: Any) -> list[float]:
    return []


def triangle_corners(p: Any) -> list[float]:
    """Ends of the parabolas: there the second derivative jumps."""
    period = 1.0 / p.frequency
    peaks = np.arange(0.25 * period, DURATION + period, 0.5 * period)
    half = 0.5 * p.corner * period
    return [*(peaks - half), *(peaks + half)]


def sweep_corners(p: Any) -> list[float]:
    """Times at which a stroke starts, reaches its velocity, slows down, and ends."""
    t = np.arange(0.0, DURATION, 1e-5)
    acceleration = velocity_sweep.sample(t, p)[:, 2]
    return [float(time) for time in t[1:][np.diff(acceleration) != 0.0]]


PROGRAMME = [
    {"block": "cycles", "amplitude": 2e3, "mean": 1e3, "frequency": 2.0, "count": 3},
    {"repeat": 2, "blocks": [{"block": "ramp", "to": 4e3, "time": 0.7}, {"block": "dwell", "time": 0.4}]},
    {"block": "signal", "reference": {"name": "sine", "amplitude": 500.0, "frequency": 1.0}, "time": 1.9},
]


def programme_corners(p: Any) -> list[float]:
    """Ends of blocks and of the ramps between them, and corners of ramps and fades."""
    whole, time, found = programme_of(p), 0.0, []
    while time < whole.duration:
        spot = whole.spot(time)
        time = spot.end
        bends = (0.2, 0.5, 0.8) if spot.segment.leads or spot.segment.leaf.kind == "ramp" else ()
        found += [spot.since + share * spot.segment.duration for share in bends]
        found += [spot.since + 0.5, spot.end - 0.5] if spot.segment.leaf.kind == "signal" else []
        found.append(time)
    return [0.0, *found]


class Case(NamedTuple):
    """Test parameters of a member, jumps of its second derivative, and jumps of only the third."""

    values: Mapping[str, Any] = MappingProxyType({})
    corners: Callable[[Any], list[float]] = no_corners
    joints: tuple[float, ...] = ()


# A member that is not listed is tested with its defaults and has to be smooth throughout.
CASES = {
    "amplitude_sweep": Case({"start_amplitude": 2e3, "sweep": 6.0, "offset": 1e3}, joints=(6.0,)),
    "chirp": Case({"sweep": 6.0, "offset": 1e3}, lambda p: [p.sweep]),
    "constant": Case({"value": -3e3}),
    "irregular": Case({"seed": 3}, joints=(0.5,)),
    "load_spectrum": Case({"points": SPECTRUM}, joints=(SPECTRUM[0][0], SPECTRUM[-1][0])),
    "programme": Case({"blocks": PROGRAMME}, programme_corners),
    "ramp": Case({"time": 3.0}, joints=(0.6, 1.5, 2.4, 3.0)),
    "random": Case({"highest_frequency": 2.0}, joints=(0.5,)),
    "sine": Case({"offset": 2e3, "phase": 0.4}),
    "steps": Case({"levels": STEP_LEVELS, "hold": 1.0, "rise": 0.7}, joints=(1.0, 1.7, 2.7, 3.4, 4.4, 5.1)),
    "triangle": Case({}, triangle_corners),
    "velocity_sweep": Case({"velocities": [0.01, 0.05], "travel": 0.06, "longest": 1.5, "repeats": 1}, sweep_corners),
}


def case_of(name: str) -> tuple[Any, Any, list[float]]:
    signal = REFERENCES.load(name)
    case = CASES.get(name, Case())
    p = parse(signal.Parameters, case.values, name)
    return signal, p, case.corners(p)


def slope(signal: Any, p: Any, column: int, t: np.ndarray, h: float) -> np.ndarray:
    """Central difference of fourth order."""
    f = [signal.sample(t + n * h, p)[:, column] for n in (-2, -1, 1, 2)]
    return (f[0] - 8.0 * f[1] + 8.0 * f[2] - f[3]) / (12.0 * h)


@pytest.mark.parametrize("name", REFERENCES.names())
@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_are_those_of_the_value(name, order):
    signal, p, corners = case_of(name)
    h = 2e-4
    t = np.random.default_rng(7).uniform(3.0 * h, DURATION, 4000)
    for corner in (*corners, *CASES.get(name, Case()).joints):
        t = t[np.abs(t - corner) > 3.0 * h]
    given = signal.sample(t, p)[:, order]
    numerical = slope(signal, p, order - 1, t, h)
    assert len(t) > 3000
    assert np.max(np.abs(given - numerical)) <= 2e-6 * max(np.max(np.abs(given)), 1e-3)


@pytest.mark.parametrize("name", REFERENCES.names())
def test_value_and_rate_are_continuous(name):
    signal, p, corners = case_of(name)
    fine = np.concatenate([np.arange(0.0, DURATION, 1e-3), *(np.linspace(c - 1e-3, c + 1e-3, 41) for c in corners)])
    rows = signal.sample(np.sort(fine), p)
    gap = np.diff(np.sort(fine))
    for column in (0, 1):
        fastest = np.max(np.abs(rows[:, column + 1]))
        assert np.all(np.abs(np.diff(rows[:, column])) <= 1.001 * fastest * gap + 1e-7)


@pytest.mark.parametrize("name", [name for name in REFERENCES.names() if case_of(name)[2] == []])
def test_second_derivative_is_continuous_where_no_corner_is_stated(name):
    signal, p, _ = case_of(name)
    times = np.arange(1e-3, DURATION, 1e-3)
    largest = max(float(np.max(np.abs(signal.sample(times, p)[:, 2]))), 1e-9)
    for time in (*times[::50], *(point[0] for point in SPECTRUM), 0.5):
        before, after = signal.sample(np.array([time - 1e-7, time + 1e-7]), p)[:, 2]
        assert abs(after - before) <= 1e-4 * largest


@pytest.mark.parametrize("name", REFERENCES.names())
def test_row_is_bit_for_bit_rows_in_any_order(name):
    signal, p, _ = case_of(name)
    cycles = 2 * SampledReference.BLOCK + 37
    rows = SampledReference(signal, p, 1e-3).rows(0, cycles)
    one_by_one = SampledReference(signal, p, 1e-3)
    for cycle in (0, cycles - 1, 1, SampledReference.BLOCK, SampledReference.BLOCK - 1, 5, cycles - 1):
        assert one_by_one.row(cycle).tobytes() == rows[cycle].tobytes()
    assert np.all(np.isfinite(rows))
    assert rows.shape == (cycles, 3)


@pytest.mark.parametrize("name", REFERENCES.names())
@pytest.mark.parametrize("first", [1, 7, SampledReference.BLOCK - 1, SampledReference.BLOCK, 2 * SampledReference.BLOCK + 5])
@pytest.mark.parametrize("cycles", [0, 1, 30, SampledReference.BLOCK, 2 * SampledReference.BLOCK + 3])
def test_rows_may_begin_and_end_anywhere(name, first, cycles):
    signal, p, _ = case_of(name)
    one_by_one = SampledReference(signal, p, 1e-3)
    expected = np.array([one_by_one.row(k) for k in range(first, first + cycles)]).reshape(cycles, 3)
    rows = SampledReference(signal, p, 1e-3).rows(first, cycles)
    assert rows.tobytes() == expected.tobytes()
    # Also if another block was requested before.
    assert one_by_one.rows(first, cycles).tobytes() == expected.tobytes()


@pytest.mark.parametrize("name", REFERENCES.names())
def test_a_sample_depends_on_its_own_time_only(name):
    signal, p, _ = case_of(name)
    t = np.linspace(0.0, DURATION, 301)
    together = signal.sample(t, p)
    alone = np.concatenate([signal.sample(np.array([time]), p) for time in t])
    assert np.allclose(together, alone, rtol=1e-12, atol=1e-9)


def sample(name: str, t: Any, **values: Any) -> np.ndarray:
    signal = REFERENCES.load(name)
    return signal.sample(np.asarray(t, dtype=float), parse(signal.Parameters, values, name))


def test_constant_stays():
    assert np.array_equal(sample("constant", [0.0, 1.0, 1e5], value=-7.5), [[-7.5, 0.0, 0.0]] * 3)


def test_sine_has_the_papers_values():
    # 10 sin(pi t) kN at t = 1/6 s: 5 kN, pi cos(pi/6) 10 kN/s, -pi^2 5 kN/s^2
    row = sample("sine", [1.0 / 6.0], amplitude=1e4, frequency=0.5)[0]
    assert row == pytest.approx([5e3, 27206.990463513265, -49348.02200544679], rel=1e-12)


def test_triangle_keeps_the_flanks_of_the_sharp_one_and_rounds_its_peak():
    amplitude, frequency, corner = 1e4, 0.5, 0.02
    t = np.linspace(0.0, 4.0, 40001)
    rows = sample("triangle", t, amplitude=amplitude, frequency=frequency, corner=corner)
    sharp = amplitude * 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * frequency * t))
    from_corner = (t + 0.5) % 1.0
    from_corner = np.minimum(from_corner, 1.0 - from_corner)
    flank = from_corner > 0.5 * corner / frequency + 1e-9
    assert np.allclose(rows[flank, 0], sharp[flank], rtol=0.0, atol=1e-7)
    # A parabola over 2 h with slopes +-m at its ends stays m h / 2 below the corner.
    lost = 4.0 * amplitude * frequency * 0.5 * (0.5 * corner / frequency)
    assert rows[:, 0].max() == pytest.approx(amplitude - lost, rel=1e-9)
    assert rows[:, 0].min() == pytest.approx(-(amplitude - lost), rel=1e-9)
    assert np.allclose(sample("triangle", t + 2.0)[:, :2], sample("triangle", t)[:, :2], rtol=0.0, atol=1e-6)


def test_irregular_starts_at_rest_and_stays_within_its_amplitude():
    t = np.linspace(0.0, 60.0, 20001)
    for seed in range(20):
        rows = sample("irregular", t, amplitude=8e3, seed=seed)
        assert np.allclose(rows[0], 0.0, atol=1e-9)
        assert 0.3 * 8e3 < np.max(np.abs(rows[:, 0])) <= 8e3


def test_irregular_follows_its_seed_and_its_band():
    t = np.linspace(0.0, 10.0, 1001)
    assert np.array_equal(sample("irregular", t, seed=5), sample("irregular", t, seed=5))
    assert np.max(np.abs(sample("irregular", t, seed=5) - sample("irregular", t, seed=6))) > 1e3
    # After the start every component obeys |x''| <= (2 pi f)^2 amplitude with the band's highest f.
    fast = sample("irregular", t[t > 0.5], amplitude=1.0, lowest_frequency=0.2, highest_frequency=0.6)
    assert np.max(np.abs(fast[:, 2])) <= (2.0 * np.pi * 0.6) ** 2


def test_chirp_has_its_instantaneous_frequency():
    values = {"amplitude": 1.0, "start_frequency": 0.5, "end_frequency": 4.0, "sweep": 8.0}
    t = np.linspace(0.0, 12.0, 120001)
    wave = sample("chirp", t, **values)[:, 0]
    up = np.flatnonzero((wave[:-1] < 0.0) & (wave[1:] >= 0.0))
    crossings = t[up] - wave[up] * (t[1] - t[0]) / (wave[up + 1] - wave[up])
    # Upward zeros of sin(2 pi (f0 t + (f1 - f0) t^2/(2 T))) are where the bracket is an integer.
    bracket = np.where(crossings < 8.0, 0.5 * crossings + 3.5 * crossings**2 / 16.0, 18.0 + 4.0 * (crossings - 8.0))
    assert len(crossings) > 30
    assert np.max(np.abs(bracket - np.round(bracket))) < 1e-4


def test_multi_sine_keeps_its_peak_low_and_its_harmonics_equal():
    n, base = 10, 0.1
    t = np.arange(4096) / 4096.0 / base
    wave = sample("multi_sine", t, amplitude=1e3, base_frequency=base, harmonics=n, offset=250.0)[:, 0]
    spectrum = np.abs(np.fft.rfft(wave)) / 2048.0
    assert spectrum[0] / 2.0 == pytest.approx(250.0)
    assert np.allclose(spectrum[1 : n + 1], 1e3, rtol=1e-9)
    assert np.max(spectrum[n + 1 :]) < 1e-6
    crest = np.max(np.abs(wave - 250.0)) / np.sqrt(np.mean((wave - 250.0) ** 2))
    assert crest < 2.0  # in phase it would be sqrt(2 n) = 4.5


@pytest.mark.parametrize("count", range(2, 8))
def test_load_spectrum_passes_through_its_points_and_holds_outside(count):
    points = SPECTRUM[:count]
    times, values = np.array(points).T
    at_points = sample("load_spectrum", times, points=points)
    assert np.allclose(at_points[:, 0], values, rtol=0.0, atol=1e-6)
    outside = sample("load_spectrum", [times[0] - 0.3, times[0] - 1e-6, times[-1] + 1e-6, times[-1] + 5.0], points=points)
    assert np.allclose(outside[:, 0], [values[0], values[0], values[-1], values[-1]], atol=1e-6)
    assert np.array_equal(outside[:, 1:], np.zeros((4, 2)))


def test_load_spectrum_of_two_points_is_the_smooth_step():
    # The only quintic from rest at 0 to rest at h: h (10 x^3 - 15 x^4 + 6 x^5)
    x = np.linspace(0.0, 1.0, 11)
    rows = sample("load_spectrum", 2.0 * x, points=[(0.0, 0.0), (2.0, 4e3)])
    assert np.allclose(rows[:, 0], 4e3 * (10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5), atol=1e-8)


def test_load_spectrum_of_a_densely_recorded_sine_is_that_sine():
    t = np.arange(0.0, 4.0 + 1e-9, 0.01)
    points = list(zip(t, 1e4 * np.sin(np.pi * t), strict=True))
    between = np.linspace(0.5, 3.5, 777)
    rows = sample("load_spectrum", between, points=points)
    assert np.allclose(rows[:, 0], 1e4 * np.sin(np.pi * between), atol=1e-3)
    assert np.allclose(rows[:, 1], 1e4 * np.pi * np.cos(np.pi * between), atol=1.0)


SWEEPS = [
    pytest.param({}, id="the paper's"),
    pytest.param({"velocities": (0.15, 0.002, 0.02), "repeats": 2, "travel": 0.2, "rest": 0.0, "centre": 0.3}, id="downwards"),
    pytest.param({"velocities": (0.01,), "repeats": 3, "longest": 0.5, "acceleration": 10.0}, id="one velocity"),
]


@pytest.mark.parametrize("values", SWEEPS)
def test_velocity_sweep_moves_at_every_velocity_both_ways(values):
    p = parse(velocity_sweep.Parameters, values, "velocity_sweep")
    length = velocity_sweep.duration(p)
    t = np.arange(0.0, length + 1.0, 1e-3)
    position, rate, acceleration = velocity_sweep.sample(t, p).T
    for velocity in p.velocities:
        stroke = min(p.travel, velocity * p.longest)
        held = stroke / velocity - velocity / p.acceleration
        for direction in (1.0, -1.0):
            at_it = (np.abs(rate - direction * velocity) < 1e-12) & (acceleration == 0.0)
            parts = np.split(np.flatnonzero(at_it), np.flatnonzero(np.diff(np.flatnonzero(at_it)) > 1) + 1)
            whole = [part for part in parts if abs(len(part) * 1e-3 - held) < 3e-3]
            # On the way to the next velocity's strokes, the rod also moves at one of the velocities, but not as far.
            assert len(whole) == p.repeats
            assert all(abs(np.mean(position[part]) - p.centre) < 1e-3 * velocity for part in whole)
            assert all(len(part) * 1e-3 < held + 3e-3 for part in parts)
    assert np.min(position) >= p.centre - 0.5 * p.travel - 1e-12
    assert np.max(position) <= p.centre + 0.5 * p.travel + 1e-12
    assert np.max(np.abs(acceleration)) <= p.acceleration
    assert set(np.round(np.abs(rate[acceleration == 0.0]), 9)) == {0.0, *np.round(p.velocities, 9)}


@pytest.mark.parametrize("values", SWEEPS)
def test_velocity_sweep_begins_and_ends_at_rest_in_the_middle(values):
    p = parse(velocity_sweep.Parameters, values, "velocity_sweep")
    length = velocity_sweep.duration(p)
    rows = velocity_sweep.sample(np.array([0.0, 0.5 * p.rest, length + 1e-9, length + 100.0]), p)
    assert np.allclose(rows, [[p.centre, 0.0, 0.0]] * 4, rtol=0.0, atol=1e-12)
    assert velocity_sweep.sample(np.array([length - 1e-4]), p)[0, 2] != 0.0


def test_velocity_sweep_of_the_paper_takes_27_minutes():
    p = velocity_sweep.Parameters()
    assert len(p.velocities) == 20
    assert velocity_sweep.duration(p) == pytest.approx(1636.19, abs=0.01)
    assert velocity_sweep.duration(p._replace(repeats=1)) == pytest.approx(275.66, abs=0.01)


SECTION = "spec.yaml: reference"


def spec_with(rig: dict[str, Any], reference: Any) -> Spec:
    return spec_from_mapping(
        {"rig": rig, "reference": reference, "controller": {"name": "fasmc"}}, "spec.yaml", Path("nowhere")
    )


def wrong_values() -> list[Any]:
    """One case per declared limit of every member, and values that no number may have."""
    cases = []
    for name in REFERENCES.names():
        for declared in declarations(REFERENCES.load(name).Parameters):
            if declared.kind not in {int, float}:
                continue
            wrong: list[Any] = [float("nan"), float("inf"), "wide", [1.0], None]
            wrong += [] if declared.minimum is None else [declared.minimum - 1]
            wrong += [] if declared.maximum is None else [declared.maximum * 2]
            cases += [pytest.param(name, declared.name, value, id=f"{name}-{declared.name}-{value}") for value in wrong]
    return cases


@pytest.mark.parametrize(("name", "key", "value"), wrong_values())
def test_a_wrong_value_gives_one_readable_line(rig_mapping, name, key, value):
    with pytest.raises(BadInput) as caught:
        spec_with(rig_mapping, {"name": name, **CASES.get(name, Case()).values, key: value})
    line = str(caught.value)
    assert line.startswith(f"{SECTION}: {name}: {key} is {value!r}; expected ")
    assert "\n" not in line


@pytest.mark.parametrize(
    ("reference", "where", "what", "expected"),
    [
        (None, SECTION, "None", "a mapping with a name"),
        ("sinus", SECTION, "'sinus'", "sine"),
        ("", SECTION, "''", "sine"),
        ("load_spectrum", f"{SECTION}: load_spectrum", "'points'", "value"),
        (3, SECTION, "3", "a mapping with a name"),
        (["sine"], SECTION, "['sine']", "a mapping with a name"),
        ({}, SECTION, "{}", "a mapping with a name"),
        ({"amplitude": 1.0}, SECTION, "amplitude", "a mapping with a name"),
        ({"name": "sinus"}, SECTION, "'sinus'", "sine"),
        ({"name": ["sine"]}, SECTION, "['sine']", "sine"),
        ({"name": "../sine"}, SECTION, "'../sine'", "sine"),
        ({"name": "base"}, SECTION, "'base'", "sine"),
        ({"name": "_harmonics"}, SECTION, "'_harmonics'", "sine"),
        ({"name": "sine", "frequenzy": 1.0}, f"{SECTION}: sine", "'frequenzy'", "frequency"),
        ({"name": "load_spectrum"}, f"{SECTION}: load_spectrum", "'points'", "value"),
        ({"name": "load_spectrum", "points": []}, SECTION, "points holds 0", "two or more"),
        ({"name": "load_spectrum", "points": [[0.0, 1.0]]}, SECTION, "points holds 1", "two or more"),
        ({"name": "load_spectrum", "points": [[0.0, 1.0], [0.0, 2.0]]}, SECTION, "points[1]", "increas"),
        ({"name": "load_spectrum", "points": [[0.0, 1.0], [1.0, float("nan")]]}, SECTION, "nan", "finite"),
        ({"name": "velocity_sweep", "velocities": []}, SECTION, "velocities is empty", "one velocity"),
        ({"name": "velocity_sweep", "velocities": [0.1, -0.1]}, SECTION, "velocities[1] is -0.1", "above 0"),
        ({"name": "velocity_sweep", "velocities": [float("inf")]}, SECTION, "velocities[0] is inf", "finite"),
        ({"name": "velocity_sweep", "velocities": [0.5]}, SECTION, "a stroke of 0.5 m is too short", "more travel"),
        ({"name": "velocity_sweep", "velocities": 0.1}, f"{SECTION}: velocity_sweep", "velocities is 0.1", "list"),
        ({"name": "irregular", "lowest_frequency": 2.0, "highest_frequency": 1.0}, SECTION, "2", "highest_frequency"),
    ],
)
def test_a_wrong_section_gives_one_readable_line(rig_mapping, reference, where, what, expected):
    with pytest.raises(BadInput) as caught:
        spec_with(rig_mapping, reference)
    assert where in caught.value.where
    assert what in caught.value.what
    assert expected in caught.value.expected
    assert "\n" not in str(caught.value)


def has_defaults(name: str) -> bool:
    return all(declared.default is not None for declared in declarations(REFERENCES.load(name).Parameters))


@pytest.mark.parametrize("name", list(filter(has_defaults, REFERENCES.names())))
def test_a_bare_name_is_the_member_with_its_defaults(rig_mapping, name):
    assert spec_with(rig_mapping, name).reference == spec_with(rig_mapping, {"name": name}).reference


def test_every_member_samples_as_the_family_says():
    for name in REFERENCES.names():
        assert list(inspect.signature(REFERENCES.load(name).sample).parameters) == ["t", "p"], name


def test_a_reference_is_led_in_from_rest_without_a_jump_up_to_its_second_derivative():
    duration, start, step = 1.0, -3.0, 1e-4

    def at(time):
        row = (5.0 + 2.0 * np.sin(4.0 * time), 8.0 * np.cos(4.0 * time), -32.0 * np.sin(4.0 * time))
        return np.array(eased_in(row, start, time, duration)), row

    np.testing.assert_allclose(at(0.0)[0], (start, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(*at(duration))
    for time in (0.1, 0.5, 0.9):
        before, here, after = (at(time + shift)[0] for shift in (-step, 0.0, step))
        np.testing.assert_allclose((after - before)[:2] / (2.0 * step), here[1:], rtol=1e-5)
