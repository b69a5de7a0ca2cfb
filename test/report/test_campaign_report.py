import html

import numpy as np
import pytest
from report_pages import check, numbers, panels, parts, row, rows

from ehls_ros.experiments.campaign.plan import Column
from ehls_ros.experiments.campaign.results import quantile, results_of
from ehls_ros.report.campaign import MAX_GROUPS, MAX_ROWS, write_campaign_report
from ehls_ros.report.campaign_findings import rank_correlation, verdict_sentence

K, MASS, WORD = "controller.k", "rig.plant.moving_mass", "reference"


def varied(path, unit, *, numeric=True, drawn=False):
    return Column(path, unit, numeric, drawn)


def table(count, **columns):
    """Return a table of successful runs, with the given columns replaced."""
    ordinary = {
        "run": list(range(count)),
        "draw": [0] * count,
        "max_error_n": [10.0 + run for run in range(count)],
        "convergence_s": [0.5] * count,
        "error": [None] * count,
    }
    return ordinary | columns


def page(tmp_path, results, *columns):
    path = tmp_path / "report.html"
    write_campaign_report(results_of(columns, results), {"title": "a <study>", "base": {}}, [("Seed", "7")], path)
    text = path.read_text(encoding="utf-8")
    check(text)
    return text


@pytest.fixture
def draws(tmp_path):
    """Two references, fifty draws each: the error grows with k and is independent of the mass."""
    random = np.random.default_rng(1)
    k, mass = random.uniform(1.0, 2.0, 100), random.uniform(60.0, 80.0, 100)
    results = table(
        100,
        max_error_n=(10.0 * k).tolist(),
        **{K: k.tolist(), MASS: mass.tolist(), WORD: ["sine", "constant"] * 50, "seed": list(range(100))},
    )
    columns = (varied(WORD, "", numeric=False), varied(K, "MPa/s", drawn=True), varied(MASS, "kg", drawn=True))
    return results, (*columns, varied("seed", "1", drawn=True))


def test_draws_show_their_distribution_and_what_the_error_goes_with(draws, tmp_path):
    results, columns = draws
    text = page(tmp_path, results, *columns)
    assert parts(text) == ["Groups", "Draws", "Largest errors", "How it was made"]
    drawn = panels(text)
    assert list(drawn) == ["Distribution of the largest error", "Correlation with the largest error", K, MASS]
    traces, layout = drawn["Correlation with the largest error"]
    # The strongest comes first; the seed is no parameter.
    assert layout["yaxis"]["ticktext"] == [MASS, K]
    for trace in traces:
        mass, k = numbers(trace["x"])
        assert k == pytest.approx(1.0)
        assert abs(mass) < 0.5
    assert f"sine: {K} (+1.0)" in text
    assert "[MPa/s]" in drawn[K][1]["xaxis"]["title"]["text"]


def test_the_distribution_counts_runs_without_an_error(draws, tmp_path):
    results, columns = draws
    results["max_error_n"][0] = None
    results["error"][0] = "BadInput: refused"
    traces, _ = panels(page(tmp_path, results, *columns))["Distribution of the largest error"]
    tops = {trace["name"]: numbers(trace["y"]).max() for trace in traces}
    assert tops == {"sine": pytest.approx(98.0), "constant": pytest.approx(100.0)}


def test_a_sweep_of_two_numbers_is_drawn_as_lines_and_maps(tmp_path):
    k, h = (axis.ravel() for axis in np.meshgrid([1.0, 2.0, 4.0], [10.0, 20.0]))
    results = table(6, max_error_n=(k * h).tolist(), **{K: k.tolist(), "controller.h": h.tolist()})
    drawn = panels(page(tmp_path, results, varied(K, "MPa/s"), varied("controller.h", "t/s")))
    assert list(drawn) == [K, "controller.h", f"{K} and controller.h"]
    median, low, high = (numbers(trace["y"]) for trace in drawn[K][0])
    assert (median.tolist(), low.tolist(), high.tolist()) == ([15, 30, 60], [10, 20, 40], [20, 40, 80])
    [heat], _ = drawn[f"{K} and controller.h"]
    assert numbers(heat["customdata"]).tolist() == [10, 20, 40, 20, 40, 80]
    assert heat["colorbar"]["title"]["text"] == "largest error [N]"


def test_the_worst_and_the_failed_are_listed_with_their_reasons(tmp_path):
    lost = "BadInput: mass & more"
    results = table(30, **{K: [1.0 + run for run in range(30)]})
    for run in (3, 4):
        results["error"][run], results["max_error_n"][run] = lost, None
    results["convergence_s"][29] = None
    text = page(tmp_path, results, varied(K, "MPa/s"))
    assert [cells[0] for cells in rows(text, "Largest errors")[1:]] == [str(run) for run in range(29, 29 - MAX_ROWS, -1)]
    assert row(text, "Largest errors", "29")[1:] == ["39.0 N", "never", "30.00"]
    assert row(text, "Failed runs", "3")[1:3] == [lost, "4.000"]
    assert "2 failed; 1 never converged" in html.unescape(text)
    assert row(text, "Groups", "all runs")[1:3] == ["30", "2"]
    assert "<study>" not in text


def test_no_run_with_a_force_error_leaves_no_empty_figure(tmp_path):
    results = table(3, max_error_n=[None] * 3, convergence_s=[None] * 3, **{K: [1.0, 2.0, 3.0]})
    text = page(tmp_path, results, varied(K, "MPa/s"))
    assert parts(text) == ["Groups", "How it was made"]
    assert panels(text) == {}


def test_many_groups_are_all_in_the_table_and_the_rest_is_told(tmp_path):
    count = MAX_GROUPS + 3
    results = table(2 * count, **{WORD: [f"r{run // 2}" for run in range(2 * count)], K: [1.0, 2.0] * count})
    text = page(tmp_path, results, varied(WORD, "", numeric=False), varied(K, "MPa/s"))
    assert len(rows(text, "Groups")) == count + 1
    assert len({trace["name"] for trace in panels(text)[K][0]}) == MAX_GROUPS
    assert "the table has 3 more" in text


def test_quantiles_are_values_that_were_reached():
    values = np.array([4.0, 1.0, np.nan, 3.0, 2.0])
    assert [quantile(values, share) for share in (0.5, 0.75, 1.0)] == [2.0, 3.0, 4.0]
    assert np.isnan(quantile(np.array([np.nan]), 0.5))


def test_rank_correlation_sees_order_alone():
    x = np.array([1.0, 2.0, np.nan, 3.0, 4.0])
    assert rank_correlation(x, np.exp(5 * x)) == pytest.approx(1.0)
    assert rank_correlation(x, -(x**3)) == pytest.approx(-1.0)
    assert np.isnan(rank_correlation(x, np.ones(5)))


def test_the_verdict_is_good_only_where_every_run_ended_and_converged():
    assert verdict_sentence(results_of((), table(4)))[1]
    assert not verdict_sentence(results_of((), table(2, error=[None, "lost"])))[1]
    sentence, good = verdict_sentence(results_of((), table(2, convergence_s=[0.1, None])))
    assert "1 never converged, the worst among them" in sentence
    assert good is False
    assert verdict_sentence(results_of((), table(2, max_error_n=[None, 5.0])))[1] is None
