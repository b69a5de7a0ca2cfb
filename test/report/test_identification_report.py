import html
import math
import re

import numpy as np
import pytest
from found_friction import (
    ALIKE,
    CONSTANT,
    ESTIMATES,
    FRICTION,
    SPEEDS,
    SPRING,
    STATIC_DEVIATION,
    STATIC_RESIDUAL,
    ends,
    make_fit,
    make_found,
    make_motion,
    make_motions,
    make_rig,
    make_static,
    without_presliding,
    without_sliding,
)
from report_pages import check, effort, numbers, panels, parts, row, rows

from ehls_ros.estimate import Estimate
from ehls_ros.identification.presliding import nodes
from ehls_ros.report.identification import write_identification_report
from ehls_ros.report.identification_findings import correlation_remark, criteria_remark, noise_remark, percent, verdict_sentence
from ehls_ros.report.quantities import as_given, written

PARTS = ("Coefficients", "Static friction", "Presliding", "Joint fit", "Correlations", "Search", "How it was made")
TITLES = [
    "Stribeck curve",
    "Stribeck curve at low speed",
    "Residual of the static fit",
    "Hysteresis loop",
    "Mean branch with nodes",
    "Joint fit: sweep.csv",
    "Residual over time: sweep.csv",
    "Residual against velocity: sweep.csv",
    "Joint fit: sine.csv",
    "Residual over time: sine.csv",
    "Residual against velocity: sine.csv",
    "Convergence of the search",
]


@pytest.fixture
def whole_report(tmp_path):
    def write(found, **options):
        path = tmp_path / "report.html"
        write_identification_report(found, path, **options)
        return path.read_text(encoding="utf-8")

    return write


@pytest.fixture
def report(whole_report, monkeypatch):
    """Return the report without the five megabytes of plotly.js."""
    monkeypatch.setattr("ehls_ros.report.page.plotly_js", lambda: "")
    return whole_report


def drawn(text, title):
    traces, layout = panels(text)[title]
    return {trace["name"]: (numbers(trace["x"]), numbers(trace["y"])) for trace in traces}, layout


def left_out(text):
    return re.findall(r'<p class="left-out"><b>(.*?)</b> is left out: (.*?)\.</p>', html.unescape(text))


def shown(text):
    return html.unescape(re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL))


def test_the_verdict_says_what_is_known_how_surely():
    sentence, good = verdict_sentence(make_found())
    assert sentence == (
        "Fc 640.806 N ± 0.007, Fs 865.0 N ± 0.4, Vs 2.036 mm/s ± 0.004, δ 0.878 ± 0.001, σf 7.2650 N s/mm ± 0.0001"
        " and C 1\u202f642 N/s ± 31 (± one standard error); two friction elements explain the loop;"
        " viscous_damping cannot be separated from viscous_coefficient."
    )
    assert good is True


def test_the_verdict_names_what_is_missing():
    sentence, good = verdict_sentence(without_presliding())
    assert "the hysteresis loop is not identified; not identifiable: element_stiffness and element_weight;" in sentence
    assert good is None
    sentence, good = verdict_sentence(without_sliding())
    assert sentence.endswith("not identifiable: viscous_coefficient, viscous_damping and stribeck_velocity.")
    assert good is False


@pytest.mark.parametrize(
    "remark",
    ["static_force has a standard error of 31 %.", "static_force and moving_mass cannot be told apart (correlation +0.9995)."],
)
def test_a_vague_coefficient_is_something_to_look_into(remark):
    told = {name: estimate for name, estimate in ESTIMATES.items() if name != "static_force"}
    found = make_found(estimates=told, not_identifiable=("static_force", "viscous_damping"), remarks=(remark, ALIKE))
    sentence, good = verdict_sentence(found)
    assert "not identifiable: static_force;" in sentence
    assert "Fs" not in sentence
    assert good is False


def test_a_search_that_has_not_converged_is_something_to_look_into(report):
    found = make_found(static=make_static(converged=False))
    sentence, good = verdict_sentence(found)
    assert sentence.endswith("the search has not converged.")
    assert good is False
    assert "not converged: allow more evaluations" in report(found)


def test_elements_asked_for_are_not_called_found():
    assert "the loop is fitted with two friction elements, as asked for" in verdict_sentence(make_found(criteria={2: 3.0}))[0]


def test_all_parts_in_order_with_figures_that_have_units(report):
    text = report(make_found())
    assert tuple(parts(text)) == PARTS
    assert "(Bayesian information criterion …)" not in text  # stated under Presliding
    assert list(panels(text)) == TITLES
    assert left_out(text) == []
    check(text)


@pytest.mark.parametrize(
    ("value", "std", "digits", "texts"),
    [
        (640.8058, 0.0074, 2, ("640.8058", "0.0074", "640.7913", "640.8203")),
        (2265301.8, 850.2, 2, ("2\u202f265\u202f302", "850", "2\u202f263\u202f635", "2\u202f266\u202f968")),
        (2.0355e-3, 3.8e-6, 2, ("0.0020355", "0.0000038", "0.0020281", "0.0020429")),
        (640.8, 0.0996, 1, ("640.8", "0.1", "640.6", "641.0")),
        (-9.81, 1e-4, 2, ("−9.81000", "0.00010", "−9.81020", "−9.80980")),
        (3.0, 0.0, 2, ("3", "0", "3", "3")),
        (3.5, math.inf, 2, ("3.5", "–", "–", "–")),
        (3.5, math.nan, 2, ("3.5", "–", "–", "–")),
        (math.nan, 0.1, 2, ("–", "–", "–", "–")),
    ],
)
def test_a_value_has_the_digits_its_error_leaves(value, std, digits, texts):
    assert tuple(written(value, std, digits)) == texts


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (640.8, "640.8"),
        (1.884e6, "1\u202f884\u202f000"),
        (0.089, "0.089"),
        (2.031e-5, "0.00002031"),
        (-9.81, "−9.81"),
        (0.0, "0"),
    ],
)
def test_a_given_number_keeps_its_digits(value, text):
    assert as_given(value) == text


@pytest.mark.parametrize(("part", "text"), [(0.0123, "1.2 %"), (9e-6, "< 0.001 %"), (0.0, "0 %"), (math.inf, "–")])
def test_parts_are_written_as_percentages(part, text):
    assert percent(part) == text


def test_coefficients_are_told_with_error_interval_and_unit(report):
    text = report(make_found())
    header, *_ = rows(text, "Coefficients")
    assert header[2:] == ["value", "standard error", "in % of the value", "95 % interval", "unit"]
    fc = row(text, "Coefficients", "coulomb_force")
    assert fc == ["coulomb_force | Coulomb friction Fc", "Fc", "640.8058", "0.0074", "0.0012 %", "640.7913 to 640.8203", "N"]
    vs = row(text, "Coefficients", "stribeck_velocity")
    assert vs[2:] == ["0.0020357 | 2.0357 mm/s", "0.0000038", "0.19 %", "0.0020283 to 0.0020431", "m/s"]
    k = row(text, "Coefficients", "element_stiffness_1")
    assert k[:3] == [
        "element_stiffness_1 | presliding stiffness of element 1",
        "k1",
        "4\u202f000\u202f000 | 4\u202f000.00 N/mm",
    ]
    g = row(text, "Coefficients", "gravity")
    assert g[2:] == ["−9.81000", "0.00010", "0.0010 %", "−9.81020 to −9.80980", "m/s²"]


def test_old_values_stand_beside_the_new_ones(report):
    old = make_rig(FRICTION._replace(coulomb_force=600.0, stribeck_exponent=0.0, viscous_coefficient=7264.98))
    text = report(make_found(), before=old)
    assert rows(text, "Coefficients")[0][-1] == "rig file before"
    assert row(text, "Coefficients", "coulomb_force")[-1] == "600 | +6.8 %"
    assert row(text, "Coefficients", "stribeck_exponent")[-1] == "0"
    assert row(text, "Coefficients", "viscous_coefficient")[-1] == "7\u202f264.98 | unchanged"
    assert row(text, "Coefficients", "element_weight_1")[-1] == "0.6 | unchanged"


def test_elements_of_another_number_are_not_compared(report):
    old = make_rig(FRICTION._replace(element_stiffness=(1e6,), element_weight=(1.0,)))
    assert row(report(make_found(), before=old), "Coefficients", "element_stiffness_1")[-1] == "– | 1 element"


def test_what_is_not_identifiable_is_named_with_value_and_reason(report):
    text = report(without_sliding())
    viscous = row(text, "Coefficients", "viscous_coefficient")
    assert viscous[1:3] == ["σf", "7\u202f000"]
    assert viscous[3] == f"viscous_coefficient has a standard error of 74 %; {ALIKE[:-1]}"
    assert row(text, "Coefficients", "viscous_damping")[2:] == ["60", ALIKE[:-1]]
    assert row(text, "Coefficients", "stribeck_velocity")[2:] == ["0.002", "nothing slides steadily"]
    assert "<p>Nothing slides steadily.</p>" in text
    assert text.count("has a standard error of 74 %") == 1
    elements = row(report(without_presliding()), "Coefficients", "element_stiffness")
    assert elements[1:] == ["k", "4\u202f000\u202f000, 1\u202f000\u202f000", "no presliding is recorded"]


def test_an_element_that_is_not_told_is_the_one_of_its_number(report):
    sorted_rig = make_rig(FRICTION._replace(element_stiffness=(1e6, 4e6), element_weight=(0.4, 0.6)))
    remarks = ("element_stiffness_2 has a standard error of 40 %.",)
    found = make_found(rig=sorted_rig, not_identifiable=("element_stiffness_2",), remarks=remarks)
    assert row(report(found), "Coefficients", "element_stiffness_2")[1:3] == ["k2", "1\u202f000\u202f000"]


def test_the_stribeck_curve_goes_through_the_classes_and_loses_its_viscous_part(report):
    lines, _ = drawn(report(make_found()), "Stribeck curve")
    x, y = lines["data, classes of velocity"]
    assert x == pytest.approx(1e3 * make_static().velocity)
    assert y == pytest.approx(make_static().force)
    at, force = lines["static fit"]
    fits = np.interp([8.0, 150.0], at[np.isfinite(at)], force[np.isfinite(at)])
    assert fits == pytest.approx([640.0 + 225.0 * math.exp(-4.0) + 7.06 * 8.0, 640.0 + 7.06 * 150.0], rel=1e-3)
    at, force = lines["without the viscous part"]
    assert force[[0, -1]] == pytest.approx([-640.0, 640.0])
    assert at[[0, -1]] == pytest.approx([-150.0, 150.0])
    assert np.isnan(at).sum() == 1  # the jump at standstill is no line


def test_the_joint_fits_curve_is_the_new_rig_files(report):
    rig = make_rig(FRICTION._replace(coulomb_force=600.0))
    lines, _ = drawn(report(make_found(rig=rig)), "Stribeck curve")
    assert lines["joint fit"][1][-1] == pytest.approx(600.0 + 7.06 * 150.0)
    assert lines["static fit"][1][-1] == pytest.approx(640.0 + 7.06 * 150.0)


def test_low_speeds_are_shown_until_the_curve_has_come_down(report):
    lines, layout = drawn(report(make_found()), "Stribeck curve at low speed")
    down = 1.2 * 2.0 * math.log(50.0)
    assert layout["xaxis"]["range"] == pytest.approx([0.0, 1.02 * down])
    for way in ("forwards", "backwards"):
        assert sorted(lines[way][0]) == pytest.approx([2.0, 4.0, 8.0])
        assert (lines[way][1] > 0).all()
    assert lines["static fit"][0][-1] == pytest.approx(down)


@pytest.mark.parametrize("exponent", [0.2, 1e-6, 4.0, math.nan])
def test_low_speeds_end_with_the_data_and_begin_below_them(report, exponent):
    static = make_static()
    static = static._replace(friction=static.friction._replace(stribeck_exponent=exponent))
    _, layout = drawn(report(make_found(static=static)), "Stribeck curve at low speed")
    _, end = layout["xaxis"]["range"]
    assert 3.0e3 * SPEEDS[0] <= end <= 1.02e3 * SPEEDS[-1] * (1 + 1e-9)


def test_the_static_fits_residual_is_what_the_data_have_over_it(report):
    text = report(make_found())
    lines, layout = drawn(text, "Residual of the static fit")
    assert layout["xaxis"]["type"] == "log"
    speed, left = lines["backwards"]
    assert left == pytest.approx(np.where(np.isclose(speed, 4.0), STATIC_RESIDUAL, 0.0), abs=1e-3)
    assert lines["forwards"][1] == pytest.approx(np.zeros(5), abs=1e-3)
    traces, _ = panels(text)["Residual of the static fit"]
    assert numbers(traces[0]["error_y"]["array"]) == pytest.approx(np.full(5, STATIC_DEVIATION))
    usual = STATIC_RESIDUAL / math.sqrt(10)
    assert f"Root mean square {usual:.3f} N, {usual / STATIC_DEVIATION:.2f} times the noise" in text


def test_the_loop_is_the_elements_force_against_displacement(report):
    lines, _ = drawn(report(make_found()), "Hysteresis loop")
    at, force = lines["recorded, sine.csv"]
    _, fitted = lines["fitted"]
    motions, residuals = make_motions()
    assert at == pytest.approx(1e3 * (motions[1].position - 0.05), abs=1e-3)
    assert (np.abs(np.abs(force) - 500.0) < 0.3).all()
    assert np.isfinite(fitted).tolist() == np.isfinite(residuals[1]).tolist()
    assert np.nanmax(np.abs(np.abs(fitted) - 500.0)) < 1e-2
    assert not any("sweep" in name for name in lines)


def test_a_long_recording_is_drawn_to_its_last_loops(report):
    motions, residuals = make_motions(9000)
    text = report(make_found(motions=tuple(motions), fit=make_fit(residuals)))
    at, _ = drawn(text, "Hysteresis loop")[0]["recorded, sine.csv"]
    assert len(at) == 4000
    assert at[-1] == pytest.approx(1e3 * (motions[1].position[-1] - 0.05), abs=1e-3)


def test_nodes_lie_on_the_sum_of_the_elements_ramps(report):
    text = report(make_found())
    lines, _ = drawn(text, "Mean branch with nodes")
    d, _ = ends()
    order = np.argsort(d)
    way, force = lines["nodes"]
    assert way == pytest.approx(1e3 * d[order])
    at, both = lines["all elements"]
    assert np.interp(way, at, both) == pytest.approx(force)
    assert force[-1] == pytest.approx(2.0 * FRICTION.static_force)
    at, first = lines["element 1, k = 4\u202f000 N/mm"]
    assert first.max() == pytest.approx(2.0 * 0.6 * 865.0)
    assert lines["mean of 10 branches"][0][-1] == pytest.approx(2.4)
    cells = row(text, "Presliding", "N1")
    assert cells == ["N1", "0.2595 mm", "1\u202f298 N", "5\u202f000 N/mm", "4\u202f000 N/mm", "0.600"]
    assert row(text, "Presliding", "N2")[3:] == ["1\u202f000 N/mm", "1\u202f000 N/mm", "0.400"]


def test_one_element_is_its_own_sum(report):
    one = FRICTION._replace(element_stiffness=(2e6,), element_weight=(1.0,))
    _, residuals = make_motions()
    found = make_found(fit=make_fit(residuals, one), nodes=tuple(nodes(*ends(one))), criteria={1: 3.0, 2: 8.0})
    lines, _ = drawn(report(found), "Mean branch with nodes")
    assert set(lines) == {"mean of 10 branches", "element 1, k = 2\u202f000 N/mm", "nodes"}
    assert "One friction element explains the loop." in report(found)


def test_the_criterion_is_told_against_the_chosen_number():
    assert criteria_remark(make_found()) == (
        "Two friction elements explain the loop. The Bayesian information criterion (BIC) changes by +909 with 1, +6 with 3"
        " and +1\u202f247 with 4; one more element has to lower it by 100."
    )


def test_elements_that_give_way_together_are_said_to_act_as_one():
    alike = FRICTION._replace(element_stiffness=(2e6, 1e6), element_weight=(0.66, 0.34))
    remark = criteria_remark(make_found(nodes=tuple(nodes(*ends(alike)))))
    assert remark.endswith("They give way within 3.0 % of the same travel, so they act as one.")
    assert "act as one" not in criteria_remark(make_found())


def test_measured_is_fitted_and_left_over(report):
    text = report(make_found())
    lines, layout = drawn(text, "Joint fit: sine.csv")
    time_s, measured = lines["measured"]
    motions, residuals = make_motions()
    assert measured == pytest.approx(motions[1].force, rel=1e-5)
    counted = np.isfinite(residuals[1])
    fitted, left = lines["fitted, where it counts"][1], lines["measured less fitted"][1]
    assert fitted[np.isfinite(fitted)] == pytest.approx((motions[1].force - residuals[1])[counted], rel=1e-5)
    assert left[np.isfinite(left)] == pytest.approx(residuals[1][counted], abs=1e-5)
    assert lines["± one standard deviation, 0.600 N"][1] == pytest.approx([-0.6, -0.6])
    assert layout["xaxis"]["title"]["text"] == "time since 0.05000 s [s]"
    assert time_s[[0, -1]] == pytest.approx([0.0, 39.9])
    assert "Blocks of 100 ms; 75 % of them count." in text


def test_the_excerpt_shows_blocks_that_count(report):
    blocks = 6000
    motions, _ = make_motions(blocks)
    left = np.full(blocks, np.nan)
    left[500:1800] = 0.1
    found = make_found(motions=(motions[0],), fit=make_fit([left]))
    _, fitted = drawn(report(found), "Joint fit: sweep.csv")[0]["fitted, where it counts"]
    _, measured = drawn(report(found), "Joint fit: sweep.csv")[0]["measured"]
    assert len(measured) <= 1500
    assert np.isfinite(fitted).sum() > 200
    everywhere = make_found(motions=(motions[0],), fit=make_fit([np.full(blocks, 0.1)]))
    assert "time since 225.1 s [s]" in report(everywhere)  # the middle: blocks 2250 to 3750 of 0.1 s


def test_what_is_left_over_is_drawn_in_time_and_against_velocity(report):
    motions, residuals = make_motions(9000)
    text = report(make_found(motions=tuple(motions), fit=make_fit(residuals)))
    kept = np.flatnonzero(np.isfinite(residuals[0]))[::3]
    (time_s, left), *_ = drawn(text, "Residual over time: sweep.csv")[0].values()
    assert left == pytest.approx(residuals[0][kept], abs=1e-6)
    assert time_s == pytest.approx(motions[0].time[kept])
    (velocity, again), *_ = drawn(text, "Residual against velocity: sweep.csv")[0].values()
    assert velocity == pytest.approx(1e3 * motions[0].velocity[kept], abs=1e-4)
    assert again.tolist() == left.tolist()
    assert "One block in 3." in text


def test_noise_is_told_against_the_sensors():
    assert noise_remark(make_found()) == "The residuals are at most 3.0 times the force sensor's noise (sine.csv)."
    noisy = make_found(fit=make_found().fit._replace(noise=(0.61, 0.3)))
    assert noise_remark(noisy).startswith("The residuals are at most 3.0 times the force sensor's noise (sweep.csv). So the")
    assert noise_remark(without_presliding()) == "The residuals are at most 1.5 times the force sensor's noise."


def test_correlations_are_shaded_and_the_strongest_named(report):
    text = report(make_found())
    assert rows(text, "Correlations")[0] == ["", "Fc", "Fs", "Vs", "δ", "σf", "C", "k1", "α1", "g"]
    assert row(text, "Correlations", "Fs")[1:5] == ["0", "1", "−0.9962", "0"]
    assert row(text, "Correlations", "Fc")[1:6] == ["1", "0", "0", "+0.52", "0"]
    assert 'style="background: rgba(0, 114, 178, 0.50)">−0.9962</td>' in text
    assert 'style="background: rgba(213, 94, 0, 0.26)">+0.52</td>' in text
    assert correlation_remark(make_found()) == "Strongest: Fs and Vs −0.996."
    weak = make_found(correlations=make_found().correlations * 0.5)
    assert correlation_remark(weak) == "None reaches 0.9 in size; the largest is −0.50, Fs and Vs."


def test_the_search_converges_in_a_figure(report):
    lines, layout = drawn(report(make_found()), "Convergence of the search")
    iteration, cost = lines["lowest cost so far"]
    assert iteration.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert np.isnan(cost[0])
    assert cost[1:].tolist() == [1e6, 1e3, 12.5, 12.5]
    assert layout["yaxis"]["type"] == "log"


def test_how_it_was_made(report):
    text = report(make_found())
    for words in ("least_squares", "6\u202f400", "9.87 s", "0.20 s", "321", "viscous, spring and constant"):
        assert words in text
    assert row(text, "How it was made", "sweep.csv") == [
        *("sweep.csv", "40.00 s", "100 ms", "400", "75 %", "1.2 %", "0.200 N", "0.300 N")
    ]


def test_without_presliding_its_figures_are_named(report):
    text = report(without_presliding())
    assert left_out(text) == [(title, "no presliding is recorded") for title in TITLES[3:5]]
    assert [title for title in TITLES if title not in panels(text)] == [*TITLES[3:5], *TITLES[8:11]]
    check(text)


def test_too_few_reversals_are_no_missing_recording(report):
    text = report(make_found(branch=None, nodes=(), criteria={}))
    assert left_out(text) == [(title, "it has too few reversals") for title in TITLES[3:5]]


def test_without_sliding_its_figures_are_named(report):
    text = report(without_sliding())
    assert [title for title, _ in left_out(text)] == [*TITLES[:3], TITLES[-1]]
    assert {reason for _, reason in left_out(text)} == {"nothing slides steadily, so there is no static fit"}
    assert "Optimiser of the static fit" not in text
    check(text)


def test_a_recording_of_which_nothing_counts_is_named(report):
    _, residuals = make_motions()
    text = report(make_found(fit=make_fit([np.full(400, np.nan), residuals[1]])))
    assert left_out(text) == [("Joint fit: sweep.csv", "none of its blocks counted")]
    assert row(text, "How it was made", "sweep.csv")[4] == "0 %"
    check(text)


def test_only_so_many_recordings_are_drawn(report):
    motions, residuals = make_motions(40)
    many = tuple(motions[0]._replace(name=f"sweep_{i}.csv") for i in range(8))
    text = report(make_found(motions=many, fit=make_fit([residuals[0]] * 8)))
    assert sum(title.startswith("Joint fit") for title in panels(text)) == 6
    assert ("Joint fit: sweep_7.csv", "only 6 recordings are drawn") in left_out(text)
    assert "from sweep_0.csv, sweep_1.csv, sweep_2.csv, sweep_3.csv and 4 more" in text
    assert row(text, "How it was made", "sweep_7.csv")[1] == "4.000 s"


def test_numbers_that_are_none_do_not_spoil_the_page(report):
    motions, residuals = make_motions()
    gap = motions[0].force.copy()
    gap[::7] = np.nan
    estimates = {
        "coulomb_force": Estimate(math.nan, math.nan, "N"),
        "static_force": Estimate(865.0, math.inf, "N"),
        "stribeck_velocity": Estimate(0.0, 0.0, "m/s"),
        "moving_mass": Estimate(math.inf, 1.0, "kg"),
    }
    static = make_static()
    broken = static.velocity.copy() * 0.0 + np.nan
    search = static.search._replace(history=np.array([math.inf, math.nan]), evaluations=2)
    found = make_found(
        estimates=estimates,
        correlations=np.full((4, 4), np.nan),
        static=static._replace(force=broken, search=search),
        criteria={1: math.inf, 2: 3.0, 3: math.nan},
        fit=make_fit([residuals[0] + gap * 0.0, residuals[1]])._replace(noise=(math.nan, 0.6), blocks=math.nan),
        motions=(motions[0]._replace(force=gap, force_noise=math.nan), motions[1]),
        wall_s=math.nan,
    )
    text = report(found, before=make_rig())
    panels(text)
    assert not re.search(r"\b(inf|nan|None)\b", shown(text))
    assert row(text, "Coefficients", "coulomb_force")[2:7] == ["–", "–", "–", "–", "N"]
    assert row(text, "Coefficients", "static_force")[2:6] == ["865", "–", "–", "–"]
    assert row(text, "Correlations", "Fc")[1:] == ["1", "–", "–", "–"]
    assert "changes by – with 1 and – with 3" in text
    assert ("Convergence of the search", "it has no finite cost") in left_out(text)


def test_nothing_found_at_all(report):
    text = report(without_sliding()._replace(estimates={}, correlations=np.zeros((0, 0))))
    assert "The data identify no coefficient of friction" in text
    assert "Correlations" not in parts(text)
    check(text)


def test_text_is_escaped(report):
    hostile = "<script>alert(1)</script>"
    motions, _ = make_motions()
    named = tuple(motion._replace(name=hostile + motion.name) for motion in motions)
    found = make_found(motions=named, remarks=(hostile,), method=hostile, not_identifiable=(hostile,))
    assert hostile not in report(found)


def test_the_page_loads_nothing(whole_report):
    text = whole_report(make_found())
    plotly = pytest.importorskip("plotly.offline", reason="plotly is not installed").get_plotlyjs()
    assert text.count(plotly) == 1
    own = text.replace(plotly, "")
    assert not re.search(r"\b(src|action|data)\s*=|href=\"(?!#)|url\(|@import|https?:|fetch\(", own)
    assert "default-src 'none'" in own


def test_the_page_of_long_recordings_is_small_and_soon_written(whole_report):
    random = np.random.default_rng(1)
    static = make_static()
    velocity = np.concatenate([-np.geomspace(0.2, 1e-3, 200), np.geomspace(1e-3, 0.2, 200)])
    classes = static._replace(velocity=velocity, force=600.0 * np.sign(velocity), deviation=np.full(400, 0.1))

    def found(size):
        small = 1.2e-3 * np.sin(np.arange(size))
        force = SPRING * small + CONSTANT
        motions = tuple(make_motion(f"sine_{i}", small, random.standard_normal(size), force) for i in range(8))
        return make_found(motions=motions, fit=make_fit([random.standard_normal(size)] * 8), static=classes)

    short, long = found(20_000), found(200_000)
    _, little = effort(lambda: whole_report(short))
    first, much = effort(lambda: whole_report(long))
    assert much < 10.0 * little
    assert len(first.encode()) < 7e6
    assert first == whole_report(long)
