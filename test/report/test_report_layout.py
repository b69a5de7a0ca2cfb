"""All reports together: each axis has its unit; in Chromium, nothing is wider than the screen or covers anything."""

import found_friction
import pytest
import test_campaign_report as campaign
import test_diagnosis_report as diagnosis
import test_experiment_report as experiment
import test_reproduction_report as reproduction
import test_rig_identification_report as rig
from report_pages import check, figures

from ehls_ros.experiments.campaign.results import results_of
from ehls_ros.recording.events import Event
from ehls_ros.report import page
from ehls_ros.report.campaign import write_campaign_report
from ehls_ros.report.diagnosis import write_diagnosis_report
from ehls_ros.report.experiment import write_experiment_report
from ehls_ros.report.identification import write_identification_report
from ehls_ros.report.rig_identification import write_rig_report
from ehls_ros.reproduction.report import write_reproduction_report

pytest.importorskip("websockets", reason="needs websockets to drive a browser")

from headless_browser import CHROMIUM, browser

RESULTS = campaign.table(40, **{campaign.K: [1.0 + run for run in range(40)], campaign.WORD: ["sine", "constant"] * 20})
COLUMNS = (
    campaign.varied(campaign.WORD, "", numeric=False),
    campaign.varied(campaign.K, "MPa/s", drawn=True),
)
SWEPT = (campaign.varied(campaign.K, "MPa/s"), campaign.varied("controller.h", "t/s"))
SWEEP = campaign.table(6, **{campaign.K: [1.0, 2.0, 4.0] * 2, "controller.h": [10.0] * 3 + [20.0] * 3})
EVENTS = (Event(None, "control_node", "k: 1.0 → 2.0"), Event(0.3, "plant_node", "armed → tripped: " + "why " * 30))
REPORTS = {
    "experiment": lambda path: write_experiment_report(experiment.make_run(), experiment.METRICS, path, EVENTS),
    "recording": lambda path: write_experiment_report(
        experiment.only(experiment.make_run(title=""), ("force_n", "position_m")), None, path, name="axis.csv"
    ),
    "campaign": lambda path: write_campaign_report(results_of(COLUMNS, RESULTS), {"title": "a", "base": {}}, [], path),
    "sweep": lambda path: write_campaign_report(results_of(SWEPT, SWEEP), {"title": "a", "base": {}}, [], path),
    "effect": lambda path: write_diagnosis_report(diagnosis.make_found(), path, diagnosis.FOLLOWS, "axis.csv"),
    "unknown": lambda path: write_diagnosis_report(diagnosis.unknown(), path),
    "insufficient": lambda path: write_diagnosis_report(diagnosis.insufficient(), path),
    "friction": lambda path: write_identification_report(found_friction.make_found(), path),
    "rig": lambda path: write_rig_report(rig.FOUND, path, before=rig.RIG),
    "reproduction": lambda path: write_reproduction_report(reproduction.make_results(), reproduction.RUNS, path),
}

DRAWN = "[...document.querySelectorAll('.figure')].every(figure => figure.querySelector('.main-svg'))"
COVERED = """
[...document.querySelectorAll('.figure')].flatMap(figure => {
  const named = (what, selector) => [...figure.querySelectorAll(selector)].map(element => {
    const {left, right, top, bottom, width} = element.getBoundingClientRect();
    return {what, text: element.textContent, left, right, top, bottom, width};
  }).filter(box => box.width);
  const whole = figure.getBoundingClientRect(), heading = figure.previousElementSibling.innerText;
  const titles = [...named('title', 'text[class*="xtitle"],text[class*="ytitle"]'), ...named('legend', '.legend .bg')];
  const ticks = [...named('tick', '.xtick text,.ytick text'), ...named('drawing', '.nsewdrag')];
  const apart = (a, b) => a.right < b.left + 1 || b.right < a.left + 1 || a.bottom < b.top + 1 || b.bottom < a.top + 1;
  const out = [...titles, ...named('label', '.annotation')]
    .filter(box => box.left < whole.left - 2 || box.right > whole.right + 2 || box.bottom > whole.bottom + 2)
    .map(box => `${heading}: ${box.what} '${box.text}' leaves the figure`);
  titles.forEach((title, place) => [...titles.slice(place + 1), ...ticks].forEach(other => {
    if (!apart(title, other)) out.push(`${heading}: ${title.what} '${title.text}' covers ${other.what} '${other.text}'`);
  }));
  return out;
})
"""


WIDER = """
[...document.querySelectorAll('main *')].filter(element => element.getBoundingClientRect().right > innerWidth + 1)
  .filter(element => !element.closest('.wide,svg')).map(element => `${element.tagName} ${element.textContent.slice(0, 60)}`)
"""


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """All reports below each other, as one page: a browser takes its time to read plotly.js."""
    path, below, write_page = tmp_path_factory.mktemp("reports") / "reports.html", [], page.write_page
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "write_page", lambda path, blocks, **_: below.extend([page.heading(path.name), *blocks]))
        for kind, write in REPORTS.items():
            write(path.with_name(kind))
    write_page(path, "All reports", "", below)
    return path


def test_every_axis_of_every_report_says_its_unit(reports):
    text = reports.read_text(encoding="utf-8")
    assert len(figures(text)) > 40
    check(text)


@pytest.fixture(scope="module")
def shown(reports, tmp_path_factory):
    with browser(tmp_path_factory.mktemp("profile")) as running, running.tab("about:blank") as opened:
        yield opened, reports.as_uri()


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
@pytest.mark.parametrize("width", [390, 1366])
def test_nothing_is_wider_than_the_screen_or_covers_anything(shown, width):
    tab, address = shown
    tab.resize(width, 900)
    tab.go("about:blank")
    tab.go(address)
    tab.until(f"location.protocol === 'file:' && document.readyState === 'complete' && {DRAWN}")
    assert tab.evaluate(WIDER) == []
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert tab.evaluate(COVERED) == []
    assert tab.complaints == []
    assert {address.split(":")[0] for address in tab.requested} <= {"file", "data", "blob", "about"}


LOW_LEGENDS = """
figures.filter(figure => {
  const [legend, plot] = ['.legend', '.nsewdrag'].map(part => figure.querySelector(part)?.getBoundingClientRect());
  return legend && figure._fullLayout.legend.y >= 1 && legend.bottom > plot.top + 1 && legend.top < plot.bottom;
}).length
"""
RELAID = "figures.every(figure => figure._fullLayout.width > 1000 || figure.clientWidth < 1000)"


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_no_legend_lies_on_its_plot_once_the_window_is_wider(shown):
    tab, address = shown
    tab.resize(710, 900)
    tab.go("about:blank")
    tab.go(address)
    tab.until(f"location.protocol === 'file:' && document.readyState === 'complete' && {DRAWN}")
    assert tab.evaluate(LOW_LEGENDS) == 0
    tab.resize(1366, 900)
    tab.until(f"{RELAID} && ({LOW_LEGENDS.strip()}) === 0", 20.0)
