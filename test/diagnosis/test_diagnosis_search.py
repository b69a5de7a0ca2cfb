"""The search's steps: hypotheses, spectral lines, acceptance of a further cause, exchanges, threads."""

import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from plain_evidence import MASS, SIZE, VISCOUS, assessed, candidate, evidence_of, linear_fit, nothing

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis import search as searching
from ehls_ros.diagnosis import starts as begun
from ehls_ros.diagnosis.acceptance import (
    accepted,
    corrects_form,
    differences,
    explains,
    gain_ratio,
    is_new,
    mostly_in,
    recurs,
    relevance,
    shows,
)
from ehls_ros.diagnosis.diagnose import remarks_on_baselines
from ehls_ros.diagnosis.evidence import Residuals, Standard
from ehls_ros.diagnosis.fit import Fit
from ehls_ros.diagnosis.healthy_variation import HealthyVariation
from ehls_ros.diagnosis.hypotheses import at_lines, bounds, candidates, extended, parts
from ehls_ros.diagnosis.measurement import BesideForm
from ehls_ros.diagnosis.pool import Pool, informative_blocks
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.search import Place, simpler
from ehls_ros.diagnosis.starts import LINE_SAMPLES, Starts, Tried, beside_load, combined, main_channel, spectral_lines
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import EffectUse
from ehls_ros.trajectory import Trajectory

FORCE = {"force": 1.0}


def use(name, **values):
    return EffectUse(name, EFFECTS.load(name).Parameters(**values))


@pytest.fixture
def noisy(rig, recorded):
    """Return a short recording of the truth."""
    r = recorded({}, "rich", seed=11, duration=3.0)
    return prepare(Trajectory(r.time, r.columns), rig, "noisy")


# ---------------------------------------------------------------------------------------------------------- hypotheses


def test_every_form_of_every_effect_is_tried(noisy, rig):
    signals = noisy.signals | {"disturbance_displacement_m": np.zeros(len(noisy.time))}
    found, out = candidates(noisy._replace(signals=signals), rig, [3.0, 5.0, 7.0])
    assert not out
    asked = {(c.name, c.number) for c in found}
    assert asked == {(n, i) for n in EFFECTS.names() for i in range(len(EFFECTS.load(n).forms(rig)))}
    assert {c.name for c in found if c.parts_mass} == {"flexible_mode", "hinge_backlash"}
    for c in found:
        assert len(c.free) >= 1
        assert c.starts.shape[1] == len(c.free) == len(c.units) == len(c.neutral)
        assert np.all(c.starts >= c.lower)
        assert np.all(c.starts <= c.upper)
        # A value beyond its range is clipped to the range.
        for beyond in (c.lower - 1.0, c.upper + 1.0):
            extended(rig, (c,), np.nan_to_num(beyond, posinf=1e30, neginf=-1e30))


def test_what_the_data_cannot_tell_is_not_tried(noisy, rig):
    found, out = candidates(noisy, rig, [])
    assert set(out) == {"coupling_stiffness"}
    assert "disturbance_displacement_m" in out["coupling_stiffness"]
    fewer = {n: a for n, a in noisy.signals.items() if n != "oil_temperature_k"}
    found, out = candidates(noisy._replace(signals=fewer), rig, [])
    assert set(out) == {"coupling_stiffness", "temperature_dependent_friction"}
    assert not {c.name for c in found} & set(out)
    found, out = candidates(noisy, rig.with_effects((use("flexible_mode", frequency=12.0, mass=20.0),)), [])
    assert "flexible_mode" in out
    assert "flexible_mode" not in {c.name for c in found}


def test_an_effect_of_the_rig_may_grow_or_shrink_within_its_range(noisy, rig):
    lapped = rig.with_effects((use("valve_dead_zone", positive=1e-4, negative=2e-4), use("coulomb_shift", offset=10.0)))
    found, out = candidates(noisy, lapped, [])
    assert {"valve_dead_zone", "coulomb_shift"} <= {c.name for c in found}
    assert not {"valve_dead_zone", "coulomb_shift"} & set(out)
    biased = rig.with_effects((use("valve_null_bias", command=2e-5, opening=1e-6),))
    found, out = candidates(noisy, biased, [])
    bias = next(c for c in found if c.name == "valve_null_bias" and c.free == ("command",))
    assert (bias.lower[0], bias.upper[0]) == (pytest.approx(-1e-2 - 2e-5), pytest.approx(1e-2 - 2e-5))
    (grown,) = extended(biased, (bias,), np.array([3e-6])).effects
    assert grown.parameters == (pytest.approx(2.3e-5), 1e-6)


def test_only_effects_with_a_frequency_start_at_other_lines(noisy, rig):
    found, _ = candidates(noisy, rig, [11.0, 12.0, 13.0])
    again = at_lines(found, noisy, rig, [3.5, 7.5, 0.5])
    assert {c.name for c in again} == {"periodic_disturbance", "flexible_mode"}
    for c in again:
        assert set(c.starts[:, c.free.index("frequency")]) == {3.5, 7.5}
    assert at_lines(found, noisy, rig, []) == []


def test_a_line_is_sought_only_where_the_windows_can_show_it(noisy, rig):
    highest = {c.name: c.upper[c.free.index("frequency")] for c in candidates(noisy, rig, (5.0,))[0] if "frequency" in c.free}
    assert highest["periodic_disturbance"] == rules.LINE_PERIODS / rules.WINDOW
    assert highest["flexible_mode"] > highest["periodic_disturbance"]


def test_parameters_of_several_causes_are_joined_in_order(rig):
    both = (
        candidate("stribeck_shift", "static_offset", "velocity_factor", lower=-5.0),
        candidate("mass_shift", "factor", upper=7.0),
    )
    assert parts(both) == [slice(0, 2), slice(2, 3)]
    lower, upper = bounds(both)
    np.testing.assert_array_equal(lower, [-5.0, -5.0, -np.inf])
    np.testing.assert_array_equal(upper, [np.inf, np.inf, 7.0])
    effects = extended(rig, both, np.array([10.0, 2.0, 9.0])).effects
    assert effects == (use("stribeck_shift", static_offset=10.0, velocity_factor=2.0), use("mass_shift", factor=7.0))
    assert bounds(())[0].size == 0


# ------------------------------------------------------------------------------------------------------- spectral lines


def test_spectral_lines_are_found_strongest_first():
    t = 0.0133 * np.arange(1500)
    e = 3.0 * np.sin(2 * np.pi * 7.3 * t) + np.sin(2 * np.pi * 2.1 * t) + np.random.default_rng(4).standard_normal(len(t))
    first, second = spectral_lines(e, t, 2)
    assert first == pytest.approx(7.3, abs=0.02)
    assert second == pytest.approx(2.1, abs=0.03)


def test_few_windows_have_no_lines():
    t = 0.01 * np.arange(LINE_SAMPLES - 1)
    assert spectral_lines(np.sin(t), t) == ()


@pytest.mark.parametrize(("frequency", "left"), [(1.0, (1.968, 2.5)), (0.105, (1.968, 2.5, 3.01))], ids=["fast", "slow"])
def test_lines_in_step_with_a_sinusoidal_load_are_left_out(frequency, left):
    # High multiples of a slow load's frequency lie everywhere.
    t = 0.0137 * np.arange(4400)
    assert beside_load((frequency, 1.968, 2.5, 3.01), 20.0 + np.sin(2 * np.pi * frequency * t), t) == left


def test_of_a_random_load_only_its_own_lines_are_left_out():
    t = 0.0137 * np.arange(4400)
    load = sum(np.sin(2 * np.pi * f * t + f) for f in (0.31, 0.83, 1.77))
    assert beside_load((0.62, 0.83, 1.24), load, t) == (0.62, 1.24)


def test_lines_are_sought_in_the_force_balance_if_there_is_one():
    assert main_channel(("spool", "force")) == "force"
    assert main_channel(("spool", "volume")) == "spool"


# ---------------------------------------------------------------------------------------------------------- acceptance


def with_and_without(rng, size, n=720):
    """Return evidence of an effect of some size in units of the noise, with the fit that has it and the given model."""
    column = rng.standard_normal((n, 1))
    evidence = evidence_of({"force": rng.standard_normal(n) + size * column[:, 0]})
    return evidence, linear_fit(evidence, (VISCOUS,), column), nothing(evidence)


@pytest.mark.parametrize(("size", "taken"), [(0.0, False), (0.05, False), (0.45, False), (0.8, True), (3.0, True)])
def test_a_cause_that_gains_and_shows_is_accepted(size, taken):
    evidence, more, less = with_and_without(np.random.default_rng(3), size)
    assert accepted(evidence, more, less, FORCE) is taken


@pytest.mark.parametrize(("beyond", "taken"), [(-0.5, False), (0.5, True)])
def test_a_sure_cause_with_too_little_gain_is_not_accepted(beyond, taken):
    evidence = evidence_of({"force": np.full(240, 1.5)})
    gain = rules.NEEDED_GAIN + rules.PENALTY + beyond
    more = assessed((VISCOUS,), {"force": np.full(240, 0.5)}, [1.0], {"force": np.full(12, gain / 12.0)}, 1e-6 * np.eye(1))
    assert accepted(evidence, more, nothing(evidence), FORCE) is taken


@pytest.mark.parametrize(("scatter", "beside", "baselines", "taken"), [
    (0.2, False, False, True), (4.0, False, False, False), (0.2, True, False, False), (0.2, True, True, True),
])  # fmt: skip
def test_a_cause_of_vague_size_is_sure_if_every_block_gains(scatter, beside, baselines, taken):
    evidence = evidence_of({"force": np.full(240, 3.0)})
    if baselines:
        evidence = replace(evidence, standard=HealthyVariation({}))
    each = 10.0 * (1.0 + scatter * np.tile([1.0, -1.0], 6))
    left, first = {"force": np.full(240, 0.5)}, (candidate("coulomb_shift", "offset"),) if beside else ()
    more = assessed((*first, VISCOUS), left, [1.0] * (1 + beside), {"force": each}, np.eye(1 + beside))
    # Beside another cause, the remainder of that one's form gains steadily, too.
    less = assessed(first, evidence.base.values, [1.0], {"force": np.zeros(12)}, np.eye(1)) if beside else nothing(evidence)
    assert explains(evidence, more, less, FORCE) is taken


@pytest.mark.parametrize(("size", "beside_form", "taken"), [(0.8, False, False), (3.0, False, True), (3.0, True, False)])
def test_a_large_gain_that_matters_to_nobody_is_accepted_only_if_it_stands_clear_of_the_noise(size, beside_form, taken):
    evidence, more, less = with_and_without(np.random.default_rng(3), size)
    evidence = replace(evidence, standard=HealthyVariation({}) if beside_form else Standard())
    # The balance's largest term is so large that the difference is irrelevant.
    evidence.sizes["force"] = 2.0 * size / rules.RELEVANT
    assert accepted(evidence, more, less, FORCE) is taken


@pytest.mark.parametrize(("error", "taken"), [(0.9, True), (1.1, False)])
def test_a_change_as_large_as_the_errors_of_form_is_not_accepted(error, taken):
    class BesideErrors(Standard):
        def form_error(self, channel):
            return error * change

    evidence, more, less = with_and_without(np.random.default_rng(3), 3.0)
    change = relevance(evidence, differences(evidence, more, less))
    assert accepted(replace(evidence, standard=BesideErrors()), more, less, FORCE) is taken


def test_a_gain_from_averaging_noise_is_not_accepted():
    evidence, more, less = with_and_without(np.random.default_rng(3), 3.0)
    gain = more.score(FORCE) - less.score(FORCE)
    for averaged, taken in ((0.9 * gain, True), (1.1 * gain, False)):
        averaging = more._replace(held_out=more.held_out._replace(averaged=averaged))
        assert accepted(evidence, averaging, less, FORCE) is taken


def test_an_unsure_parameter_is_not_accepted():
    evidence, more, less = with_and_without(np.random.default_rng(3), 3.0)
    for sigmas, taken in ((rules.MIN_SIGMAS + 0.1, True), (rules.MIN_SIGMAS - 0.1, False)):
        covariance = np.array([[(more.fit.values[0] / sigmas) ** 2]])
        gain = np.mean(more.held_out.gain["force"]) * (1.0 + 4.0 * np.resize([1.0, -1.0], evidence.blocks))
        vague = more._replace(held_out=more.held_out._replace(covariance=covariance, gain={"force": gain}))
        assert accepted(evidence, vague, less, FORCE) is taken


def test_what_removes_little_of_a_large_excess_is_not_accepted():
    rng = np.random.default_rng(3)
    column, other = rng.standard_normal((720, 1)), 30.0 * rng.standard_normal(720)
    evidence = evidence_of({"force": other + 3.0 * column[:, 0]})
    more = linear_fit(evidence, (VISCOUS,), column)
    sure = more._replace(held_out=more.held_out._replace(covariance=1e-6 * np.eye(1)))
    assert more.score(FORCE) > rules.NEEDED_GAIN
    assert sure.excess(evidence, "force") * rules.REMOVED_EXCESS > sure.score(FORCE)
    assert not accepted(evidence, sure, nothing(evidence), FORCE)


@pytest.mark.parametrize(("size", "shown"), [(0.9, False), (1.1, True)])
def test_a_difference_much_smaller_than_the_noise_does_not_show(size, shown):
    assert shows([np.zeros(9), np.full(9, size * rules.SHOWN)]) is shown


@pytest.mark.parametrize(
    ("change", "expected"),
    [(np.full(1000, 0.3), 0.3), (np.where(np.arange(1000) < 20, 10.0, 0.0), 10.0 / rules.RARE_FACTOR)],
    ids=["everywhere", "seldom"],
)
def test_relevance_is_the_change_of_the_balance_and_rare_events_count(change, expected):
    assert relevance(evidence_of({"force": np.zeros(1000)}), {"force": change}) == pytest.approx(expected / SIZE)


def test_a_fitted_change_earns_all_it_could_and_reshuffled_noise_little():
    rng = np.random.default_rng(8)
    column, noise = rng.standard_normal((720, 1)), 0.3 * rng.standard_normal(720)
    evidence = evidence_of({"force": noise + 0.5 * column[:, 0]})
    assert gain_ratio(evidence, linear_fit(evidence, (VISCOUS,), column), nothing(evidence)) == pytest.approx(1.0)
    noisy = evidence_of({"force": 5.0 * noise})
    moved = assessed((MASS,), {"force": 5.0 * np.roll(noise, 1)}, [1.0])
    assert abs(gain_ratio(noisy, moved, nothing(noisy))) < rules.MIN_GAIN_RATIO
    assert gain_ratio(noisy, nothing(noisy), nothing(noisy)) == 0.0


@pytest.mark.parametrize(("seen", "new"), [(True, True), (False, False)])
def test_what_the_baselines_allow_as_well_is_no_change(seen, new):
    column = np.random.default_rng(9).standard_normal(400)

    class Healthy:
        """A baseline in which a heavier mass shows, or not."""

        base = Residuals({"force": np.zeros(400)})
        rig = SimpleNamespace(effects=(), with_effects=lambda uses: uses)

        def comparison(self):
            return None

        def residuals(self, comparison, uses):
            ((name, parameters),) = [(use.name, use.parameters) for use in uses]
            assert name == "mass_shift"
            return Residuals({"force": 10.0 * seen * (parameters.factor - 1.0) * column})

    evidence = replace(evidence_of({"force": column}), standard=HealthyVariation({}, (Healthy(), Healthy())))
    alone, beside = (assessed((*names, MASS), {"force": column}, [0.2] * len(names) + [1.2]) for names in ((), (VISCOUS,)))
    assert is_new(evidence, alone, nothing(evidence), {"force": 2.0}) is new
    assert is_new(evidence, beside, assessed((VISCOUS,), {"force": column}, [0.2]), {"force": 2.0}) is new


@pytest.mark.parametrize(("size", "said"), [(0.45, False), (3.0, True)])
def test_a_cause_that_the_baselines_allow_as_well_is_said(size, said):
    evidence, more, less = with_and_without(np.random.default_rng(3), size)
    found = searching.explaining(evidence, less, [more], FORCE)
    assert found is (more if said else None)
    remarks = remarks_on_baselines(found)
    assert [remark.partition(" would")[0] for remark in remarks] == ["viscous_shift"] * said


@pytest.mark.parametrize(
    ("elsewhere", "alone", "beside"),
    [(0.0, True, False), (10.0, True, False), (20.0, True, True), (-1.0, True, False), (-4.0, False, False)],
)
def test_what_explains_an_incident_is_no_cause_at_the_cost_of_the_rest_nor_beside_another(elsewhere, alone, beside):
    level = np.full(12, 5.0)
    gains = level + elsewhere
    gains[4] += 500.0
    for names, goes in (((), alone), ((VISCOUS,), beside)):
        less = assessed(names, {"force": np.zeros(8)}, [1.0] * len(names), {"force": level})
        more = assessed((*names, MASS), {"force": np.zeros(8)}, [1.0] * (len(names) + 1), {"force": gains})
        assert recurs(more, less, {"force": 2.0}) is goes


# Rms error of the given model, the other causes' remainder, the remainder with the cause; whether that is form.
FORMS = [(400.0, 4.0, 1.6, True), (400.0, 4.0, 0.0, False), (40.0, 4.0, 1.6, False), (400.0, 4.0, 0.8, False)]


@pytest.mark.parametrize(("given", "before", "after", "form"), FORMS)
def test_a_cause_that_corrects_the_form_of_another_is_told(given, before, after, form):
    noise = np.array([1.0, -1.0, 1.0, -1.0])
    error = np.array([1.0, 1.0, -1.0, -1.0])
    # Closing all but 16 % of the power is too little; all but 4 % is enough.
    assert corrects_form(noise + given * error, noise + before * error, noise + after * error, 1.0) is form


def test_the_main_channel_of_a_cause_is_where_it_removes_most():
    less = assessed((), {"force": np.full(9, 3.0), "volume": np.full(9, 5.0)})
    more = assessed((MASS,), {"force": np.full(9, 1.0), "volume": np.full(9, 4.9)}, [1.0])
    assert mostly_in(more, less) == "force"


# --------------------------------------------------------------------------------------------------- starts, exchanges


def test_the_start_of_two_linear_causes_is_their_joint_optimum():
    rng = np.random.default_rng(6)
    j = rng.standard_normal((480, 2))
    j[:, 1] += 0.9 * j[:, 0]
    base = 0.3 * rng.standard_normal(480) + j @ [0.5, -0.4]
    evidence = evidence_of({"force": base})
    one = linear_fit(evidence, (VISCOUS,), j[:, :1]).fit
    other = Fit((MASS,), np.array([1.0]), ("force",), Residuals({"force": base}), j[:, 1:], 0.0, np.ones(1))
    start = combined(evidence, one, other)
    together = -np.linalg.lstsq(j, base, rcond=None)[0]
    np.testing.assert_allclose(start.trials[0], together + np.array([0.0, 1.0]), atol=1e-6)
    left = 0.5 * (np.sum(one.residuals.values["force"] ** 2) - np.sum((base + j @ together) ** 2))
    assert start.promise == pytest.approx(left, rel=1e-6)
    assert start.fit.hypothesis == (VISCOUS, MASS)


def scored(hypothesis, gain):
    """Return a hypothesis with a held-out gain beyond the penalty [nats]."""
    p = sum(len(c.free) for c in hypothesis)
    total = gain + rules.PENALTY * p
    return assessed(hypothesis, {"force": np.zeros(12)}, np.zeros(p), {"force": np.full(12, total / 12.0)})


TWO = candidate("valve_dead_zone", "positive", "negative")
ONE = candidate("valve_dead_zone", "positive")


@pytest.mark.parametrize(
    ("rival", "behind", "taken"),
    [
        (ONE, rules.NEEDED_GAIN - 1.0, True),
        (ONE, rules.NEEDED_GAIN + 1.0, False),
        (MASS, 0.9 * rules.SIMPLER * 1000.0, True),
        (MASS, 1.1 * rules.SIMPLER * 1000.0, False),
        (candidate("stribeck_shift", "static_offset", "velocity_factor"), 0.0, False),
    ],
    ids=["own form, near", "own form, far", "other effect, near", "other effect, far", "as many parameters"],
)
def test_fewer_parameters_are_preferred_where_little_is_lost(rival, behind, taken):
    best = scored((TWO,), 1000.0)
    other = scored((rival,), 1000.0 - behind)
    assert simpler(best, [Place(scored((), 0.0), (other,))], FORCE) is (other if taken else None)


@pytest.mark.parametrize(("behind", "steady", "taken"), [(0.9, False, True), (0.9, True, False), (1.1, False, False)])
def test_more_parameters_must_gain_steadily_beside_errors_of_form(behind, steady, taken):
    gain = behind * rules.EQUAL_FRACTION * 1000.0
    best, other = scored((TWO,), 1000.0), scored((MASS,), 1000.0 - gain)
    if not steady:
        ahead = np.full(12, 1000.0 / 12.0) + np.eye(12)[0] * gain - gain / 12.0
        best = assessed((TWO,), {"force": np.zeros(12)}, np.zeros(2), {"force": ahead + 2.0 * rules.PENALTY / 12.0})
    places = [Place(scored((), 0.0), (other,))]
    assert simpler(best, places, FORCE, beside_form=True) is (other if taken else None)
    assert simpler(best, places, FORCE) is None


@pytest.mark.parametrize(
    ("causes", "behind", "taken"),
    [((MASS, VISCOUS), 4.0, True), ((MASS, VISCOUS), 6.0, False), ((MASS, ONE, VISCOUS), 0.0, False)],
    ids=["near", "far", "as many parameters"],
)
def test_two_causes_of_few_parameters_are_simpler_than_one_of_many(causes, behind, taken):
    stops = candidate("end_stop", "upper", "lower", "stiffness")
    best, more = scored((stops,), 1000.0), scored(causes, 1000.0 - behind)
    assert searching._leaner(more, best, scored((), 0.0), FORCE) is taken


@pytest.mark.parametrize(("better", "kept"), [(rules.NEEDED_GAIN + 1.0, False), (rules.NEEDED_GAIN - 1.0, True)])
def test_a_cause_is_not_named_where_a_smaller_change_within_errors_of_form_explains_more(better, kept):
    # Both change the balance, one by less and one by more than errors of form: 0.01 of the largest term.
    form = HealthyVariation({}, form={"force": 0.01})
    evidence = replace(evidence_of({"force": np.zeros(12)}), standard=form)
    less = scored((), 0.0)
    small, large = scored((ONE,), 500.0 + better), scored((MASS,), 500.0)
    small.fit.residuals.values["force"] = np.full(12, 0.5)
    large.fit.residuals.values["force"] = np.full(12, 2.0)
    left = searching._not_outdone(evidence, [small, large], less, FORCE)
    assert left == ((small, large) if kept else (small,))


@pytest.mark.parametrize(("behind", "competes"), [(0.5 * rules.EQUAL, True), (2.0 * rules.EQUAL, False)])
def test_beside_errors_of_form_a_rival_as_good_as_the_cause_competes_whatever_limit_it_misses(monkeypatch, behind, competes):
    monkeypatch.setattr(searching, "accepted", lambda *given: False)
    evidence = replace(evidence_of({"force": np.zeros(12)}), standard=BesideForm())
    best, rival = scored((ONE,), 1000.0), scored((MASS,), 1000.0 - behind)
    assert searching._rivals(evidence, best, Place(scored((), 0.0), (rival,)), FORCE) == ((rival,) if competes else ())


@pytest.mark.parametrize(("remainder", "tried"), [(5.2, True), (4.8, False)])
def test_where_the_remainder_is_too_small_for_a_further_cause_to_matter_none_is_tried_anew(monkeypatch, remainder, tried):
    # The largest term is 100 times the noise floor, and a cause must change it by 5 % beside errors of form.
    evidence = replace(evidence_of({"force": np.full(600, 30.0)}), standard=BesideForm())
    alone = Fit((MASS,), np.ones(1), ("force",), evidence.base, np.ones((600, 1)), 0.0, np.ones(1))
    starts = object.__new__(Starts)
    starts.pool, starts.tried = SimpleNamespace(evidence=evidence), Tried((MASS,), evidence, [[alone]])
    member = assessed((VISCOUS,), {"force": np.full(600, remainder)}, [1.0])
    seen = list[str]()
    monkeypatch.setattr(begun, "extended", lambda *given: seen.append("tried") or evidence.rig)
    starts.pool.beside = lambda *given: SimpleNamespace(close=lambda: None)
    monkeypatch.setattr(begun, "try_starts", lambda *given: None)
    monkeypatch.setattr(begun, "Starts", lambda *given: SimpleNamespace(alone=[]))
    starts._promising = lambda *given: []
    assert starts.anew(member) == []
    assert bool(seen) is tried


def exchanged(monkeypatch, best, alone, dropped=None, sure=lambda hypothesis: len(hypothesis) == 1):
    """Exchange the causes of a hypothesis; one of two may be dropped, and no other can replace it."""
    monkeypatch.setattr(searching, "accepted", lambda evidence, more, less, scale: sure(more.hypothesis))
    monkeypatch.setattr(searching, "_without", lambda *given: dropped)
    monkeypatch.setattr(searching, "fitted", lambda *given, **named: [])
    pool = SimpleNamespace(lead=lambda work, items: [work(item) for item in items])
    starts = SimpleNamespace(extensions=lambda member: [])
    return searching._exchanged(evidence_of({"force": np.zeros(12)}), pool, best, starts, alone, FORCE)


def test_a_simpler_form_that_was_exchanged_is_not_returned_to(monkeypatch):
    # The one is preferred because it is simpler, the other because its gain is larger.
    full, simple = scored((TWO,), 1000.0), scored((ONE._replace(number=1),), 1000.0 - 0.5 * rules.NEEDED_GAIN)
    alone = Place(scored((), 0.0), (full, simple))
    for start in (full, simple):
        best, places = exchanged(monkeypatch, start, alone)
        assert best is full
        assert places == (alone,)


def test_an_unsure_cause_gives_way_to_a_sure_one_and_not_to_nothing(monkeypatch):
    unsure, less, least = scored((TWO,), 1000.0), scored((VISCOUS,), 600.0), scored((MASS,), 500.0)
    alone = Place(scored((), 0.0), (unsure, least, less))
    best, _ = exchanged(monkeypatch, unsure, alone, sure=lambda hypothesis: hypothesis[0] in (VISCOUS, MASS))
    assert best is less
    best, _ = exchanged(monkeypatch, unsure, alone, sure=lambda hypothesis: False)
    assert best is alone.without


def test_places_are_those_of_the_hypothesis_when_the_rounds_are_used_up(monkeypatch):
    monkeypatch.setattr(searching, "MAX_EXCHANGES", 1)
    one = scored((VISCOUS,), 1000.0)
    alone = Place(scored((), 0.0), (one,))
    best, places = exchanged(monkeypatch, scored((VISCOUS, MASS), 990.0), alone, dropped=one)
    assert best is one
    assert places == (alone,)


# -------------------------------------------------------------------------------------------------------------- threads


@pytest.fixture
def pool(monkeypatch):
    """Return a pool of two threads with workers that do nothing."""
    evidence = evidence_of({"force": np.zeros(24)})
    monkeypatch.setattr("ehls_ros.diagnosis.pool.Worker", lambda evidence, subset: SimpleNamespace())
    pool = Pool(SimpleNamespace(record=SimpleNamespace(time=np.zeros(24)), blocks=evidence.blocks), 2)
    yield pool
    pool.close()


def test_results_come_in_the_order_of_the_items(pool):
    first_waits = threading.Event()

    def work(worker, item):
        # The first item cannot be done before the second.
        (first_waits.wait if item == 0 else first_waits.set)()
        return 10 * item

    assert pool.map(work, [0, 1, 2]) == [0, 10, 20]


def test_an_error_in_a_thread_is_raised_and_its_worker_is_used_again(pool):
    def work(worker, item):
        if item < 4:
            raise ZeroDivisionError(item)
        return item

    for _ in range(3):
        with pytest.raises(ZeroDivisionError, match="0"):
            pool.map(work, [0, 1, 2, 3])
    assert pool.map(work, [4, 5, 6]) == [4, 5, 6]


def test_no_two_threads_share_a_worker(pool):
    both = threading.Barrier(2)

    def work(worker, item):
        both.wait(60.0)
        return id(worker)

    assert len(set(pool.map(work, [0, 1]))) == 2


def test_leading_work_maps_its_own_on_all_threads(pool):
    assert pool.lead(lambda item: sum(pool.map(lambda worker, i: i, range(item))), [3, 4, 5]) == [3, 6, 10]


def test_the_worst_blocks_of_a_long_recording_are_screened():
    error = np.where(np.isin(np.arange(600) // 30, [3, 11, 12, 17]), 9.0, 0.1)
    evidence = evidence_of({"force": error}, blocks=20)
    long = SimpleNamespace(
        record=SimpleNamespace(time=np.zeros(6000)), blocks=20, channels=("force",), block=evidence.block, base=evidence.base
    )
    ranges = informative_blocks(long)
    assert [begin // 300 for begin, _ in ranges] == [0, 3, 6, 11, 12, 13, 17, 19]
    assert all(end - begin == 300 for begin, end in ranges)
    assert informative_blocks(SimpleNamespace(record=long.record, blocks=12)) is None
