"""Causes named despite a remainder, which is counted as correlated noise."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from plain_evidence import MASS, VALVE, VISCOUS, candidate, evidence_of, linear_fit, nothing

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.acceptance import accepted
from ehls_ros.diagnosis.allowance import Allowance
from ehls_ros.diagnosis.causes import causes
from ehls_ros.diagnosis.evidence import Residuals
from ehls_ros.diagnosis.held_out import Assessment, HeldOut
from ehls_ros.diagnosis.loss import closed, power
from ehls_ros.diagnosis.measurement import BesideForm, BeyondMeasurement
from ehls_ros.diagnosis.partial import corrects_value, worthwhile, wrong
from ehls_ros.diagnosis.remainder import remainder_as_noise
from ehls_ros.diagnosis.search import Place, Searched, inflations

WINDOWS = 4000
STRIBECK = candidate("stribeck_shift", "static_offset")


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def autoregressive(rng, factor, count):
    """Return noise of variance 1 whose successive values have this correlation."""
    e = rng.standard_normal(count) * np.sqrt(1.0 - factor**2)
    for i in range(1, count):
        e[i] += factor * e[i - 1]
    return e


def test_what_remains_is_counted_as_noise_and_nothing_else_changes(rng):
    e = 5.0 * autoregressive(rng, 0.8, WINDOWS)
    evidence = evidence_of({"force": 3.0 * e, "volume": rng.standard_normal(WINDOWS)})
    known = remainder_as_noise(evidence, {"force": e, "volume": evidence.noise["volume"]})
    # 5 beside noise of 1.
    assert power(e * evidence.floor["force"] / known.floor["force"]) == pytest.approx(1.0, abs=0.05)
    assert np.array_equal(known.floor["volume"], evidence.floor["volume"])
    for c in evidence.channels:
        for values, before in ((known.base.values, evidence.base.values), (known.noise, evidence.noise)):
            assert np.allclose(values[c] * known.floor[c], before[c] * evidence.floor[c])


@pytest.mark.parametrize("windows", [1000, 4000])
def test_an_error_of_form_tells_no_more_in_a_longer_recording(rng, windows):
    form = 5.0 * np.sin(np.arange(windows) / 9.0)
    evidence = evidence_of({"force": form, "volume": np.zeros(windows)})
    known = remainder_as_noise(evidence, {"force": form, "volume": np.zeros(windows)})
    # Of the mean square, 1 is noise.
    independent = windows / known.correlation["force"]
    assert independent == pytest.approx(rules.FORM_FREEDOMS * 12.5 / 11.5, rel=0.05)
    assert known.correlation["volume"] == 1.0


def test_without_noise_and_remainder_no_window_depends_on_another():
    still = {"force": np.zeros(500)}
    evidence = evidence_of(still, noise=still)
    evidence = replace(evidence, allowances={"force": Allowance(still["force"], np.ones((500, 1)), still["force"])})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        known = remainder_as_noise(evidence, still)
    assert known.correlation == {"force": 1.0}
    assert np.all(np.isfinite(known.base.values["force"]))


def test_the_fraction_closed_is_of_what_noise_does_not_explain(rng):
    shape = np.sin(np.arange(WINDOWS) / 9.0)
    form = autoregressive(rng, 0.9, WINDOWS)
    evidence = evidence_of({"force": 6.0 * shape + 2.0 * form + rng.standard_normal(WINDOWS)})
    best = linear_fit(evidence, (MASS,), shape[:, None])
    # The mean squares of shape and form, of which the first is gone.
    before, after = evidence.base.values["force"], best.held_out.residuals.values["force"]
    assert closed(before, after, evidence.noise["force"]) == pytest.approx(18.0 / 22.0, abs=0.03)
    assert worthwhile(evidence, best)


def test_what_closes_too_little_or_leaves_too_much_is_not_worth_a_name(rng):
    shape, form = np.sin(np.arange(WINDOWS) / 9.0), autoregressive(rng, 0.9, WINDOWS)
    little = evidence_of({"force": 2.0 * shape + 2.0 * form})
    assert not worthwhile(little, linear_fit(little, (MASS,), shape[:, None]))
    # The largest term of the balance is 100.
    large = evidence_of({"force": 60.0 * shape + 20.0 * form})
    assert not worthwhile(large, linear_fit(large, (MASS,), shape[:, None]))


def test_what_only_fits_the_form_of_the_remainder_is_not_a_cause(rng):
    shape = np.sin(np.arange(WINDOWS) / 9.0)
    form = autoregressive(rng, 0.98, WINDOWS)
    # It resembles the remainder a little, as any slow signal does.
    resembling = form + 2.0 * autoregressive(rng, 0.98, WINDOWS)
    evidence = evidence_of({"force": 60.0 * shape + 20.0 * form + rng.standard_normal(WINDOWS)})

    def judged(evidence):
        less = linear_fit(evidence, (MASS,), shape[:, None] / evidence.floor["force"][:, None])
        more = linear_fit(evidence, (MASS, VISCOUS), np.column_stack([shape, resembling]) / evidence.floor["force"][:, None])
        none = nothing(evidence)
        scale = inflations(evidence, [less, more])
        return accepted(evidence, less, none, scale), accepted(evidence, more, less, scale), less

    first, second, less = judged(evidence)
    assert (first, second) == (True, True)
    beside = replace(remainder_as_noise(evidence, less.held_out.residuals.values), standard=BesideForm())
    first, second, _ = judged(beside)
    assert (first, second) == (True, False)


@pytest.mark.parametrize("floor", [1.0, 10.0], ids=["of the noise", "far above the noise"])
def test_shares_are_those_of_the_removable_error(rng, floor):
    one, other = np.sin(np.arange(WINDOWS) / 9.0), np.sin(np.arange(WINDOWS) / 2.0)
    noise = rng.standard_normal(WINDOWS)
    evidence = evidence_of({"force": (6.0 * one + 4.0 * other + noise) / floor}, {"force": noise / floor})
    best = linear_fit(evidence, (MASS, VISCOUS), np.column_stack([one, other]))
    without = (linear_fit(evidence, (VISCOUS,), other[:, None]), linear_fit(evidence, (MASS,), one[:, None]))
    found = Searched(best, tuple(Place(j, ()) for j in without), (), {"force": 1.0})
    shares = {cause.name: cause.share for cause in causes(evidence, found, 0)}
    # Mean squares of 18 and 8.
    assert shares == pytest.approx({"mass_shift": 18.0 / 26.0, "viscous_shift": 8.0 / 26.0}, abs=0.02)


def test_causes_that_come_last_do_so_whatever_they_gain(rng):
    one, other = np.sin(np.arange(WINDOWS) / 9.0), np.sin(np.arange(WINDOWS) / 2.0)
    evidence = evidence_of({"force": 6.0 * one + 4.0 * other + rng.standard_normal(WINDOWS)})
    best = linear_fit(evidence, (MASS, VISCOUS), np.column_stack([one, other]))
    without = (linear_fit(evidence, (VISCOUS,), other[:, None]), linear_fit(evidence, (MASS,), one[:, None]))
    found = Searched(best, tuple(Place(j, ()) for j in without), (), {"force": 1.0})
    assert [c.name for c in causes(evidence, found, 0)] == ["mass_shift", "viscous_shift"]
    assert [c.name for c in causes(evidence, found, 0, last=("mass_shift",))] == ["viscous_shift", "mass_shift"]


@pytest.mark.parametrize(("size", "left", "named"), [(2.0, 1.0, False), (8.0, 4.0, True), (2.0, 0.0, True)])
def test_a_further_cause_must_close_what_is_there_or_exceed_what_the_form_of_a_model_is_off_by(rng, size, left, named):
    one, other, third = (np.sin(np.arange(WINDOWS) / samples) for samples in (9.0, 2.0, 4.0))
    noise = {c: rng.standard_normal(WINDOWS) for c in ("force", "spool")}
    # In units of the noise; the largest term is 100.
    evidence = evidence_of({"force": 20.0 * one + noise["force"], "spool": size * other + left * third + noise["spool"]})
    less = linear_fit(evidence, (MASS,), one[:, None])
    alone = linear_fit(evidence, (VALVE,), other[:, None], "spool")
    more = both(less, alone)
    for standard, expected in ((BeyondMeasurement(), True), (BesideForm(rules.RELEVANT), named)):
        known = replace(evidence, standard=standard)
        assert accepted(known, more, less, inflations(known, [more])) is expected
        assert accepted(known, alone, nothing(known), inflations(known, [alone]))
    first = replace(evidence, standard=BesideForm())
    assert accepted(first, alone, nothing(first), inflations(first, [alone])) is named


@pytest.mark.parametrize(
    ("name", "corrects"), [("mass_shift", True), ("viscous_asymmetry", False), ("position_sensor_gain", False)]
)
def test_values_of_the_rig_file_are_neither_what_it_lacks_nor_the_sensors(name, corrects):
    assert corrects_value(name) is corrects


def test_values_are_wrong_that_change_a_balance_by_more_than_an_error_of_form(rng):
    one, other = np.sin(np.arange(WINDOWS) / 9.0), np.sin(np.arange(WINDOWS) / 2.0)
    # The largest term of the balance is 100.
    evidence = evidence_of({"force": -12.0 * one + 2.0 * other + rng.standard_normal(WINDOWS)})
    fit = linear_fit(evidence, (VISCOUS, STRIBECK), np.column_stack([one, other])).fit
    assert wrong(evidence, fit) == ["viscous_shift"]


def both(one, other):
    """Return two hypotheses that act in different channels together."""
    residuals, held_out = (
        Residuals({"force": a.values["force"], "spool": b.values["spool"]})
        for a, b in ((one.fit.residuals, other.fit.residuals), (one.held_out.residuals, other.held_out.residuals))
    )
    rows = [len(a.residuals.values[c]) for a, c in ((one.fit, "force"), (other.fit, "spool"))]
    jacobian = np.zeros((sum(rows), 2))
    jacobian[: rows[0], :1], jacobian[rows[0] :, 1:] = one.fit.jacobian, other.fit.jacobian
    covariance = np.diag([one.held_out.covariance[0, 0], other.held_out.covariance[0, 0]])
    fit = one.fit._replace(
        hypothesis=(*one.hypothesis, *other.hypothesis),
        values=np.concatenate([one.fit.values, other.fit.values]),
        channels=("force", "spool"),
        residuals=residuals,
        jacobian=jacobian,
    )
    return Assessment(fit, HeldOut({**one.held_out.gain, **other.held_out.gain}, held_out, covariance, 0.0))
