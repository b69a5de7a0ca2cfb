"""Synthetic signals with known errors: a verification must find them within its stated uncertainty."""

import json
import math

import numpy as np
import pytest

import ehls_ros as ehls
from ehls_ros import trajectory
from ehls_ros.errors import BadInput
from ehls_ros.experiments.verification.blocks import BLOCK, PHASE, REPETITION, repeating_parts
from ehls_ros.experiments.verification.results import Cyclic, NonCyclic, Refused, verification_document
from ehls_ros.experiments.verification.uncertainty import std_of_mean
from ehls_ros.experiments.verification.verify import Given, verify_recording
from ehls_ros.physics.parameters import Sensor
from ehls_ros.recording.events import Pause
from ehls_ros.trajectory import Signal, Trajectory

DRAWS = 40


def made(time, force, reference, **signals):
    return Trajectory(time, {"force_n": force, "force_reference_n": reference, **signals})


def verified(run, **given):
    return verify_recording(run, Given(**given), "made")


def only(run, **given):
    [block] = verified(run, **given).blocks
    return block.found


def sine(time, frequency=1.0, amplitude=8e3, mean=2e3, lag=0.0):
    return mean + amplitude * np.sin(2.0 * np.pi * frequency * time - lag)


@pytest.fixture
def programmed(monkeypatch):
    """The signals of a programme, whether or not recordings have them yet."""
    for name in (BLOCK, REPETITION, PHASE):
        monkeypatch.setitem(trajectory.READABLE, name, Signal(name, "1"))


@pytest.fixture(scope="module")
def draws():
    """Deviation and stated standard uncertainty of every quantity, over seeded draws of error, distortion and noise."""
    found = {}
    for seed in range(DRAWS):
        random = np.random.default_rng(seed)
        frequency, noise = random.uniform(0.8, 3.0), random.uniform(5.0, 40.0)
        gain, lag, offset = random.uniform(0.95, 1.02), random.uniform(-0.02, 0.15), random.uniform(-50.0, 50.0)
        second, third = random.uniform(20.0, 200.0, 2)
        starts = random.uniform(0.0, 2.0 * np.pi, 3)

        def force(at, *, of=(gain, lag, offset, second, third, starts)):
            gain, lag, offset, second, third, starts = of
            angle = 2.0 * np.pi * at + starts[0] - lag
            distortion = second * np.cos(2.0 * angle + starts[1]) + third * np.cos(3.0 * angle + starts[2])
            return 2e3 + offset + gain * 8e3 * np.sin(angle) + distortion

        time = np.arange(0.0, random.integers(8, 25) / frequency, 0.002)
        reference = 2e3 + 8e3 * np.sin(2.0 * np.pi * frequency * time + starts[0])
        one = only(made(time, force(frequency * time) + noise * random.standard_normal(time.size), reference))
        whole = force(np.linspace(0.0, 1.0, 100_001))
        truth = {
            "peak": whole.max(),
            "valley": whole.min(),
            "mean": 2e3 + offset,
            "range": np.ptp(whole),
            "amplitude": gain * 8e3,
            "phase": -math.degrees(lag),
        }
        for quantity in one.quantities:
            deviation = quantity.measured - truth[quantity.name]
            found.setdefault(quantity.name, []).append((deviation, quantity.uncertainty.standard))
        for order, size in ((2, second), (3, third)):
            row = one.harmonics[order - 1]
            found.setdefault(f"harmonic {order}", []).append((row.measured_n - size, 0.5 * row.expanded_n))
        thd = 100.0 * math.hypot(second, third) / (gain * 8e3)
        deviation = one.distortion.measured_percent - thd
        found.setdefault("distortion", []).append((deviation, 0.5 * one.distortion.expanded_percent))
    return {name: np.array(rows) for name, rows in found.items()}


QUANTITIES = ("peak", "valley", "mean", "range", "amplitude", "phase", "harmonic 2", "harmonic 3", "distortion")


@pytest.mark.parametrize("name", QUANTITIES)
def test_what_is_known_lies_within_the_stated_uncertainty_and_unbiased(draws, name):
    deviation, standard = draws[name].T
    covered = np.mean(np.abs(deviation) <= 2.0 * standard)
    assert 0.85 <= covered <= 1.0
    # Not so wide that every value would lie within it.
    assert np.sqrt(np.mean((deviation / standard) ** 2)) > 0.5
    assert abs(np.mean(deviation / standard)) < 3.0 / math.sqrt(DRAWS)


def test_a_pure_sine_has_no_distortion_beyond_its_uncertainty():
    time = np.arange(0.0, 12.0, 0.002)
    off = []
    for seed in range(DRAWS):
        noise = 30.0 * np.random.default_rng(seed).standard_normal(time.size)
        found = only(made(time, sine(time) + noise, sine(time))).distortion
        off.append(found.measured_percent / found.expanded_percent)
    assert np.mean(np.array(off) <= 1.0) >= 0.85


def test_the_corner_of_a_triangle_that_comes_late_keeps_its_height():
    """Ten harmonics of the error alone would miss it by 80 N."""
    time = np.arange(0.0, 15.0, 2e-3)

    def triangle(lag):
        angle = 2.0 * np.pi * time - lag
        return 8e3 * 8.0 / np.pi**2 * sum((-1) ** (k // 2) * np.sin(k * angle) / k**2 for k in range(1, 40, 2))

    reference = triangle(0.0)
    for seed in range(5):
        noise = 20.0 * np.random.default_rng(seed).standard_normal(time.size)
        one = only(made(time, 0.98 * triangle(0.12) + noise, reference))
        assert one.peak.measured == pytest.approx(0.98 * reference.max(), abs=10.0)
        assert one.range.error == pytest.approx(-0.02 * np.ptp(reference), abs=2.0 * one.range.uncertainty.expanded)


def test_resolution_noise_and_calibration_have_their_cells():
    time = np.arange(0.0, 10.0, 0.002)
    rig = ehls.rig("rig_paper")
    rig = rig._replace(sensors={"force": Sensor(noise_std=50.0, resolution=24.0, delay=1e-3, bandwidth=2e3)})
    one = only(made(time, sine(time, mean=500.0), sine(time, mean=500.0)), rig=rig, cell_uncertainty=0.5)
    of = one.amplitude.uncertainty
    assert of.resolution == pytest.approx(24.0 / math.sqrt(12.0))
    assert of.cell == pytest.approx(0.0025 * 8e3)
    # A component of the sine from n samples: the root of 2/n.
    assert of.noise == pytest.approx(50.0 * math.sqrt(2.0 / (500 * one.cycles_judged)), rel=1e-3)
    assert of.random == of.noise
    assert of.expanded == pytest.approx(2.0 * math.sqrt(of.noise**2 + of.resolution**2 + of.cell**2), rel=1e-6)
    assert one.peak.uncertainty.cell == pytest.approx(0.0025 * 8.5e3)
    assert one.sensor_phase_deg == pytest.approx(-0.36 - math.degrees(math.atan(2.0 * math.pi / 2e3)))


def test_few_cycles_are_as_well_covered_as_many():
    random = np.random.default_rng(3)
    for cycles in (3, 30):
        values = random.standard_normal((2000, cycles))
        covered = np.mean([abs(row.mean()) <= 2.0 * std_of_mean(row) for row in values])
        assert covered == pytest.approx(0.9545, abs=0.015)
    assert math.isnan(std_of_mean(np.ones(1)))


# --- inertia --------------------------------------------------------------------------------------


def test_the_cells_inertia_is_that_of_a_mass_on_a_spring():
    """A mass m between the cell and a spring k: the cell shows k x + m x'', the specimen k x; their ratio is 1 - m w^2/k."""
    stiffness, mass, frequency, motion = 4e6, 25.0, 12.0, 2e-3
    time = np.arange(0.0, 5.0, 1e-3)
    position = motion * np.sin(2.0 * np.pi * frequency * time - 0.1)
    inertia = mass * (2.0 * np.pi * frequency) ** 2 * motion
    cell = stiffness * position - inertia * np.sin(2.0 * np.pi * frequency * time - 0.1)
    noise = 2e-6 * np.random.default_rng(1).standard_normal(time.size)
    reference = stiffness * motion * np.sin(2.0 * np.pi * frequency * time)
    drifting = position + noise + 1e-3 * time
    found = only(made(time, cell, reference, position_m=drifting), inertia_mass=mass)
    correction = found.inertia
    assert found.amplitude.percent == pytest.approx(-100.0 * inertia / (stiffness * motion), rel=1e-6)
    assert correction.force_n == pytest.approx(inertia, abs=correction.force_expanded_n)
    assert correction.force_expanded_n < 0.002 * inertia
    assert abs(correction.amplitude.error) <= correction.amplitude.uncertainty.expanded
    assert abs(correction.phase.error + math.degrees(0.1)) <= correction.phase.uncertainty.expanded
    assert abs(correction.phase_deg) == pytest.approx(180.0, abs=0.2)


def test_inertia_is_refused_where_there_is_no_acceleration():
    time = np.arange(0.0, 10.0, 1e-3)
    still = np.random.default_rng(1).normal(0.0, 1e-5, time.size)
    refused = only(made(time, sine(time), sine(time), position_m=still), inertia_mass=20.0).inertia
    assert isinstance(refused, Refused)
    assert "not above its uncertainty" in refused.reason
    with pytest.raises(BadInput, match=r"no position_m was recorded"):
        verified(made(time, sine(time), sine(time)), inertia_mass=20.0)


# --- blocks and cycles ------------------------------------------------------------------------------


def test_a_programme_s_blocks_are_judged_one_by_one_over_all_their_passes(programmed):
    """Two cyclic blocks and a dwell, run twice: each cyclic block has a different error."""
    parts = [(1, 2.0, 3e3, 0.98), (2, 0.0, 0.0, 1.0), (3, 5.0, 1e3, 1.01)] * 2
    columns = {name: [] for name in ("force", "reference", BLOCK, REPETITION, PHASE)}
    t = np.arange(0.0, 6.0, 1e-3)
    for number, frequency, amplitude, gain in parts:
        position = np.floor(frequency * t + 1e-9), (frequency * t + 1e-9) % 1.0
        wave = amplitude * np.sin(2.0 * np.pi * frequency * t)
        settling = 300.0 * np.exp(-t / 0.1) * np.cos(9.0 * t) if frequency else 5.0
        columns["reference"].append(1e3 + wave)
        columns["force"].append(1e3 + gain * wave + settling)
        columns[BLOCK].append(np.full(t.size, float(number)))
        columns[REPETITION].append(position[0] if frequency else np.zeros(t.size))
        columns[PHASE].append(position[1] if frequency else np.full(t.size, np.nan))
    joined = {name: np.concatenate(part) for name, part in columns.items()}
    time = 1e-3 * np.arange(joined["force"].size)
    force, reference = joined.pop("force"), joined.pop("reference")
    joined[BLOCK][[40, 6000]] = np.nan  # a message that was lost
    found = verified(made(time, force, reference, **joined))
    assert [block.number for block in found.blocks] == [1, 2, 3]
    first, dwell, last = (block.found for block in found.blocks)
    assert (first.passes, last.passes, first.frequency_hz) == (2, 2, pytest.approx(2.0))
    assert first.amplitude.percent == pytest.approx(-2.0, abs=0.01)
    assert last.amplitude.percent == pytest.approx(1.0, abs=0.01)
    assert isinstance(dwell, NonCyclic)
    assert dwell.max_error_n == pytest.approx(5.0)
    assert first.cycles_settling >= 2  # one of each pass at least
    assert first.cycles_judged + first.cycles_settling + first.cycles_incomplete == 24


def test_gaps_and_transients_are_left_out_and_told():
    time = np.arange(0.0, 20.0, 2e-3)
    force = sine(time, lag=0.05) + 2e3 * np.exp(-time / 0.7)
    force[(time > 12.1) & (time < 12.4)] = np.nan
    force[::50] = np.nan  # single samples lost do no harm
    kept = (time < 15.2) | (time > 15.5)
    run = made(time[kept], force[kept], sine(time[kept]))
    [block] = verified(run).blocks
    one = block.found
    assert (one.cycles_incomplete, one.settled) == (2, True)
    assert one.cycles_settling >= 4
    assert block.missing_percent == pytest.approx(100.0 * np.mean(np.isnan(force[kept])))
    assert one.phase.error == pytest.approx(-math.degrees(0.05), abs=0.02)
    assert one.mean.error == pytest.approx(0.0, abs=5.0)
    assert only(run, settling=1).cycles_settling == 1


def test_what_never_settles_is_told():
    time = np.arange(0.0, 20.0, 2e-3)
    one = only(made(time, sine(time) * (1.0 + 0.01 * time), sine(time)))
    assert not one.settled
    assert one.repeatability.peak_drift_n_per_cycle == pytest.approx(100.0, rel=0.05)


@pytest.mark.parametrize(
    ("reference", "reason"),
    [
        (lambda t: np.full(t.size, 5e3), "does not repeat"),
        (lambda t: 1e3 * t, "does not repeat"),
        (lambda t: sine(t, 0.15), "does not repeat"),
        (lambda t: sine(t, 45.0), "samples"),
    ],
    ids=["constant", "ramp", "two cycles", "too fast for its sampling"],
)
def test_a_reference_without_cycles_is_judged_over_time(reference, reason):
    time = np.arange(0.0, 15.0, 2e-3)
    error = np.where(time < 5.0, 20.0, -10.0)
    one = only(made(time, reference(time) + error, reference(time)))
    assert isinstance(one, NonCyclic)
    assert reason in one.reason
    assert (one.max_error_n, one.last_half_max_error_n) == (pytest.approx(20.0), pytest.approx(10.0))
    assert one.rms_error_n == pytest.approx(math.sqrt((400.0 + 2 * 100.0) / 3.0), rel=1e-3)


def test_the_frequency_is_found_whatever_the_wave_and_wherever_it_starts():
    time = np.arange(0.0, 60.0, 1e-3)
    wave = np.abs((0.7310001 * time + 0.3) % 1.0 - 0.5)
    rough = {"spec": {"reference": {"frequency": 0.73}}}
    for metadata in ({}, rough, {"spec": {"reference": {"frequency": 17.0}}}):
        # To a thousandth of a cycle over the whole recording.
        [part] = repeating_parts(time, wave, metadata)
        assert part.samples == slice(0, time.size)
        assert abs(part.sine.frequency - 0.7310001) * time[-1] < 1e-3


def rising(time, begin, length):
    """A ramp from 0 to 1."""
    return np.clip((time - begin) / length, 0.0, 1.0)


@pytest.mark.parametrize(
    ("shape", "parts"),
    [
        (lambda t: np.where(t < 15.0, 0.0, sine(t - 15.0)), [(15.0, 20.0)]),
        (lambda t: np.where(t < 15.0, sine(t), sine(15.0)), [(0.0, 15.0)]),
        (lambda t: 2e3 + rising(t, 0.0, 6.0) * (sine(t) - 2e3), [(5.6, 20.0)]),
        (lambda t: np.where(t < 5.0, 400.0 * t, sine(t - 5.0)) * rising(-t, -18.0, 4.0), [(5.0, 14.1)]),
        (lambda t: np.where((t > 8.0) & (t < 14.0), sine(8.0), sine(t)), [(0.0, 8.0), (14.0, 20.0)]),
        (lambda t: np.where(t < 6.0, 0.4, 1.0) * sine(t), [(6.0, 20.0)]),
        (lambda t: sine(t, frequency=np.where(t < 5.0, 3.0, 1.0)), [(5.0, 20.0)]),
    ],
    ids=["hold first", "hold last", "taper", "ramp and taper", "hold between", "lower level", "another frequency"],
)
@pytest.mark.parametrize("noise", [0.0, 20.0])
def test_parts_that_do_not_repeat_are_left_out_and_named(shape, parts, noise):
    time = np.arange(0.0, 20.0, 2e-3)
    exact = shape(time)
    reference = exact + noise * np.random.default_rng(2).standard_normal(time.size)
    late = np.interp(time - 0.02, time, exact)
    found = verified(made(time, exact.mean() + 0.99 * (late - exact.mean()), reference))
    [block] = found.blocks
    assert isinstance(block.found, Cyclic)
    assert block.found.amplitude.percent == pytest.approx(-1.0, abs=0.05)
    assert block.found.delay_s == pytest.approx(0.02, abs=2e-4)
    assert block.found.passes == len(parts)
    assert block.begin_s == pytest.approx(parts[0][0], abs=0.3)
    assert block.duration_s == pytest.approx(sum(end - begin for begin, end in parts), abs=0.6)
    [remark] = [remark for remark in found.remarks if "repeats from" in remark]
    assert remark.count(" to ") == len(parts)


def test_the_time_to_verify_can_be_given():
    time = 100.0 + np.arange(0.0, 20.0, 2e-3)
    force = np.where(time < 108.0, 0.9, 0.98) * sine(time, mean=0.0)
    found = verified(made(time, force, sine(time, mean=0.0)), begin=8.0, end=18.0)
    [block] = found.blocks
    assert (block.begin_s, block.duration_s) == (pytest.approx(8.0), pytest.approx(10.0, abs=0.01))
    assert block.found.amplitude.percent == pytest.approx(-2.0, abs=0.01)
    with pytest.raises(BadInput, match=r"no two samples lie from 30 to 18 s; .*0 to 19.998 s"):
        verified(made(time, force, sine(time)), begin=30.0, end=18.0)


def test_time_in_which_the_valve_was_closed_is_left_out(programmed):
    time = np.arange(0.0, 20.0, 0.002)
    reference = sine(time)
    closed = (time > 8.3) & (time <= 10.7)
    cycles = {BLOCK: np.zeros_like(time), REPETITION: np.floor(time), PHASE: time % 1.0}
    run = made(time, np.where(closed, 0.0, 1.02 * reference), reference, **cycles)
    found = verified(run, pauses=[Pause(-np.inf, 0.0), Pause(8.3, 10.7), Pause(19.9, np.inf)], settling=0)
    assert found.remarks[0] == "The safety gate kept the valve closed for 2.4 s; that time is left out."
    [block] = found.blocks
    assert block.found.cycles_judged == 16
    assert block.found.amplitude.measured == pytest.approx(1.02 * 8e3, rel=1e-6)
    with pytest.raises(BadInput, match="closed throughout"):
        verified(run, pauses=[Pause(-np.inf, np.inf)])


def test_a_reference_that_never_repeats_has_gain_lag_and_coherence_over_frequency():
    random = np.random.default_rng(1)
    time = np.arange(0.0, 60.0, 2e-3)
    tones = [(f, random.uniform(0.0, 6.0)) for f in np.geomspace(0.2, 4.0, 40) * random.uniform(0.99, 1.01, 40)]

    def irregular(at):
        return 1e3 + sum(500.0 * np.sin(2.0 * np.pi * f * at + start) for f, start in tones)

    reference = irregular(time)
    for spread, coherence in ((0.0, 1.0), (float(reference.std()), 0.9)):
        noise = spread * random.standard_normal(time.size)
        one = only(made(time, 0.95 * irregular(time - 0.03) + noise, reference))
        assert isinstance(one, NonCyclic)
        assert 2 <= len(one.bands) <= 5
        for band in one.bands:
            assert band.gain == pytest.approx(0.95, rel=0.05)
            assert band.lag_s == pytest.approx(0.03, abs=0.01)
            assert coherence - 0.05 <= band.coherence <= 1.0
        whole = math.sqrt(sum(band.reference_rms_n**2 for band in one.bands))
        assert whole == pytest.approx(reference.std(), rel=0.05)
    document = verification_document(verified(made(time, reference, reference)), "made", "0")
    [band, *_] = document["blocks"][0]["bands"]
    assert {"low_hz", "high_hz", "gain", "lag_s", "phase_deg", "coherence", "error_rms_n"} <= band.keys()


def test_a_triangle_s_own_harmonics_are_no_distortion_of_the_force():
    run = ehls.simulate("triangle_fd2", duration=20.0, progress=False)
    one = only(run)
    assert one.distortion.reference_percent == pytest.approx(12.0, abs=0.3)
    assert one.distortion.measured_percent == pytest.approx(one.distortion.reference_percent, abs=0.2)


@pytest.mark.parametrize("signal", ["force_n", "force_reference_n"])
def test_a_missing_signal_is_named(signal):
    time = np.arange(0.0, 5.0, 1e-3)
    signals = {"force_n": sine(time), "force_reference_n": sine(time), signal: np.full(time.size, np.nan)}
    with pytest.raises(BadInput, match=f"made: there is no {signal}"):
        verified(Trajectory(time, signals))


def test_a_simulated_recording_is_verified_and_its_document_has_units():
    run = ehls.simulate("measured_sine_fd1", duration=12.0, progress=False)
    result = ehls.verify(run, inertia_mass=10.0, cell_uncertainty=0.5)
    assert isinstance(result.blocks[0].found, Cyclic)
    table = result.to_pandas().set_index("quantity")
    error = run["force_n"] - run["force_reference_n"]
    assert abs(table.loc["amplitude", "error"]) < np.abs(error[len(error) // 2 :]).max()
    assert "certifies nothing" in result.sentence
    document = json.loads(json.dumps(verification_document(result, "run", "0")))
    [block] = document["blocks"]
    assert "certifies nothing" in document["certifies_nothing"]
    assert block["amplitude"]["reference_n"] == pytest.approx(1e4)
    assert block["amplitude"]["type_b_cell_n"] == pytest.approx(25.0, rel=1e-3)
    assert {"error_deg", "expanded_uncertainty_deg"} <= block["phase"].keys()
    assert block["inertia"].keys() & {"refused", "force_n"}
