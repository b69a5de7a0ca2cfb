"""The report of a diagnosis, from hand-made diagnoses."""

import html
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_pages import check, numbers, panels, parts, row, rows
from scipy.integrate import trapezoid

from ehls_ros.diagnosis.free_run import Followed, FreeRun
from ehls_ros.diagnosis.reading import Power, Reading, Shape
from ehls_ros.diagnosis.result import (
    BaselineSummary,
    Cause,
    ChannelGain,
    ChannelTrace,
    Diagnosis,
    Fitted,
    Gain,
    Rival,
    Sensitivity,
    StageResult,
    Term,
)
from ehls_ros.diagnosis.stages import SENSED
from ehls_ros.diagnosis.verdict import NEEDED_MOTION
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.consequences import NOTHING, Consequences
from ehls_ros.experiments.controller_benefit import BenefitCase, ControllerBenefit, Steady
from ehls_ros.experiments.next_experiment import NextExperiment, Pair, Proposal
from ehls_ros.experiments.spec import load_rig
from ehls_ros.physics.cylinder import two_chamber
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.effects.base import Words
from ehls_ros.physics.friction.gms import Parameters as Gms
from ehls_ros.physics.parameters import Plant
from ehls_ros.physics.rig import EffectUse
from ehls_ros.physics.valve import four_edges
from ehls_ros.report import diagnosis_figures as drawn
from ehls_ros.report import quantities as units
from ehls_ros.report.diagnosis import answer, write_diagnosis_report
from ehls_ros.report.diagnosis_findings import (
    CHANNEL_WORDS,
    caveats,
    fitted,
    left_over,
    verdict_sentence,
    where_to_look,
)
from ehls_ros.report.diagnosis_residuals import view_of_cause
from ehls_ros.report.diagnosis_term import sentence as term_sentence

RIG = load_rig(Path(__file__).parents[2] / "config" / "rig_paper_measured.yaml")
DEAD_ZONE = {"positive": Estimate(91.2e-6, 0.4e-6, "m"), "negative": Estimate(80.1e-6, 0.5e-6, "m")}
WINDOWS = 3000
FRICTION_KEYS = Gms._fields
ADVICE = EFFECTS.load("valve_dead_zone").WORDS[1:4]
RIVAL = Rival("valve_gain_shift", 180.0, 0.52, {"flow_gain": Estimate(0.947, 0.002, "1")})
TWIN = Rival("valve_hysteresis", 1.0, 0.97, {"width": Estimate(150e-6, 2e-6, "m")})
CAUSE = Cause("valve_dead_zone", 0.999, (), "valve", "valve", DEAD_ZONE, {}, 5000.0, 230.0, (RIVAL,), "volume")
QUIET = StageResult(judged=True, why_not="", nrmse_before=0.003, nrmse_after=0.003, noise_floor=0.003)
GAIN = Gain("volume", 0.077, 0.003, 0.0029, 0.998, (0.996, 0.9991), {"volume": ChannelGain(0.998, 0.0014)})


def make_traces():
    rng = np.random.default_rng(1)
    time = 0.02 * np.arange(WINDOWS)
    spool = 300e-6 * np.sin(0.7 * time) * np.sin(3.1 * time)
    against = {
        "spool_m": spool,
        "velocity_m_s": 0.1 * np.cos(0.7 * time + 0.3),
        "position_m": 0.03 * np.sin(0.7 * time + 0.3),
        "load_pressure_pa": 1e6 * np.sin(0.31 * time),
        "oil_temperature_k": 313.15 + 0.1 * time,
        "acceleration_m_s2": np.sin(2.0 * time),
    }
    traces = {}
    for channel, unit, level, size in (("volume", "m³/s", 2e-7, 9e-6), ("force", "N", 2.0, 0.0)):
        noise = level * rng.standard_normal((3, WINDOWS))
        missing = -size * np.clip(spool / 85e-6, -1.0, 1.0)
        after = noise[0] if size else missing + noise[0]
        before, floor, measured = missing + noise[0], np.full(WINDOWS, level), 300.0 * level * np.sin(time)
        traces[channel] = ChannelTrace(channel, unit, 100.0 * level, time, measured, before, after, floor, noise[1], against)
    return traces


def make_found(**changes):
    found = Diagnosis(
        verdict="effect",
        missing=(),
        stages={
            "force_balance": QUIET,
            "flow": QUIET._replace(nrmse_before=0.077, exceeds=True),
            "valve": QUIET,
            "sensors": StageResult(judged=False, why_not="needs two sensors of one quantity"),
        },
        causes=(CAUSE,),
        unknown_stage=None,
        depends_on=(),
        partial=(),
        gain=GAIN,
        rig=RIG,
        extended=RIG.with_effects(
            (EffectUse("valve_dead_zone", EFFECTS.load("valve_dead_zone").Parameters(91.2e-6, 80.1e-6)),)
        ),
        traces=make_traces(),
        sensitivities=(
            Sensitivity("coulomb_shift", "offset", 0.62, "N"),
            Sensitivity("valve_null_bias", "opening", 2.5e-7, "m"),
            Sensitivity("mass_shift", "factor", 0.0123, "1"),
            Sensitivity("pressure_sensor_gain", "gain", 1.8e17, "1"),
        ),
        not_judged={"coupling_stiffness": "needs disturbance_displacement_m"},
        remarks=("0.7 % of load_pressure_pa are missing or outliers and were left out",),
        seed=0,
        wall_s=12.3,
    )
    return replace(found, **changes)


def consistent():
    traces = {name: trace._replace(before=trace.noise, after=trace.noise) for name, trace in make_traces().items()}
    stages = {**make_found().stages, "flow": QUIET}
    return make_found(verdict="consistent", causes=(), gain=None, extended=RIG, stages=stages, traces=traces)


def unknown(**changes):
    trace = make_traces()["volume"]
    wrong = QUIET._replace(nrmse_before=0.077, nrmse_after=0.06, exceeds=True, unexplained=True, depends_on=("spool_m",))
    given = {
        "verdict": "unknown",
        "causes": (),
        "gain": None,
        "extended": RIG,
        "unknown_stage": "flow",
        "depends_on": ("spool_m", "load_pressure_pa"),
        "partial": ("turbulent_leakage",),
        "stages": {**make_found().stages, "flow": wrong},
        "traces": {**make_traces(), "volume": trace._replace(after=0.8 * trace.before)},
    }
    return make_found(**given | changes)


def insufficient():
    nothing = StageResult(judged=False, why_not="needs position_m")
    return make_found(
        verdict="insufficient",
        missing=("flow: needs position_m",),
        stages=dict.fromkeys(("force_balance", "flow", "valve", "sensors"), nothing),
        causes=(),
        gain=None,
        extended=RIG,
        traces={},
        sensitivities=(),
        not_judged={},
    )


TIME = np.linspace(0.0, 20.0, 2001)
FREE_RUN = FreeRun(
    TIME,
    (
        Followed("position_m", 0.03 * np.sin(TIME), 0.03 * np.sin(TIME) + 0.001 * TIME, 0.03 * np.sin(TIME), 0.4, 0.001),
        Followed("load_pressure_pa", 1e6 * np.cos(TIME), 9e5 * np.cos(TIME), 1e6 * np.cos(TIME), 0.1, 0.002),
    ),
    ("the position integrates what is not known",),
)
BENEFIT = ControllerBenefit(
    (
        BenefitCase("10 kN held", 1e4, Steady(120.0, 30.0), Steady(60.0, 15.0)),
        BenefitCase("10 kN sine", 1e4, Steady(None, None, "diverged: leaves the stroke"), Steady(70.0, 15.0)),
    ),
    same_controller=False,
)
NEXT = NextExperiment(
    "break_away",
    "slow moves with rests between them",
    "valve_hysteresis is wrong most in the load pressure",
    (Pair("valve_dead_zone", "valve_hysteresis", 42.0),),
    {"duration": 8.0},
)
FOLLOWS = Consequences(FREE_RUN, BENEFIT, Proposal(NEXT, "", ()), ("something went wrong",))


@pytest.fixture
def report(written, without_plotly):
    def write(found, follows=FOLLOWS, source="axis.csv, 60 s"):
        return written(lambda path: write_diagnosis_report(found, path, follows, source))

    return write


def shown(text):
    return html.unescape(re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL))


# --- the sentence ------------------------------------------------------------------------------


def test_the_verdict_names_the_cause_in_units_people_read():
    sentence, good = verdict_sentence(make_found())
    assert sentence == (
        "The simulation lacks a dead zone of the valve: positive 91.2 ± 0.8 µm, negative 80 ± 1 µm (95 %);"
        " the rest of the flow balance is within the noise."
    )
    assert good is False


def test_the_verdict_of_two_causes_says_what_is_lacking_and_what_is_wrong():
    coulomb = Cause(
        "coulomb_shift", 1.0, (), "force_balance", "friction", {"offset": Estimate(-47.6, 0.3, "N")}, {}, 9.0, 9.0, (), "force"
    )
    stages = {**make_found().stages, "force_balance": QUIET._replace(nrmse_before=0.1, exceeds=True)}
    sentence, _ = verdict_sentence(make_found(causes=(coulomb, CAUSE), stages=stages))
    assert sentence == (
        "The Coulomb friction is 47.6 ± 0.6 N lower than in the rig file (95 %), and the simulation lacks a dead zone of the"
        " valve: positive 91.2 ± 0.8 µm, negative 80 ± 1 µm (95 %); the rest of the force balance and the flow balance is"
        " within the noise."
    )


def test_the_verdict_of_a_partial_answer_is_one_short_sentence():
    mass = CAUSE._replace(name="mass_shift", parameters={"factor": Estimate(1.1, 0.01, "1")})
    others = [mass, *(CAUSE._replace(name=name) for name in ("viscous_shift", "coulomb_shift"))]
    unlikely = CAUSE._replace(name="constant_load", probability=0.3)
    gain = GAIN._replace(closed_fraction=0.9999)
    left = QUIET._replace(nrmse_before=0.077, nrmse_after=0.004, noise_floor=0.001, exceeds=True)
    found = make_found(
        verdict="partial",
        causes=(CAUSE._replace(probability=0.8), unlikely, *others),
        gain=gain,
        unknown_stage="flow",
        depends_on=("velocity_m_s", "position_m", "spool_m"),
        stages={**make_found().stages, "flow": left},
    )
    assert verdict_sentence(found)[0] == (
        "The simulation lacks a dead zone of the valve: positive 91.2 ± 0.8 µm, negative 80 ± 1 µm (95 %), with a"
        " probability of 80 %, the moving mass is 10 ± 2 % higher than in the rig file (95 %), and 2 more causes add to the"
        " error; this explains more than 99.9 % of the error; less likely: a constant force; the rest in the flow"
        " balance, 4.0 times the noise, depends on velocity and position, and no known effect explains it."
    )


def test_an_unlikely_cause_is_one_of_its_candidates():
    """A leak with a share of 95 % and a probability of 27 %."""
    leak = CAUSE._replace(
        name="internal_leakage_shift",
        probability=0.27,
        channel="volume",
        share=0.95,
        parameters={"added": Estimate(1.18e-11, 0.015e-11, "m^5/(N s)")},
        equivalent_to=(),
        rivals=(RIVAL._replace(behind=2.0), TWIN._replace(behind=40.0)),
    )
    sentence, _ = verdict_sentence(make_found(causes=(leak,)))
    assert sentence.startswith(
        "The error in the flow balance has one of these causes, undecided by these data: the leakage past the piston"
        " (1.18 ± 0.03 cm³/(s bar) higher than in the rig file), or "
    )
    assert "hysteresis" not in sentence
    better, _ = verdict_sentence(make_found(causes=(leak._replace(probability=1e-4, rivals=(RIVAL._replace(behind=-12.0),)),)))
    assert f"undecided by these data: {EFFECTS.load(RIVAL.name).WORDS.noun}" in better
    alone, _ = verdict_sentence(make_found(causes=(leak._replace(rivals=()),)))
    assert "is uncertain: nearest is the leakage past the piston (1.18 ± 0.03" in alone
    assert "with a probability of 27 %" in alone
    certain, _ = verdict_sentence(make_found(causes=(leak._replace(probability=1.0),)))
    assert certain == (
        "The leakage past the piston is 1.18 ± 0.03 cm³/(s bar) higher than in the rig file (95 %); the rest of the flow"
        " balance is within the noise."
    )


def test_a_spring_that_the_load_cell_sees_already_is_recognised(report):
    stiffness = RIG.plant.spring_stiffness
    spring = Cause(
        "spring_rate_shift", 1.0, (), "force_balance", "mechanics", {"added": Estimate(-stiffness, 0.01 * stiffness, "N/m")},
        {}, 9.0, 9.0, (), "force",
    )  # fmt: skip
    found = make_found(causes=(spring,))
    assert "the recorded force contains no force of the spring" in verdict_sentence(found)[0].lower()
    assert "check where the load cell sits" in shown(report(found))
    half = spring._replace(parameters={"added": Estimate(-0.5 * stiffness, 0.01 * stiffness, "N/m")})
    assert "inspect which spring is mounted" in shown(report(make_found(causes=(half,))))


def test_motion_is_asked_for_where_the_signals_are_there(report):
    still = StageResult(judged=False, why_not=NEEDED_MOTION["flow"])
    found = replace(insufficient(), stages={**make_found().stages, "sensors": QUIET, "flow": still})
    text = shown(report(found))
    assert "The signals are there, but they move too little" in text
    assert row(text, "Next steps", "flow balance")[1] == "recorded"
    assert "Record the signals below together" in shown(report(insufficient()))


@pytest.mark.parametrize(("stage", "said"), [("valve", True), ("force_balance", False)])
def test_two_causes_in_one_stage_are_doubted(stage, said):
    second = CAUSE._replace(name="valve_null_bias", stage=stage)
    assert any("may stand for a single effect" in text for text in caveats(make_found(causes=(CAUSE, second)))) == said


@pytest.mark.parametrize("doubted", [False, True])
def test_a_cause_that_leaves_much_is_doubted(doubted):
    left = QUIET._replace(nrmse_before=0.1, nrmse_after=0.004, noise_floor=0.001, exceeds=True, leaves_much=doubted)
    (said,) = (text for text in caveats(make_found(stages={"flow": left})) if "times the noise remains" in text)
    assert ("outside the list" in said) == doubted
    assert ("essentially right" in said) != doubted


def test_an_incident_is_told_beside_the_stage():
    assert left_over(QUIET) == "only noise"
    assert left_over(QUIET._replace(nrmse_after=0.01)) == "no significant error"
    assert left_over(QUIET._replace(incident=(40.0, 42.49))) == "only noise, except between 40.0 and 42.5 s"


def test_the_verdict_says_what_stays_open():
    open_cause = CAUSE._replace(probability=0.6, equivalent_to=("valve_hysteresis",), rivals=(TWIN, RIVAL))
    sentence, _ = verdict_sentence(make_found(causes=(open_cause,)))
    assert "undecided by these data: a dead zone of the valve (positive" in sentence
    assert ", or a hysteresis of the valve" in sentence


def test_the_verdict_does_not_claim_more_than_is_closed():
    stages = {**make_found().stages, "flow": QUIET._replace(nrmse_before=0.077, nrmse_after=0.006, exceeds=True)}
    sentence, _ = verdict_sentence(make_found(stages=stages))
    assert "this removes 99.8 % of the error beyond the noise from the flow balance" in sentence


def test_what_is_above_the_noise_is_not_said_to_be_noise():
    slight = QUIET._replace(nrmse_before=0.0061, nrmse_after=0.0061, noise_floor=0.001)
    sentence, good = verdict_sentence(replace(consistent(), stages={**consistent().stages, "valve": slight}))
    assert "only noise remains in force balance and flow balance and no significant error in valve" in sentence
    assert "(0.61 % of its largest term, noise 0.10 %)" in sentence
    assert good is True


def test_the_verdicts_without_a_cause():
    sentence, good = verdict_sentence(consistent())
    assert sentence.startswith(
        "The simulation agrees with this recording: only noise remains in force balance, flow balance and valve;"
    )
    assert "the data are insufficient to assess sensor agreement" in sentence
    assert good is True
    sentence, good = verdict_sentence(unknown())
    assert sentence == (
        "The simulation's flow balance is wrong by 7.7 % of its largest term, noise 0.30 %; the error depends on spool and load"
        " pressure, and no known effect explains it; nearest is a leakage through an orifice."
    )
    assert good is False
    assert "the error depends on no recorded signal alone" in verdict_sentence(unknown(depends_on=()))[0]
    sentence, good = verdict_sentence(insufficient())
    assert "insufficient to assess the simulation" in sentence
    assert good is None


def test_agreement_names_the_sizes_that_would_have_shown_and_the_numbers_corrected_before():
    quiet = replace(
        consistent(),
        sensitivities=(
            Sensitivity("mass_shift", "factor", 0.023, "1"),
            Sensitivity("coulomb_shift", "offset", 24.0, "N"),
            Sensitivity("bulk_modulus_shift", "factor", 1e3, "1"),
        ),
        corrected={"plant.moving_mass": Fitted(49.0, Estimate(70.0, 0.2, "kg"), None)},
    )
    sentence, _ = answer(quiet)
    assert "a wrong value shows from these sizes on: the Coulomb friction 24 N, the moving mass 2.3 %." in sentence
    assert sentence.endswith("which were corrected first: moving_mass 70.0 ± 0.2 kg instead of 49 kg.")
    assert "shows from" not in answer(replace(quiet, sensitivities=()))[0]
    named, _ = answer(replace(make_found(), corrected=quiet.corrected))
    assert "rig file (95 %)" not in named


def test_without_a_change_a_stage_that_cannot_be_evaluated_is_named_if_there_is_one():
    healthy = BaselineSummary(("old.csv",), {}, {}, (), (), {}, {})
    partly = replace(consistent(), baseline=healthy)
    assert "; sensor agreement cannot be evaluated." in answer(partly)[0]
    entirely = replace(partly, stages={**partly.stages, "sensors": QUIET})
    assert "natural spread. " in answer(entirely)[0]


def test_an_unknown_error_in_a_second_stage_and_the_short_time_that_holds_it_are_stated():
    found = unknown()
    spool = np.linspace(-2e-4, 1e-4, WINDOWS)
    rare = found.traces["volume"]._replace(after=np.where(spool < -1.9e-4, 1e-5, 1e-7), against={"spool_m": spool})
    force = found.stages["force_balance"]._replace(nrmse_before=0.05, unexplained=True, exceeds=True, depends_on=("time_s",))
    found = unknown(traces={**found.traces, "volume": rare}, stages={**found.stages, "force_balance": force})
    sentence, _ = verdict_sentence(found)
    assert re.search(r"Half of its square lies in the [12]\.?\d? % of the time with spool below −19\d µm\.", sentence)
    assert sentence.endswith("The force balance has an unexplained error, too: 5.0 % of its largest term, noise 0.30 %.")


@pytest.mark.parametrize("name", EFFECTS.names())
def test_an_effects_words_fit_the_sentences_they_stand_in(name):
    words = EFFECTS.load(name).WORDS
    # Names occur in lists and before brackets, advice in a cell of a table.
    assert re.fullmatch(r"(the |an? )?[^\s,;.()][^,;.()]*", words.noun)
    for advice in (words.inspect, words.measure, words.change):
        assert re.fullmatch(r"[a-z][^.]*[^.\s]( \d[^.]*)?", advice.replace("limits.", "").replace("sensors.", "")), (
            "one sentence"
        )
    own = {
        *Plant._fields,
        *FRICTION_KEYS,
        *two_chamber.Parameters._fields,
        *four_edges.Parameters._fields,
        *(f"sensors.{sensor}" for sensor in SENSED),
        "limits.position",
        "limits.spool",
    }
    named = re.findall(r"`([^`]+)`", words.change)
    assert set(named) <= {*own, name, "effects", "bias", "gain", "bandwidth", "delay", "ehls identify"}, "no key of a rig file"
    article = words.noun.split()[0]
    assert article == "the" or words.lacking, f"'has {words.noun} wrong' is not English"


@pytest.mark.parametrize("said", ["noun", "inspect", "measure", "change"])
def test_no_two_effects_have_the_same_words(said):
    said_of = {}
    for name in EFFECTS.names():
        said_of.setdefault(getattr(EFFECTS.load(name).WORDS, said), []).append(name)
    assert [names for names in said_of.values() if len(names) > 1] == []


@pytest.mark.parametrize(
    ("lacking", "said"), [(True, "lacks a gremlin: positive"), (False, "A gremlin differs from that in the rig file")]
)
def test_the_sentence_uses_the_words_of_the_effects_file(monkeypatch, lacking, said):
    monkeypatch.setattr(
        EFFECTS.load(CAUSE.name), "WORDS", Words("a gremlin", "listen", "record it", "remove it", lacking=lacking)
    )
    assert said in verdict_sentence(make_found())[0]


# --- the page ----------------------------------------------------------------------------------

MADE = {
    "effect": (
        make_found,
        [
            "Measured and simulated",
            "Next steps",
            "Shares and sizes",
            "Runner-up and caveats",
            "The cause",
            "Stage by stage",
            "Alternatives",
            "Gain of the controller",
            "Next experiment",
            "Residuals against every signal",
            "Free run",
            "Sensitivity",
            "Method",
        ],
    ),
    "consistent": (
        consistent,
        [
            "Measured and simulated",
            "Caveats",
            "Stage by stage",
            "Residuals against every signal",
            "Free run",
            "Sensitivity",
            "Method",
        ],
    ),
    "unknown": (
        unknown,
        [
            "Measured and simulated",
            "Next steps",
            "Unexplained",
            "Caveats",
            "Stage by stage",
            "Residuals against every signal",
            "Free run",
            "Sensitivity",
            "Method",
        ],
    ),
    "insufficient": (insufficient, ["Next steps", "Caveats", "Method"]),
}


@pytest.mark.parametrize("kind", MADE)
def test_each_verdict_has_its_parts_and_sound_figures(report, kind):
    make, expected = MADE[kind]
    follows = FOLLOWS if kind == "effect" else FOLLOWS._replace(proposal=None, controller=None)
    text = report(make(), NOTHING if kind == "insufficient" else follows)
    assert parts(text) == expected
    check(text)


def test_the_main_picture_shows_the_residual_against_what_explains_it(report):
    pictures = [
        figure for title, figure in panels(report(make_found())).items() if title.startswith(("Given model", "Extended model"))
    ]
    (_, layout), (_, other) = pictures
    assert layout == other, "before and after have the same axes"
    assert layout["xaxis"]["title"]["text"] == "spool [µm]"
    assert layout["yaxis"]["title"]["text"] == "flow balance, residual [cm³/s]"
    dots = [trace for traces, _ in pictures for trace in traces if trace.get("mode") == "markers"]
    before, after = (numbers(trace["y"]) for trace in dots)
    assert sum(numbers(trace["x"]).size for trace in dots) <= 4000
    assert np.max(np.abs(before)) == pytest.approx(9.0, rel=0.15)
    assert np.std(after) == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize(("make", "channel"), [(make_found, "volume"), (consistent, "force")])
def test_the_first_picture_shows_measured_and_simulated_above_the_residual(report, make, channel):
    found = make()
    trace = found.traces[channel]
    title, (traces, layout) = next(iter(panels(report(found)).items()))
    assert title == f"{CHANNEL_WORDS[channel].short.capitalize()}, measured and simulated"
    above = {line["name"].split(",")[0]: numbers(line["y"]) for line in traces if line["yaxis"] == "y"}
    below = {line["name"].split(",")[0]: numbers(line["y"]) for line in traces if line["yaxis"] == "y2"}
    # The force balance's residual is the force the model requires less the one measured.
    sign = 1.0 if channel == "force" else -1.0
    assert set(below) == {"noise", *above} - {"measured"}
    for name in set(above) - {"measured"}:
        assert above[name] == pytest.approx(above["measured"] + sign * below[name], abs=1e-3 * float(np.ptp(above["measured"])))
    drawn = np.max(np.abs(below["given model"])) / np.max(np.abs(above["measured"]))
    assert drawn == pytest.approx(np.max(np.abs(trace.before)) / np.max(np.abs(trace.measured)), rel=1e-3)
    titles = [layout[axis]["title"]["text"].split(" [")[0] for axis in ("yaxis", "yaxis2")]
    assert titles == [CHANNEL_WORDS[channel].measured, "residual"]


def test_the_shares_are_bars_of_the_removable_error(report):
    causes = (CAUSE._replace(share=0.5), CAUSE._replace(name="valve_null_bias", share=0.4))
    gain = GAIN._replace(channels={"volume": ChannelGain(0.7, 0.05)})
    traces, layout = panels(report(make_found(causes=causes, gain=gain)))["Shares of the error"]
    lengths = {trace["name"]: trace["x"] for trace in traces}
    assert lengths["closed by the causes"] == pytest.approx([70.0, 0.0, 0.0])
    assert lengths["remains"] == pytest.approx([30.0, 0.0, 0.0])
    assert lengths["returns without that cause"] == pytest.approx([0.0, 50.0, 40.0])
    assert [note["text"] for note in layout["annotations"]] == [
        "flow balance: 70 % closed, 30 % remains",
        "50 %: a dead zone of the valve",
        "40 %: a null bias of the valve",
    ]


def test_a_partial_answer_shows_what_remains_over_each_signal_it_depends_on(report):
    found = make_found(verdict="partial", unknown_stage="flow", depends_on=("spool_m", "load_pressure_pa"))
    text = report(found)
    assert parts(text)[2:6] == ["Shares and sizes", "Runner-up and caveats", "Remainder", "The cause"]
    assert [title for title in panels(text) if title.endswith("measured and simulated")] == [
        "Flow balance, measured and simulated"
    ]
    assert row(text, "Next steps", "valve_dead_zone")[1:] == [re.sub("`", "", said) for said in ADVICE]
    assert row(text, "Next steps", "spool")[1] == "the valve's flow curve: lands, notches, flow forces"
    titles = [title for title in panels(text) if title.startswith("Unexplained")]
    assert [title.split(":")[0] for title in titles] == ["Unexplained, over the spool", "Unexplained, over the load pressure"]


def test_friction_is_drawn_along_the_motion_where_that_tells_more():
    trace = make_traces()["force"]
    residual = np.sign(trace.against["velocity_m_s"]) * 1e-4 * trace.against["load_pressure_pa"]
    found = make_found(traces={"force": trace._replace(before=residual, after=trace.noise)})
    cause = Cause("pressure_dependent_friction", 1.0, (), "force_balance", "friction", {}, {}, 9.0, 9.0, (), "force")
    view = view_of_cause(found, cause)
    assert (view.channel, view.signal, view.along) == ("force", "load_pressure_pa", True)
    assert view.explained > 0.95


def test_a_signal_an_effect_acts_by_is_shown_where_another_explains_no_more():
    trace = make_traces()["volume"]
    found = make_found(traces={"volume": trace._replace(before=np.full(WINDOWS, 1e-5), after=trace.noise)})
    assert view_of_cause(found, CAUSE).signal == "spool_m"
    assert view_of_cause(make_found(traces={}), CAUSE) is None


def test_the_spectrum_keeps_the_power_of_a_residual_with_holes():
    rng = np.random.default_rng(0)
    time = 0.02 * np.arange(6000)
    kept = rng.random(6000) > 0.1
    frequency, density = drawn.spectrum(time[kept], rng.standard_normal(6000)[kept])
    assert trapezoid(density**2, frequency) == pytest.approx(1.0, rel=0.05)


def test_small_pictures_of_every_channel(report):
    text = report(make_found())
    found = panels(text)
    _, layout = found["Flow balance"]
    titles = [axis["title"]["text"] for name, axis in layout.items() if name.startswith("xaxis")]
    for title in ("time [s]", "velocity [mm/s]", "position [mm]", "load pressure [bar]", "spool [µm]", "oil temperature [°C]"):
        assert title in titles
    assert "frequency [Hz]" in titles
    assert "Force balance" in found
    assert "The extension changes nothing here" in text


def test_causes_rivals_and_gain_are_in_the_tables(report):
    text = report(make_found(causes=(CAUSE._replace(equivalent_to=("valve_hysteresis",), rivals=(TWIN, RIVAL), share=0.87),)))
    cause = row(text, "Shares and sizes", "valve_dead_zone")
    assert (cause[3], cause[5]) == ("87 %", "91.20 ± 0.40 µm")
    twin = row(text, "Alternatives", "valve_hysteresis")
    assert twin[1] == "equal"
    assert "cannot be distinguished" in twin[4]
    rival = row(text, "Alternatives", "valve_gain_shift")
    assert (rival[1], rival[2]) == (">\u202f1\u202f000\u202f000\u202f:\u202f1", "52 %")
    assert "The runner-up to a dead zone of the valve is the gain of the valve: it leaves 48 % of the error" in shown(text)
    assert "falls from 7.7 % to 0.30 % of its largest term, noise 0.29 %" in shown(text)
    assert "99.8 % of the mean square beyond the noise is closed (95 % interval 99.6 % to 99.9 %)" in shown(text)
    held, sine = (row(text, "Gain of the controller", name) for name in ("10 kN held", "10 kN sine"))
    assert (held[1], held[3]) == ("120 N | rms 30.0 N", "−50 %")
    assert sine[1] == "diverged: leaves the stroke"
    assert rows(text, "Next experiment")[1][1] == "42 σ"


def test_a_controller_that_knows_nothing_new_is_said_to(report):
    same = BENEFIT._replace(same_controller=True)
    assert "the same controller" in shown(report(make_found(), FOLLOWS._replace(controller=same)))
    none = ControllerBenefit((), same_controller=False, reason="no force can be controlled")
    assert "no force can be controlled" in shown(report(make_found(), FOLLOWS._replace(controller=none)))


def test_what_would_have_been_noticed_is_in_units_people_read(report):
    text = report(make_found())
    part = "Sensitivity"
    assert row(text, part, "valve_null_bias")[2] == "0.25 µm"
    assert row(text, part, "mass_shift")[2] == "1.2 %"
    assert row(text, part, "coulomb_shift")[2] == "0.62 N"
    assert row(text, part, "pressure_sensor_gain")[2] == "none in its range"
    assert "needs disturbance_displacement_m" in row(text, part, "coupling_stiffness")[1]


def test_what_to_keep_in_mind(report):
    leaky = {**make_found().stages, "flow": QUIET._replace(nrmse_before=0.077, nrmse_after=0.009, exceeds=True)}
    text = shown(report(make_found(stages=leaky)))
    assert "In the flow balance 3.0 times the noise remains" in text
    assert "rests on one recording" in text
    assert "0.7 % of load_pressure_pa are missing" in text
    assert "Something went wrong." in text


def test_an_unknown_cause_says_where_to_look(report):
    assert where_to_look(unknown())[0] == ("spool", "the valve's flow curve: lands, notches, flow forces")
    text = report(unknown())
    assert row(text, "Unexplained", "turbulent_leakage")
    (_, layout) = next(figure for title, figure in panels(text).items() if title.startswith("Unexplained"))
    assert layout["xaxis"]["title"]["text"] == "spool [µm]"
    check(report(unknown(depends_on=(), partial=())))


def with_term(**changes):
    at, reading = np.linspace(-0.2, 0.2, 16), Reading(240.0, 5.0, power=Power(2.04, 0.05, "odd"))
    values = -6e3 * at * np.abs(at)
    term = Term("empirical_force", "velocity_m_s", False, "N", at, values, np.full(16, 5.0), None, 0.993, 0.0, reading)
    effects = RIG.with_effects((EffectUse("empirical_force", EFFECTS.load("empirical_force").Parameters(value_0=240.0)),))
    return unknown(term=term._replace(**changes), gain=GAIN, extended=effects, unknown_stage="flow", partial=())


def shape(name, kind="", **numbers):
    return Shape(name, {key: Estimate(*number, "m/s") for key, number in numbers.items()}, kind)


def power_shape(exponent, std):
    numbers = {"size": Estimate(240.0, 1.0, "N"), "exponent": Estimate(exponent, std, "1"), "from": Estimate(0.0, 0.0, "m/s")}
    return Shape("power", numbers, "odd")


def test_a_term_found_in_the_data_is_said_and_shown(report):
    found = with_term()
    said, good = answer(found)
    assert said.endswith(
        "no known effect explains it. The data show a force that depends on velocity, odd, growing with the power 2.04 ± 0.1,"
        " up to ±240 N about its middle; it closes 99.3 % of that error on held-out data."
    )
    assert good is False
    text = report(found)
    (_, layout) = next(figure for title, figure in panels(text).items() if title.startswith("The term found"))
    assert layout["xaxis"]["title"]["text"] == "velocity [mm/s]"
    assert layout["yaxis"]["title"]["text"] == "force [N]"
    assert "Beyond the data it keeps the values at their ends" in shown(text)
    formula = replace(found, term=found.term._replace(formula=(power_shape(2.04, 0.05),)))
    assert "Beyond the data it goes on to twice their range and then keeps its value" in shown(report(formula))
    check(text)


def test_the_gain_on_other_recordings_is_said(report):
    checks = {"a.csv": {"volume": ChannelGain(0.914, 0.01), "force": ChannelGain(-0.3, 0.01)}, "b.csv": {}}
    text = report(with_term(), FOLLOWS._replace(checks=checks))
    assert "On a.csv, to which nothing was fitted, the extended model closes 91 % in the flow balance, and it is" in shown(text)
    assert "worse than the given one in the force balance." in shown(text)
    assert "On b.csv, to which nothing was fitted, there is no error to close." in shown(text)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"argument": "position_m", "period": Estimate(7.3e-3, 2e-6, "m"), "direction": 0.01},
            "turning round with the direction of motion, repeating every 7.3 mm ± 4 µm, with an amplitude of 240 N",
        ),
        (
            {"argument": "time_s", "reading": Reading(240.0, 5.0, rise=-480.0)},
            "depends on the time, always falling, up to ±240 N",
        ),
        ({"argument": "position_m", "reading": Reading(240.0, 5.0, place=0.0123)}, "acting at one place, 12.3 mm"),
        ({"effect": "empirical_friction", "magnitude": True}, "a change of friction that depends on the magnitude of velocity"),
        ({"effect": "empirical_force_reading"}, "an error of the load cell that depends on velocity"),
        (
            {"effect": "empirical_spool", "argument": "spool_m", "error": True},
            "that depends on the spool's distance from its command,",
        ),
        (
            {"factor": "load_pressure_pa", "factor_reach": 2e6},
            "in proportion to load pressure, odd, growing with the power 2.04 ± 0.1, up to ±240 N about its middle at 20 bar",
        ),
        ({"lag": Estimate(0.585, 0.003, "s")}, "depends on the changes of velocity faster than 585 ms ± 6 ms"),
        ({"argument": "position_m", "play": Estimate(2e-4, 1e-6, "m")}, "on position by a hysteresis 200 µm ± 2 µm wide"),
        (
            {
                "formula": (
                    Shape("level", {"size": Estimate(3.0, 0.1, "N")}),
                    shape("step", place=(0.0, 0.0), width=(0.05, 1e-3)),
                )
            },
            "depends on velocity, saturating within 50 mm/s ± 2 mm/s, up to",
        ),
        ({"formula": (shape("step", place=(0.02, 1e-3), width=(0.05, 1e-3)),)}, "with a step at 20 mm/s ± 2 mm/s, within"),
        (
            {"formula": (shape("bump", "odd", place=(0.02, 1e-3), width=(0.05, 1e-3)),)},
            "holding at one place, 20 mm/s ± 2 mm/s",
        ),
        ({"formula": (shape("beyond", "both", place=(0.1, 1e-3)),)}, "rising beyond ±100 mm/s ± 2 mm/s"),
        ({"formula": (power_shape(1.0, 0.0),)}, "depends on velocity, linear, up to"),
        ({"formula": (power_shape(1.5, 0.01),)}, "odd, growing with the power 1.50 ± 0.02, up to"),
    ],
)
def test_the_shape_of_a_term_is_put_into_words(changes, words):
    assert words in term_sentence(with_term(**changes).term)


def test_too_little_says_what_to_record(report):
    text = report(insufficient(), NOTHING)
    needed = row(text, "Next steps", "flow balance")
    assert "spool_m" in needed[1]
    assert "oil has to flow" in needed[2]


def test_a_free_run_that_was_given_up(report):
    lost = FREE_RUN.signals[0]._replace(before=np.full(TIME.size, np.nan), nrmse_before=None)
    text = report(make_found(), FOLLOWS._replace(free_run=FREE_RUN._replace(signals=(lost, FREE_RUN.signals[1]))))
    assert row(text, "Free run", "position")[1:] == ["–", "0.10 %"]
    check(text)
    assert "is left out" in report(make_found(), FOLLOWS._replace(free_run=FREE_RUN._replace(signals=())))


def test_text_of_others_is_escaped(report):
    text = report(make_found(remarks=("<script>alert(1)</script>",)), source="<b>axis</b>")
    assert "<script>alert" not in text
    assert "<b>axis" not in text


# --- units -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (91.2e-6, 0.4e-6, "m", "91.20 ± 0.40 µm"),
        (2.36e-3, 1e-5, "m", "2.360 ± 0.010 mm"),
        (258536.0, 120.0, "Pa", "2.5854 ± 0.0012 bar"),
        (0.004, 1e-5, "s", "4.000 ± 0.010 ms"),
        (0.95, 0.001, "1", "0.9500 ± 0.0010"),
        (4.7e-12, 1e-13, "m^5/(N s)", "0.470 ± 0.010 cm³/(s bar)"),
        (-5.6e-5, 2e-6, "N/Pa", "−5.60 ± 0.20 N/bar"),
        (105.0, 1.5, "rad/s", "105.0 ± 1.5 rad/s"),
    ],
)
def test_estimates_in_units_people_read(value, std, unit, text):
    assert units.estimate(Estimate(value, std, unit)) == text


def test_every_unit_of_an_effect_can_be_written():
    from ehls_ros.schema import declarations

    for name in EFFECTS.names():
        for declared in declarations(EFFECTS.load(name).Parameters):
            assert "^" not in units.estimate(Estimate(1.0, 0.1, declared.unit)), (name, declared.unit)


@pytest.mark.parametrize(
    ("effect", "parameter", "estimate", "said"),
    [
        ("mass_shift", "factor", Estimate(1.2, 0.01, "1"), "1.200 ± 0.010"),
        ("position_dependent_friction", "wavelength", Estimate(0.1, 1.6e7, "m"), "100 mm, not determined"),
        ("mass_shift", "factor", Estimate(1.2, np.inf, "1"), "1.2, not determined"),
        ("stribeck_shift", "velocity_factor", Estimate(50.0, 3.0, "1"), "50, the end of its range"),
        ("valve_dead_zone", "positive", Estimate(0.0, 1e-6, "m"), "0.0 ± 1.0 µm"),
    ],
)
def test_a_parameter_that_the_data_do_not_tell_says_so(effect, parameter, estimate, said):
    assert fitted(effect, parameter, estimate) == said


def test_fractions_are_written_in_per_cent():
    texts = [units.percent(share) for share in (None, 1e-9, 0.0, 0.00234, 0.52, 0.9991, -0.3)]
    assert texts == ["–", "< 0.001 %", "0 %", "0.23 %", "52 %", "99.9 %", "−30 %"]


def test_probabilities_are_never_certain():
    assert units.likely(1.0) == "> 99.9 %"
    assert units.likely(0.65) == "65 %"
