"""The monitor's report on the rig, on the dashboard's page."""

import re

import pytest

pytest.importorskip("nicegui", reason="needs the extra `dashboard`")
pytest.importorskip("websockets", reason="needs websockets to drive a browser")

from headless_browser import CHROMIUM, browser
from served import served, until

from ehls_ros.dashboard.graph import RigChange, RigCoefficient
from ehls_ros.dashboard.rig_health import HEIGHT, WIDTH, changes_list, trend, trends_table

NAN = float("nan")
LEAKAGE = RigCoefficient(
    "leakage_coefficient", 5e-12, 1e-13, "m^5/(N s)", "", (0.0, 60.0, 120.0, 180.0), (4e-12, NAN, 4.5e-12, 5e-12)
)
SCRIPT = "<img src=x onerror='window.ran = 1'>"
STRANGE = [SCRIPT, 1.0, 1.0, SCRIPT, SCRIPT, [], []]


def test_a_trend_spans_the_picture_and_breaks_where_it_was_not_told():
    path = re.search(r'd="(.*)"', trend(LEAKAGE))[1]
    assert [part[0] for part in re.findall(r"[ML][^ML]+", path)] == ["M", "M", "L"]
    xs, ys = zip(*((float(x), float(y)) for x, y in re.findall(r"([\d.]+) ([\d.]+)", path)), strict=True)
    assert (xs[0], xs[-1]) == (2.0, WIDTH - 2.0)
    # Upwards is less.
    assert (ys[0], ys[-1]) == (HEIGHT - 2.0, 2.0)


def test_a_trend_within_its_error_is_flat():
    still = LEAKAGE._replace(values=(5e-12, 5.01e-12, 5e-12, 5e-12))
    ys = [float(y) for y in re.findall(r"[\d.]+ ([\d.]+)", re.search(r'd="(.*)"', trend(still))[1])]
    assert max(ys) - min(ys) < 0.1 * HEIGHT
    assert trend(LEAKAGE._replace(times=(1.0,), values=(4e-12,))) == ""


@pytest.mark.parametrize("value", [NAN, float("inf"), 1e300, -1e-320])
def test_any_value_can_be_shown(value):
    assert "<svg" in trends_table([LEAKAGE._replace(value=value, values=(4e-12, value, 1e308, -1e308))])


def test_values_have_units_and_what_is_not_told_a_reason():
    told, grey = LEAKAGE, LEAKAGE._replace(name="moving_mass", why_not="rests <still>")
    text = trends_table([told, grey])
    assert "internal leakage" in text
    assert "0.500 ± 0.020 cm³/(s bar)" in text
    assert "rests &lt;still&gt;" in text
    assert changes_list([RigChange(SCRIPT, True, False)]).startswith('<li class=""><b>new</b> &lt;img')


@pytest.fixture(scope="module")
def server(nothing_left_behind):
    with served() as started:
        yield started


@pytest.mark.long
def test_the_tab_is_there_with_a_monitor_only_and_acknowledges(server, nothing_left_behind, tmp_path):
    if CHROMIUM is None:
        pytest.skip("needs Chromium")
    shown = "getComputedStyle(document.querySelector('[data-name=tab-rig]')).display !== 'none'"
    said = {
        "state": "watching",
        "summary": f"leakage 2.3 × {SCRIPT}",
        "changes": [[SCRIPT, True, False]],
        "coefficients": [list(LEAKAGE._replace(values=(4e-12, 4.2e-12, 4.5e-12, 5e-12))), STRANGE],
        "outside": 0.25,
    }  # fmt: skip
    with browser(tmp_path) as chromium, chromium.tab(server.address) as tab:
        tab.until("ehlsLive.last() > 0")
        assert not tab.evaluate(shown)
        server.tell(said)
        tab.until(shown)
        tab.click("[data-name=tab-rig]")
        tab.until("document.querySelectorAll('.rig svg').length === 1")
        assert tab.text("rig-summary") == said["summary"]
        assert "25 % of the last minute" in tab.evaluate("document.querySelector('.rig').innerText")
        tab.click("[data-name='acknowledge changes']")
        until(lambda: server.requests() == ["acknowledge changes"], "the button does nothing")
        server.tell(said | {"changes": [[SCRIPT, True, True]]})
        tab.until("getComputedStyle(document.querySelector('[data-name=\"acknowledge changes\"]')).display === 'none'")
        server.tell({})
        tab.until(f"!({shown})")
        assert tab.evaluate("window.ran ?? null") is None
        assert tab.complaints == []
