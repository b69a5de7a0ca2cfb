"""Tolerances of a recording: skew within a sample and small offsets are not blamed on any cause, larger ones are."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from plain_evidence import MASS, assessed, candidate, evidence_of
from scipy.ndimage import shift

from ehls_ros.diagnosis import excitation, rules
from ehls_ros.diagnosis.allowance import Allowance, together
from ehls_ros.diagnosis.evidence import Evidence, Residuals, Standard, allowing
from ehls_ros.diagnosis.fit import Fit
from ehls_ros.diagnosis.measurement import BEYOND_MEASUREMENT
from ehls_ros.diagnosis.partial import remainder_as_noise
from ehls_ros.diagnosis.remainder import with_allowances
from ehls_ros.diagnosis.search import Place, Searched

WINDOWS = 600
SHAPE = np.sin(np.arange(WINDOWS) / 30.0)
UNIT = SHAPE / np.linalg.norm(SHAPE)
NEEDED = max(excitation.needed_sigmas(rules.NEEDED_GAIN), rules.SHOWN * math.sqrt(WINDOWS))
"""Size of a change along it that shows: certain, and comparable with the noise."""


def allowance(size=40.0, most=rules.MAX_ALLOWED):
    """Return an allowance of a size along one direction, in units of the noise."""
    return Allowance(np.zeros(WINDOWS), size * UNIT[:, None], np.zeros(WINDOWS), most=most)


@dataclass(frozen=True)
class Linear(Evidence):
    """Evidence whose residuals are linear in one parameter, which stands for the rig."""

    column: np.ndarray = field(default_factory=lambda: np.zeros(WINDOWS))

    def comparison(self):
        return None

    def residuals(self, comparison, rig, known=None):
        return Residuals({"force": self.allowed["force"].whitened(rig * self.column)})


def beyond(e, given):
    return allowing(evidence_of({"force": e}), {"force": given}, lambda evidence: evidence)


# ---------------------------------------------------------------------------------------------------------- plain arrays


@pytest.mark.parametrize("size", [0.0, 2.9, -2.9, 3.1, -50.0])
def test_what_the_whitening_takes_off_is_found_again(size):
    e = np.random.default_rng(1).standard_normal(WINDOWS)
    e += (size * 40.0 - e @ UNIT) * UNIT
    allowed = allowance().whitening(np.ones(WINDOWS))
    np.testing.assert_allclose(allowed.whole(allowed.whitened(e)), e, atol=1e-9)
    # Within the bounds the size counts in prior standard deviations; the part that is not allowed for is unaffected.
    counted = math.copysign(min(abs(size), 3.0) + rules.EDGE * max(abs(size) - 3.0, 0.0), size)
    assert allowed.whitened(e) @ UNIT == pytest.approx(counted, rel=2e-2)
    np.testing.assert_allclose(allowed.whitened(e) - (allowed.whitened(e) @ UNIT) * UNIT, e - (e @ UNIT) * UNIT, atol=1e-9)


def test_outside_the_allowed_directions_a_residual_is_the_same_before_and_after_whitening():
    e = np.random.default_rng(1).standard_normal(WINDOWS) + 90.0 * UNIT
    allowed = allowance().whitening(np.ones(WINDOWS))
    outside = allowed.outside(e)
    assert outside @ UNIT == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(outside, allowed.outside(allowed.whitened(e)), atol=1e-9)
    np.testing.assert_allclose(allowed.outside(np.column_stack([e, UNIT])), np.column_stack([outside, 0.0 * e]), atol=1e-9)


@pytest.mark.parametrize(("size", "left"), [(2.9, 0.0), (-2.9, 0.0), (5.0, 2.0), (-50.0, -47.0)])
def test_a_change_counts_in_full_beyond_the_bounds(size, left):
    known = beyond(np.zeros(WINDOWS), allowance())
    apart = BEYOND_MEASUREMENT.counted(known, "force", size * 40.0 * UNIT)
    np.testing.assert_allclose(apart, left * 40.0 * UNIT, atol=0.1 * np.max(UNIT))


def test_a_size_that_measurement_errors_may_have_is_not_said_to_show(monkeypatch):
    column = 4.0 * UNIT  # change of the residuals per N
    known = Linear(**vars(beyond(np.zeros(WINDOWS), allowance())), column=column)
    monkeypatch.setattr(excitation, "extended", lambda rig, hypothesis, values: float(values[0]))
    force = candidate("constant_load", "force")
    slope = known.residuals(None, 1.0).values["force"][:, None]
    fit = Fit((force,), np.zeros(1), ("force",), known.base, slope, 0.0, np.ones(1))
    (found,) = excitation.sensitivities(replace(known, standard=BEYOND_MEASUREMENT), [fit], {})
    # Three prior standard deviations of 10 N each, and what shows beyond them.
    beyond_them = excitation.needed_sigmas(rules.NEEDED_GAIN) / (4.0 * rules.EDGE / math.hypot(40.0, 1.0))
    assert 30.0 < found.smallest < 1.3 * (30.0 + beyond_them)
    # Without bounds, and where what is allowed counts too, the size is that of a linear model.
    unbounded = Linear(**vars(beyond(np.zeros(WINDOWS), allowance(most=math.inf))), column=column)
    (alone,) = excitation.sensitivities(replace(unbounded, standard=Standard()), [fit], {})
    linear = excitation.needed_sigmas(rules.NEEDED_GAIN) / np.linalg.norm(slope)
    assert linear <= alone.smallest <= excitation.GROWTH * linear


@dataclass(frozen=True)
class Grown(Evidence):
    """Evidence whose residuals grow like a power of one parameter, which stands for the rig."""

    power: float = 1.0

    def comparison(self):
        return None

    def residuals(self, comparison, rig, known=None):
        return Residuals({"force": 2.0 * rig**self.power * UNIT})


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("start", [0.01, 5.0])
def test_the_size_of_an_effect_that_is_not_smooth_is_sought(monkeypatch, power, start):
    monkeypatch.setattr(excitation, "extended", lambda rig, hypothesis, values: float(values[0]))
    known = Grown(**vars(evidence_of({"force": np.zeros(WINDOWS)})), power=power)
    gap = candidate("hinge_backlash", "gap", lower=0.0)
    fit = Fit((gap,), np.array([start]), ("force",), known.residuals(None, start), np.ones((WINDOWS, 1)), 0.0, np.ones(1))
    (found,) = excitation.sensitivities(known, [fit], {})
    assert found.smallest == pytest.approx((NEEDED / 2.0) ** (1.0 / power), rel=0.25)


def test_each_parameter_of_an_effect_without_a_simpler_form_has_a_smallest_size(monkeypatch):
    monkeypatch.setattr(excitation, "extended", lambda rig, hypothesis, values: float(values @ [1.0, 2.0, 0.0]))
    known = Grown(**vars(evidence_of({"force": np.zeros(WINDOWS)})))
    gains = candidate("valve_gain_asymmetry", "command_positive", "command_negative", "unused")
    slopes = np.column_stack([2.0 * UNIT, 4.0 * UNIT, np.zeros(WINDOWS)])
    fit = Fit((gains,), np.zeros(3), ("force",), known.base, slopes, 0.0, np.full(3, 1e-3))
    positive, negative = excitation.sensitivities(known, [fit], {})
    assert (positive.parameter, negative.parameter) == ("command_positive", "command_negative")
    assert positive.smallest == pytest.approx(2.0 * negative.smallest)
    assert positive.smallest == pytest.approx(NEEDED / 2.0)


def test_an_effect_that_shrinks_as_its_parameter_grows_has_no_size(monkeypatch):
    monkeypatch.setattr(excitation, "extended", lambda rig, hypothesis, values: float(values[0]))
    known = Grown(**vars(evidence_of({"force": np.zeros(WINDOWS)})), power=-1.0)
    valve = candidate("valve_second_order", "natural_frequency", lower=0.0, upper=10.0)
    fit = Fit((valve,), np.array([5.0]), ("force",), known.residuals(None, 5.0), np.ones((WINDOWS, 1)), 0.0, np.ones(1))
    assert excitation.sensitivities(known, [fit], {}) == ()


def test_independent_allowances_add_their_variances_and_are_bounded_only_together():
    both = together([allowance(30.0), allowance(40.0)])
    np.testing.assert_allclose(both.whitening(np.ones(WINDOWS)).deviations, [math.hypot(50.0, 1.0)], rtol=1e-9)
    assert both.most == rules.MAX_ALLOWED
    assert together([allowance(), allowance(most=math.inf)]).most == math.inf


def test_allowances_stay_what_they_are_when_a_remainder_counts_as_noise():
    rng = np.random.default_rng(2)
    e = 5.0 * rng.standard_normal(WINDOWS) + 80.0 * UNIT
    known = remainder_as_noise(judged := beyond(e, allowance()), judged.base.values)
    np.testing.assert_allclose(known.whole("force", known.base.values["force"]) * known.floor["force"], e, atol=1e-9)
    # Two prior standard deviations, with noise as large as counted now and equal over as many windows.
    expected = e @ UNIT / math.hypot(40.0 / math.sqrt(known.correlation["force"]), known.floor["force"][0])
    assert known.base.values["force"] @ UNIT == pytest.approx(expected, rel=1e-6)


def test_what_is_wrong_without_a_named_cause_counts_in_full():
    noise = np.random.default_rng(3).standard_normal(WINDOWS)
    noise -= (noise @ UNIT) * UNIT
    judged = beyond(noise + 320.0 * UNIT, allowance())
    # The cause accounts for 280, and a skew for the rest.
    left = judged.allowed["force"].whitened(noise + 40.0 * UNIT)
    best = assessed((MASS,), {"force": left}, [1.0])
    seen, told = with_allowances(
        judged, Searched(best, (Place(assessed((), {"force": judged.base.values["force"]}), ()),), (), {})
    )
    assert seen.base.values["force"] @ UNIT == pytest.approx(281.0, abs=0.1)
    np.testing.assert_array_equal(told.places[0].without.held_out.residuals.values["force"], seen.base.values["force"])
    np.testing.assert_array_equal(told.best.held_out.residuals.values["force"], left)


# ------------------------------------------------------------------------------------------------------------ recordings


def skewed(r, **samples):
    """Return a recording in which some columns are late by numbers of samples, early where negative."""
    columns = {name: values.copy() for name, values in r.columns.items()}
    for name, late in samples.items():
        columns[name] = shift(columns[name], late, order=5, mode="nearest")
    return r.__class__(r.time, columns, r.truth)


@pytest.mark.long
def test_a_disturbance_recorded_half_a_sample_early_is_no_cause(recorded, diagnosed):
    d = diagnosed(skewed(recorded({}, "rich", seed=301, duration=8.0), disturbance_force_n=-0.5))
    assert (d.verdict, d.causes) == ("consistent", ())
    (said,) = [remark for remark in d.remarks if remark.startswith("allowed for")]
    assert "up to a sample (1 ms)" in said
    assert "in the force balance" in said


@pytest.mark.long
def test_a_delay_of_three_samples_is_a_fault_beside_a_skew(recorded, diagnosed):
    hidden = {"sensor_delay": {"delay": 3.4e-3, "signals": "position"}}
    d = diagnosed(skewed(recorded(hidden, "random", seed=101, duration=8.0), load_pressure_pa=0.5))
    assert [c.name for c in d.causes] == ["sensor_delay"]
    # A skew may have contributed to the delay.
    assert d.causes[0].parameters["position"].value == pytest.approx(3.4e-3, abs=0.6e-3)
    assert d.gain.closed_fraction > 0.9
