"""From the results of a search to its conclusions: each step on plain data."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plain_evidence import MASS, SIZE, VALVE, VISCOUS, assessed, candidate, evidence_of, linear_fit, nothing

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.causes import causes, closed_fraction, estimate, gain
from ehls_ros.diagnosis.dependence import depends_on, explained_by, explained_fraction
from ehls_ros.diagnosis.excitation import NINE_OF_TEN, Sliding, excited, sensitivities, smallest_detectable
from ehls_ros.diagnosis.healthy_variation import HealthyVariation
from ehls_ros.diagnosis.held_out import probabilities
from ehls_ros.diagnosis.remainder import (
    Blocks,
    Relevance,
    Remainder,
    at_a_bound,
    imitated_channels,
    remainder,
    remainder_in,
    remainders,
)
from ehls_ros.diagnosis.result import Sensitivity
from ehls_ros.diagnosis.search import Place, Searched
from ehls_ros.diagnosis.verdict import NEEDED_MOTION, NEEDED_SIGNALS, Decision, Finding, Nrmse, decide, stage_result

FORCE = {"force": 1.0}

# ------------------------------------------------------------------------------------------------------------- verdict


def rest(channel, after=1.0, *, remains=False, closed=1.0, explained=True, exceeded=False, incident=None):
    """Return the remainder in a channel; by default only noise."""
    return Remainder(channel, 10.0, after, 1.0, closed, exceeded, remains, incident, explained)


CLEAN = {
    "force_balance": Finding((rest("force"),), excited=True),
    "flow": Finding((rest("volume"), rest("supply")), excited=True),
    "valve": Finding((rest("spool"),), excited=True),
    "sensors": Finding((rest("cell"), rest("velocity")), excited=True),
}
NOTHING = Finding((), excited=False, recorded=False)
NOT_COVERED = Finding((), excited=True)


def still(stage):
    """Return the finding of a stage that was recorded but not excited."""
    return Finding(CLEAN[stage].remainders, excited=False)


def left(channel, after, **more):
    """Return the finding of a stage with a remainder that no cause explains."""
    return Finding((rest(channel, after, remains=True, closed=0.5, **more),), excited=True)


VERDICTS = {
    "nothing remains, nothing named": ({}, [], ("consistent", None)),
    "a cause explains everything": ({}, ["flow"], ("effect", None)),
    "two causes explain everything": ({}, ["flow", "force_balance"], ("effect", None)),
    "a cause in a stage that was not excited": ({"flow": still("flow")}, ["force_balance", "flow"], ("insufficient", None)),
    "a cause in another stage": ({"flow": still("flow")}, ["force_balance"], ("effect", None)),
    "a sensor's fault": ({}, ["sensors"], ("effect", None)),
    "something remains": ({"flow": left("volume", 4.0)}, [], ("unknown", "flow")),
    "something remains beside a cause": ({"flow": left("volume", 4.0)}, ["force_balance"], ("unknown", "flow")),
    "something remains in a stage that was not excited": (
        {"flow": left("volume", 4.0)._replace(excited=False)},
        [],
        ("unknown", "flow"),
    ),
    "an unexcited cause beside a remainder": (
        {"flow": still("flow"), "valve": left("spool", 4.0)},
        ["flow"],
        ("insufficient", "valve"),
    ),
    "most remains in the force balance": (
        {"flow": left("volume", 4.0), "force_balance": left("force", 5.0)},
        [],
        ("unknown", "force_balance"),
    ),
    "two sensors disagree": (
        {"sensors": left("cell", 1.5), "force_balance": left("force", 500.0)},
        [],
        ("unknown", "sensors"),
    ),
    "what remains was nearly closed": (
        {"flow": Finding((rest("volume", 4.0, remains=True, closed=rules.CLOSED),), excited=True)},
        ["flow"],
        ("effect", None),
    ),
    "causes that only imitate": (
        {"flow": Finding((rest("volume", 4.0, closed=0.99, explained=False),), excited=True)},
        ["flow"],
        ("unknown", "flow"),
    ),
    "an incident": (
        {"flow": Finding((rest("volume", 4.0, incident=(1.0, 2.0)),), excited=True)},
        [],
        ("consistent", None),
    ),
    "more than half were excited": ({"flow": still("flow"), "sensors": NOTHING}, [], ("consistent", None)),
    "exactly half were excited": ({"flow": NOTHING, "valve": still("valve")}, [], ("consistent", None)),
    "less than half were excited": ({"flow": still("flow"), "valve": still("valve")}, [], ("insufficient", None)),
    "nothing was excited": ({s: still(s) for s in ("flow", "valve", "force_balance")}, [], ("insufficient", None)),
    "only the flow was recorded": ({"valve": NOTHING, "force_balance": NOTHING, "sensors": NOTHING}, [], ("consistent", None)),
    "only the valve was recorded": ({"flow": NOTHING, "force_balance": NOTHING, "sensors": NOTHING}, [], ("consistent", None)),
    "the valve was excited but the load was not": (
        {"flow": NOTHING, "force_balance": still("force_balance")},
        [],
        ("insufficient", None),
    ),
    "what would show was not recorded": (
        {"flow": Finding((), excited=True, recorded=False), "force_balance": still("force_balance")},
        [],
        ("insufficient", None),
    ),
    "baselines cover the valve alone": ({"flow": NOT_COVERED, "force_balance": NOT_COVERED}, [], ("insufficient", None)),
    "baselines do not cover the flow": ({"flow": NOT_COVERED}, [], ("consistent", None)),
    "only sensors were recorded": (dict.fromkeys(("flow", "valve", "force_balance"), NOTHING), [], ("insufficient", None)),
}


@pytest.mark.parametrize("case", VERDICTS)
def test_what_is_known_decides_the_verdict(case):
    changed, named, expected = VERDICTS[case]
    assert decide(CLEAN | changed, named) == Decision(*expected)


def test_a_change_since_baselines_may_lie_in_a_stage_that_could_not_show_any_smaller_one():
    findings = CLEAN | {"flow": still("flow")}
    assert decide(findings, ["flow"]).verdict == "insufficient"
    assert decide(findings, ["flow"], excitation_needed=False).verdict == "effect"


# -------------------------------------------------------------------------------------------------------- stage results


def described(finding, stage="flow", depends=lambda channel: ()):
    nrmse = {"volume": Nrmse(0.2, 0.1, 0.05), "supply": Nrmse(0.4, 0.3, 0.2)}
    return stage_result(stage, finding, nrmse, depends)


@pytest.mark.parametrize(
    ("finding", "why"), [(NOTHING, f"needs {NEEDED_SIGNALS['flow']}"), (still("flow"), NEEDED_MOTION["flow"])]
)
def test_a_stage_that_is_not_judged_says_why(finding, why):
    result = described(finding)
    assert not result.judged
    assert result.why_not == why
    assert result.nrmse_before is None


def test_a_stage_is_described_by_its_worst_channel():
    volume, supply = rest("volume")._replace(before=8.0), rest("supply")._replace(before=30.0, noise=5.0)
    result = described(Finding((volume, supply), excited=True))
    assert result.judged
    assert (result.nrmse_before, result.nrmse_after, result.noise_floor) == (0.2, 0.1, 0.05)
    assert not any((result.exceeds, result.unexplained, result.leaves_much, result.depends_on))
    assert result.incident is None


def test_a_stage_says_on_what_its_remainder_depends():
    items = (rest("volume", 3.0, remains=True, closed=0.2, exceeded=True), rest("supply", 4.0, remains=True, exceeded=True))
    result = described(Finding(items, excited=True), depends=lambda channel: (f"of {channel}",))
    assert result.depends_on == ("of supply",)
    assert result.exceeds
    assert result.unexplained
    # The volume's remainder: less than 99 % closed, but not three times out of the noise.
    assert not result.leaves_much


def test_a_stage_tells_its_incident_and_its_doubtful_remainder():
    items = (rest("volume", 3.1, closed=0.98, exceeded=True), rest("supply", incident=(2.0, 4.5)))
    result = described(Finding(items, excited=True))
    assert result.leaves_much
    assert result.incident == (2.0, 4.5)
    assert not described(Finding((items[0]._replace(exceeded=False),), excited=True)).leaves_much


# ----------------------------------------------------------------------------------------------------------- remainder

N, BLOCKS = 1200, 12
NOISE = np.random.default_rng(21).standard_normal(N)
ERROR = 10.0 * np.random.default_rng(22).standard_normal(N)
GROUPS = Blocks(np.arange(N) * BLOCKS // N, BLOCKS, 0.02 * np.arange(N))


@pytest.mark.parametrize(("bursts", "remains"), [(0, True), (30, False)])
def test_rare_errors_that_a_baseline_has_too_are_no_change(bursts, remains):
    rng = np.random.default_rng(7)
    old, new = rng.standard_normal((2, 1000))
    old[:bursts] *= 10.0
    new[::33] *= 10.0
    standard = HealthyVariation({}, (evidence_of({"force": old}),))
    judged = replace(evidence_of({"force": new}), standard=standard)
    assert remainder_in(judged, nothing(judged), "force").remains is remains


MATTERS = Relevance(noise=1.0, rare=rules.RARE_SCATTER, limit=0.1)


def remaining(before, after, *, changed=True, imitated=False, relevance=MATTERS):
    return remainder("force", before, after, GROUPS, relevance, changed=changed, imitated=imitated)


def test_noise_is_no_remainder():
    item = remaining(NOISE, NOISE)
    assert not any((item.exceeded, item.remains, item.unexplained, item.doubtful))
    assert item.before == item.after == pytest.approx(1.0, abs=0.05)


def test_an_error_that_a_cause_closes_is_explained():
    item = remaining(NOISE + ERROR, NOISE)
    assert item.exceeded
    assert not item.remains
    assert item.closed == pytest.approx(1.0, abs=0.01)
    assert item.explained
    assert not item.unexplained


@pytest.mark.parametrize(("fraction", "unexplained"), [(0.1, False), (0.2, False), (0.25, True), (1.0, True)])
def test_an_error_of_which_too_much_remains_is_unexplained(fraction, unexplained):
    item = remaining(NOISE + ERROR, NOISE + fraction * ERROR)
    assert item.closed == pytest.approx(1.0 - fraction**2, abs=0.02)
    assert item.unexplained is unexplained


def test_what_no_cause_changes_may_remain_unexplained():
    assert remaining(NOISE + ERROR, NOISE + ERROR, changed=False).unexplained
    assert not remaining(NOISE, NOISE, changed=False).unexplained


def test_what_is_imitated_is_unexplained_however_much_is_closed():
    assert remaining(NOISE + ERROR, NOISE, imitated=True).unexplained


def test_what_is_too_small_to_matter_does_not_remain():
    large = Relevance(noise=1.0, rare=rules.RARE_SCATTER, limit=100.0)
    item = remaining(NOISE + ERROR, NOISE + ERROR, changed=False, relevance=large)
    assert not any((item.exceeded, item.remains, item.unexplained))
    # But a cause that acts in the channel has to close it.
    assert remaining(NOISE + ERROR, NOISE + ERROR, changed=True, relevance=large).unexplained


@pytest.mark.parametrize(("size", "alone", "unexplained"), [(2.5, True, True), (1.0, True, False), (2.5, False, False)])
def test_what_stands_clear_of_the_noise_remains_where_no_cause_is_named_however_small_it_is(size, alone, unexplained):
    evidence = evidence_of({"force": NOISE + 0.1 * size * ERROR, "volume": NOISE})
    evidence.sizes["force"] = 1e6
    named = () if alone else (VALVE,)
    best = assessed(named, dict(evidence.base.values), [1.0] * len(named), {"volume": np.ones(BLOCKS)} if named else {})
    assert remainder_in(evidence, best, "force").unexplained is unexplained


def test_beside_errors_of_form_one_block_alone_is_an_incident_however_large():
    evidence = evidence_of({"force": NOISE + np.where(GROUPS.number == 4, 8.0, 0.0)})
    item = remainder_in(replace(evidence, standard=HealthyVariation({})), nothing(evidence), "force")
    assert item.incident is not None
    assert not item.unexplained


@pytest.mark.parametrize(("size", "unexplained"), [(4.0, False), (8.0, True)])
def test_what_stands_clear_of_the_noise_in_one_block_only_is_no_incident_where_no_cause_is_named(size, unexplained):
    evidence = evidence_of({"force": NOISE + np.where(GROUPS.number == 4, size, 0.0)})
    item = remainder_in(evidence, nothing(evidence), "force")
    assert item.unexplained is unexplained
    assert (item.incident is None) is unexplained


@pytest.mark.parametrize(("blocks", "incident"), [((4,), (8.0, 9.98)), ((4, 9), None)])
def test_what_occurs_in_one_block_only_is_an_incident(blocks, incident):
    item = remaining(NOISE, NOISE + np.where(np.isin(GROUPS.number, blocks), 20.0, 0.0))
    assert item.remains is (incident is None)
    assert item.incident == (None if incident is None else pytest.approx(incident))


def test_what_lies_in_one_block_mostly_is_no_incident():
    # Six of ten windows lie in the block: too few remain without it for a comparison.
    groups = Blocks(np.array([0] * 6 + [1, 1, 2, 2]), 3, np.arange(10.0))
    e = np.array([20.0] * 6 + [0.0] * 4)
    np.testing.assert_array_equal(groups.elsewhere(e), e)
    assert remainder("force", e, e, groups, MATTERS, changed=False, imitated=False).remains


@pytest.mark.parametrize(
    ("e", "exceeded"),
    [
        (np.full(1000, math.sqrt(rules.SCATTER) + 0.01), True),
        (np.full(1000, math.sqrt(rules.SCATTER) - 0.01), False),
        (np.where(np.arange(1000) < 15, 9.0, 0.0), True),
        (np.where(np.arange(1000) < 5, 9.0, 0.0), False),
    ],
    ids=["more than noise", "noise", "rarely more", "an outlier"],
)
def test_more_than_noise_is_told_by_mean_and_quantile(e, exceeded):
    assert Relevance(noise=1.0, rare=rules.RARE_SCATTER, limit=0.1).exceeded(e) is exceeded


def test_a_rare_event_matters_at_five_times_the_limit():
    rare = np.where(np.arange(1000) < 15, 9.0, 0.0)
    beyond = math.sqrt(81.0 - rules.RARE_SCATTER * rules.SCATTER)
    assert Relevance(noise=1.0, rare=rules.RARE_SCATTER, limit=0.99 * beyond / rules.RARE_FACTOR).exceeded(rare)
    assert not Relevance(noise=1.0, rare=rules.RARE_SCATTER, limit=1.01 * beyond / rules.RARE_FACTOR).exceeded(rare)


@pytest.mark.parametrize(
    ("value", "neutral", "ended"),
    [(5.0, 1.0, True), (-5.0, 1.0, True), (4.9, 1.0, False), (0.0, 1.0, False), (5.0, 5.0, False)],
    ids=["upper", "lower", "inside", "zero", "neutral"],
)
def test_a_parameter_at_its_bound_is_told(value, neutral, ended):
    lower = 0.0 if value == 0.0 else -5.0
    assert at_a_bound(candidate("mass_shift", "factor", lower=lower, upper=5.0, neutral=neutral), np.array([value])) is ended


def two_causes(closes, at_end=False):
    """Return evidence and a search's two causes; the second removes a fraction of the amplitude left by the first."""
    rng = np.random.default_rng(6)
    noise, second, first = rng.standard_normal(N), 4.0 * rng.standard_normal(N), 40.0 * rng.standard_normal(N)
    evidence = evidence_of({"force": noise + second + first})
    lag = candidate("pressure_sensor_lag", "time_constant", lower=0.0, upper=0.1)

    def leaving(e, *hypothesis):
        return assessed(hypothesis, {"force": e}, [1.0, 0.1 if at_end else 0.05][: len(hypothesis)])

    best = leaving(noise + (1.0 - closes) * second, VISCOUS, lag)
    without = leaving(noise + second + first - closes * second, lag), leaving(noise + second, VISCOUS)
    return evidence, Searched(best, tuple(Place(w, ()) for w in without), (), FORCE)


@pytest.mark.parametrize(
    ("closes", "at_end", "imitated"),
    [(1.0, False, False), (0.85, False, False), (0.6, False, True), (0.8, True, True), (1.0, True, False)],
)
def test_a_cause_has_to_close_most_of_what_the_others_leave(closes, at_end, imitated):
    evidence, found = two_causes(closes, at_end)
    # Together the two close more than 99 % either way.
    assert imitated_channels(evidence, found) == (frozenset({"force"}) if imitated else frozenset())
    (item,) = remainders(evidence, found)
    assert item.closed > 0.99
    assert item.explained is not imitated


# ---------------------------------------------------------------------------------------------------------- excitation


@pytest.mark.parametrize(
    ("information", "effect", "expected"),
    [
        (0.0, 1.0, None),
        (4.0, 1.0, (math.sqrt(2.0 * rules.NEEDED_GAIN) + NINE_OF_TEN) / 2.0),
        (1e12, 0.01, rules.RELEVANT / 0.01),
        (4.0, 0.0, (math.sqrt(2.0 * rules.NEEDED_GAIN) + NINE_OF_TEN) / 2.0),
    ],
    ids=["nothing is told", "the noise limits", "relevance limits", "no size is known"],
)
def test_the_smallest_detectable_size(information, effect, expected):
    assert smallest_detectable(information, effect) == pytest.approx(expected)


def test_an_effect_that_grows_from_its_neutral_value_has_a_smallest_size():
    evidence = evidence_of({"force": np.zeros(100)})
    one, two = candidate("mass_shift", "factor"), candidate("mass_shift", "factor", "other")
    smooth = assessed((one,), {"force": np.zeros(100)}, [0.0]).fit._replace(jacobian=np.full((100, 1), 2.0))
    # It changes nothing.
    away = smooth._replace(values=np.array([0.5]))
    # Another form tells the size of the effect alone.
    many = assessed((two,), {"force": np.zeros(100)}, [0.0, 0.0]).fit._replace(jacobian=np.full((100, 2), 2.0))
    bounded = candidate("mass_shift", "factor", lower=-1.0, upper=1.0)
    out_of_reach = smooth._replace(hypothesis=(bounded,), jacobian=np.full((100, 1), 1e-20))
    found, unreachable = sensitivities(evidence, [many, smooth, away, out_of_reach], {"force": 1.0})
    # Told all the same: no size within the range would have shown.
    assert unreachable.smallest > 1.0
    assert (found.name, found.parameter, found.unit) == ("mass_shift", "factor", "1")
    assert found.smallest == pytest.approx(smallest_detectable(400.0, 2.0 / SIZE))


def test_an_unexplained_remainder_raises_the_smallest_size():
    evidence = evidence_of({"force": np.zeros(100)})
    smooth = assessed((candidate("mass_shift", "factor"),), {"force": np.zeros(100)}, [0.0]).fit
    fit = smooth._replace(jacobian=np.full((100, 1), 2.0))
    one, nine = (sensitivities(evidence, [fit], {"force": scale})[0].smallest for scale in (1.0, 9.0))
    assert nine == pytest.approx(3.0 * one)


TRAVEL = {"slides": 1.01, "sticks": 0.99}


@pytest.mark.parametrize(
    ("stage", "key", "limit", "travel", "expected"),
    [
        ("valve", ("valve_gain_shift", "gain"), 0.99, "slides", True),
        ("valve", ("valve_gain_shift", "gain"), 1.01, "slides", False),
        ("valve", ("valve_gain_shift", "flow_gain"), 0.1, "slides", False),
        ("flow", ("valve_gain_shift", "flow_gain"), 0.99, "sticks", True),
        ("force_balance", ("coulomb_shift", "offset"), 0.99, "slides", True),
        ("force_balance", ("coulomb_shift", "offset"), 0.99, "sticks", False),
        ("force_balance", ("coulomb_shift", "offset"), 1.01, "slides", False),
        ("sensors", ("mass_shift", "factor"), 1.01, "sticks", True),
    ],
)
def test_a_stage_is_excited_if_its_key_parameter_is_detectable(stage, key, limit, travel, expected):
    presliding, coulomb = 2e-5, 300.0
    nominal = coulomb if stage == "force_balance" else 1.0
    sizes = [Sensitivity(*key, limit * rules.MAX_UNDETECTED * nominal, "1")]
    slid = Sliding(TRAVEL[travel] * rules.SLIDING * presliding, presliding, coulomb)
    assert excited(stage, sizes, slid) is expected


# --------------------------------------------------------------------------------------------------------- probability


def test_equal_hypotheses_share_the_probability():
    gains = np.full(12, 3.0)
    assert probabilities([gains] * 4, [1] * 4, 0) == pytest.approx(np.full(4, 0.25))


def test_a_parameter_more_costs_its_penalty():
    gains = np.full(12, 3.0)
    odds = math.exp(-rules.PENALTY)
    assert probabilities([gains, gains], [2, 1], 0) == pytest.approx(np.array([odds, 1.0]) / (1.0 + odds))


def test_a_hypothesis_that_gains_in_every_block_is_certain():
    first, second, nothing = probabilities([np.full(12, 5.0), np.full(12, 1.0), np.empty(0)], [1, 1, 0], 0)
    assert first > 0.9999
    assert max(second, nothing) < 1e-4


def test_a_gain_in_one_block_of_many_is_not_certain():
    # As large in total as above, but two blocks decide in different directions.
    one, other = np.zeros(12), np.zeros(12)
    one[3], other[8] = 60.0, 50.0
    assert 0.5 < probabilities([one, other], [1, 1], 0)[0] < 0.8


# -------------------------------------------------------------------------------------------------------------- causes


def searched(spoil=0.3, second=None):
    """Return evidence and a search's result: the mass, and viscous friction that explains the same except for a spoilt part."""
    rng = np.random.default_rng(5)
    j = rng.standard_normal((720, 1))
    evidence = evidence_of({"force": rng.standard_normal(720) + 3.0 * j[:, 0]})
    hypothesis, columns = (MASS,), j
    if second is not None:
        hypothesis, columns = (MASS, second), np.hstack([j, rng.standard_normal((720, 1))])
    best = linear_fit(evidence, hypothesis, columns)
    rival = linear_fit(evidence, (VISCOUS,), j + spoil * rng.standard_normal((720, 1)))
    places = (Place(nothing(evidence), (rival,)), Place(nothing(evidence), ()))
    return evidence, Searched(best, places[: len(hypothesis)], (), FORCE)


def test_what_explains_the_same_is_equivalent():
    evidence, found = searched(spoil=0.0)
    (cause,) = causes(evidence, found, 0)
    assert cause.name == "mass_shift"
    assert cause.equivalent_to == ("viscous_shift",)
    assert cause.probability == pytest.approx(0.5, abs=1e-6)
    assert (cause.stage, cause.group) == ("force_balance", "mechanics")
    assert cause.rivals[0].behind == pytest.approx(0.0, abs=1e-6)


def test_what_explains_less_is_a_rival():
    evidence, found = searched()
    (cause,) = causes(evidence, found, 0)
    assert cause.equivalent_to == ()
    assert cause.probability > 0.99
    assert cause.sigmas > 10.0
    (rival,) = cause.rivals
    assert rival.name == "viscous_shift"
    assert rival.behind > rules.EQUAL
    # Noise of 0.3 on a regressor of 1 leaves 0.3² / 1.09 of the power.
    assert rival.closed_fraction == pytest.approx(1.0 - 0.09 / 1.09, abs=0.03)


@pytest.mark.parametrize(("sigmas", "probable"), [(3.0, True), (6.0, False)], ids=["vague", "sure"])
def test_a_rival_that_explains_more_is_one_only_if_it_could_be_named(sigmas, probable):
    evidence, found = searched()
    (better,) = found.places[0].rivals
    gain = {"force": 1.1 * found.best.held_out.gain["force"]}
    covariance = np.array([[(better.fit.values[0] / sigmas) ** 2]])
    rival = better._replace(held_out=better.held_out._replace(gain=gain, covariance=covariance))
    (cause,) = causes(evidence, found._replace(places=(found.places[0]._replace(rivals=(rival,)),)), 0)
    assert cause.probability == pytest.approx(1.0 if probable else 0.0, abs=1e-3)


@pytest.mark.parametrize(("form", "equivalent"), [(0.02, ("viscous_shift",)), (0.002, ())])
def test_what_differs_by_no_more_than_errors_of_form_is_equivalent(form, equivalent):
    # The rival differs by 0.9 % of the largest term.
    evidence, found = searched()
    (cause,) = causes(replace(evidence, standard=HealthyVariation({}, form={"force": form})), found, 0)
    assert cause.equivalent_to == equivalent
    assert cause.probability == pytest.approx(0.5 if equivalent else 1.0, abs=0.01)


def test_what_explains_nearly_as_much_is_equivalent_where_a_missing_signal_would_tell(monkeypatch):
    evidence, found = searched(spoil=0.18)  # leaves 3 % of the power
    assert causes(evidence, found, 0)[0].equivalent_to == ()
    monkeypatch.setattr("ehls_ros.diagnosis.causes.deciding", lambda *_: ("force_n",))
    (cause,) = causes(evidence, found, 0)
    assert (cause.equivalent_to, cause.deciding) == (("viscous_shift",), ("force_n",))
    # Causes that explain too little to be reported at all are excluded.
    assert causes(*searched(spoil=0.3), 0)[0].equivalent_to == ()


@pytest.mark.parametrize(("second", "probability"), [(VISCOUS, rules.BOTH_RIGHT), (VALVE, 1.0)], ids=["same stage", "another"])
def test_two_causes_in_one_stage_may_be_one_outside_the_list(second, probability):
    evidence, found = searched(second=second)
    named = {cause.name: cause for cause in causes(evidence, found._replace(places=(Place(nothing(evidence), ()),) * 2), 0)}
    assert named["mass_shift"].probability == pytest.approx(probability, abs=1e-3)


@pytest.mark.parametrize(("leaves", "probability"), [(2.0, 1.0), (60.0, rules.FORM_RIGHT)])
def test_a_cause_that_leaves_much_is_less_probable(leaves, probability):
    rng = np.random.default_rng(8)
    column = 300.0 * rng.standard_normal((720, 1))
    evidence = evidence_of({"force": column[:, 0] + leaves * rng.standard_normal(720)})
    found = Searched(linear_fit(evidence, (MASS,), column), (Place(nothing(evidence), ()),), (), FORCE)
    (cause,) = causes(evidence, found, 0)
    assert cause.probability == pytest.approx(probability, abs=1e-3)


@pytest.mark.parametrize(
    ("value", "neutral", "form"), [(3.0, 1.0, 0.02), (0.5, 1.0, 0.005), (-200.0, 0.0, 2.0), (1.0, 1.0, 0.0)]
)
def test_an_estimate_is_uncertain_by_its_form(value, neutral, form):
    found = estimate(value, neutral, 0.04, "N")
    assert (found.value, found.unit) == (value, "N")
    assert found.std == pytest.approx(math.hypot(0.04, form))


# ---------------------------------------------------------------------------------------------------------------- gain


def test_the_gain_is_the_power_that_is_gone():
    evidence, found = searched()
    held_out = gain(evidence, found.best, {"force": 0.02}, 0)
    assert held_out.channel == "force"
    # Noise of 1 and an error of 3: nine tenths of the power can be removed, and are.
    assert held_out.closed_fraction == pytest.approx(1.0, abs=0.03)
    assert held_out.heldout_nrmse_before == pytest.approx(math.sqrt(10.0) / SIZE, rel=0.1)
    assert held_out.heldout_nrmse_after == pytest.approx(1.0 / SIZE, rel=0.1)
    assert held_out.noise_floor == 0.02
    assert gain(evidence, nothing(evidence), {"force": 0.02}, 0) is None


def test_channels_without_an_error_do_not_dilute_the_closed_fraction():
    noise, error = np.tile([1.0, -1.0, 1.0, -1.0], 150), np.tile([5.0, 5.0, -5.0, -5.0], 150)
    # Many windows a little noisier than expected: nothing there can be removed.
    idle = np.tile(noise, 20)
    evidence = evidence_of({"force": noise + error, "volume": 1.04 * idle}, {"force": noise, "volume": idle})
    half = assessed((MASS,), {"force": noise + math.sqrt(0.5) * error, "volume": 1.04 * idle}, [1.0])
    found = gain(evidence, half, {"force": 0.02}, 0)
    assert found.channel == "force"
    assert found.closed_fraction == pytest.approx(0.5)
    assert found.channels.keys() == {"force"}
    assert found.channels["force"] == pytest.approx((0.5, 1.0 / 25.0), rel=1e-6)


@pytest.mark.parametrize("closed", [0.3, 0.9, 1.0])
def test_equal_blocks_leave_no_doubt_of_the_closed_fraction(closed):
    before, noise = np.full(12, 11.0), np.full(12, 1.0)
    fraction, (low, high) = closed_fraction(before, before - 10.0 * closed, noise, 0)
    assert fraction == low == high == pytest.approx(closed)


def test_unequal_blocks_widen_the_interval():
    after = np.where(np.arange(12) % 2, 1.0, 6.0)
    fraction, (low, high) = closed_fraction(np.full(12, 11.0), after, np.full(12, 1.0), 0)
    # The mean of 0.5 and 1 over 12 blocks, give or take twice its standard error.
    assert fraction == pytest.approx(0.75)
    error = 0.25 / math.sqrt(12.0)
    assert low == pytest.approx(0.75 - 1.96 * error, abs=0.03)
    assert high == pytest.approx(0.75 + 1.96 * error, abs=0.03)


def test_nothing_to_remove_closes_nothing_and_more_than_all_is_all():
    ones = np.ones(12)
    assert closed_fraction(ones, ones, ones, 0)[0] == 0.0
    assert closed_fraction(1.005 * ones, 0.5 * ones, ones, 0)[0] == 0.0
    assert closed_fraction(2.0 * ones, 0.5 * ones, ones, 0) == (1.0, (1.0, 1.0))


# ---------------------------------------------------------------------------------------------------------- dependence


def test_a_residual_depends_on_what_predicts_it_elsewhere():
    rng = np.random.default_rng(9)
    even = np.arange(2000) // 100 % 2 == 0
    strong, weak, idle = (rng.uniform(-1.0, 1.0, 2000) for _ in range(3))
    noise = 0.5 * rng.standard_normal(2000)
    signals = {"idle": idle, "weak": weak, "strong": strong, "constant": np.ones(2000)}
    # Strong explains 16 / 3 of the variance, and weak the square of its factor divided by three.
    assert depends_on(4.0 * strong + 3.0 * weak + noise, signals, even) == ("strong", "weak")
    assert depends_on(4.0 * strong + 2.0 * weak + noise, signals, even) == ("strong",)
    assert depends_on(noise, signals, even) == ()


def test_the_explained_fraction_is_that_of_the_variance():
    rng = np.random.default_rng(9)
    n = 4000
    even = np.arange(n) // 100 % 2 == 0
    signal, noise = rng.uniform(-1.0, 1.0, n), rng.standard_normal(n)
    # A line is represented exactly by hat functions; 3 x has a variance of 3 against the noise's 1.
    assert explained_fraction(signal, 3.0 * signal + noise, even) == pytest.approx(0.75, abs=0.02)
    assert explained_fraction(signal, noise, even) == pytest.approx(0.0, abs=0.01)
    assert explained_fraction(signal, noise, np.ones(n, dtype=bool)) == 0.0


def test_columns_that_vanish_in_one_half_explain_nothing():
    half = np.arange(40) % 2 == 0
    assert explained_by(np.where(half, 0.0, 1.0)[:, None], np.ones(40), half) == 0.0
    assert explained_by(np.where(half, 1.0, 0.0)[:, None], np.ones(40), half) == 0.0
