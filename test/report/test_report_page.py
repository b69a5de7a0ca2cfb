import re
import sys
from types import MappingProxyType

import numpy as np
import pytest
import yaml

from ehls_ros.report import page

HOSTILE = '<script>alert("x")</script> & </pre>'


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0"),
        (0.0, "0"),
        (10_000, "10\u202f000"),
        (np.int64(3), "3"),
        (9.9996, "10.0"),
        (0.012345, "0.0123"),
        (-82.35, "-82.3"),
        (12_345.6, "12\u202f346"),
        (1.5e-9, "1.50e-09"),
        (float("nan"), page.MISSING_NUMBER),
        (np.inf, page.MISSING_NUMBER),
        (None, page.MISSING_NUMBER),
        ("12", page.MISSING_NUMBER),
    ],
)
def test_numbers_are_written_for_reading(value, text):
    assert page.number(value) == text


@pytest.mark.parametrize(
    "block",
    [
        page.verdict(HOSTILE, good=False),
        page.paragraph(HOSTILE),
        page.facts([(HOSTILE, HOSTILE)]),
        page.table([HOSTILE, HOSTILE], [[HOSTILE, HOSTILE]]),
        page.collapsed(HOSTILE, HOSTILE),
        page.left_out([page.LeftOut(HOSTILE, HOSTILE)] * 5),
        page.figures([page.Panel(HOSTILE, [{"name": HOSTILE}], {"title": HOSTILE}, HOSTILE)]),
    ],
)
def test_every_block_escapes_its_text(block):
    assert "<script>alert" not in block
    assert "& </pre>" not in block


def test_the_configuration_reads_back_as_yaml():
    configuration = MappingProxyType(
        {
            "rig": MappingProxyType({"mass": np.float64(70.0), "weights": np.array([0.8, 0.2])}),
            "effects": [{"name": "end_stop", "stiffness": 1e6}],
            "title": "α̂: yes",
            "nothing": None,
            "empty": {},
        }
    )
    assert yaml.safe_load(page.as_yaml(configuration)) == {
        "rig": {"mass": 70.0, "weights": [0.8, 0.2]},
        "effects": [{"name": "end_stop", "stiffness": 1e6}],
        "title": "α̂: yes",
        "nothing": None,
        "empty": {},
    }


def test_figures_that_were_left_out_leave_no_hole():
    assert page.figures([page.LeftOut("Valve", "no spool")]) == ""
    drawn = page.figures([page.Panel("Valve", [], {}), page.LeftOut("Motion", "no position")], columns=2)
    assert "--columns: 1" in drawn
    assert "Motion" not in drawn


class WithoutProgram:
    """plotly as packaged by Ubuntu."""

    @staticmethod
    def get_plotlyjs() -> str:
        raise FileNotFoundError


@pytest.mark.parametrize("plotly", [None, WithoutProgram])
def test_without_plotly_a_page_says_so_in_place_of_its_figures(plotly, monkeypatch, tmp_path, caplog):
    monkeypatch.setitem(sys.modules, "plotly.offline", plotly)
    path = tmp_path / "report.html"
    page.write_page(path, "a run", "", [page.figures([page.Panel("Valve", [], {})])])
    assert caplog.messages == [f"{path} has no figures, which need plotly: {page.PLOTLY}"]
    text = path.read_text(encoding="utf-8")
    assert f'content: "needs plotly: {page.PLOTLY}"' in text
    assert "Plotly" not in text


def test_a_table_has_a_cell_for_every_text():
    text = page.table(["case", "error"], [["sine", "1.0 N"], ["constant", "2.0 N"]])
    assert text.count("<td>") == 2
    assert text.count('<th scope="row">') == 2


def test_shades_say_better_from_worse():
    text = page.table(["", ""], [["a", page.Entry("1", "2", 1.0)], ["b", page.Entry("3", heat=-0.5)], ["c", page.Entry("4")]])
    assert '<td style="background: rgba(213, 94, 0, 0.50)">1<small>2</small></td>' in text
    assert '<td style="background: rgba(0, 114, 178, 0.25)">3</td>' in text
    assert "<td>4</td>" in text


def test_words_stand_on_the_left_and_figures_on_the_right():
    figures = ["1.0 N", "> 99.9 %", "−3.2 ± 0.1", "± 5", "▲ 302 N", "–", "12\u202f000", "≈ 0", ""]
    text = page.table(["case", "why", "error"], [["sine", page.Entry("it drifts", "0.3 N"), figure] for figure in figures])
    assert '<th scope="col" class="words">why</th><th scope="col">error</th>' in text
    assert text.count(' class="words"') == 1 + len(figures)
    assert '<th scope="col" class="words">at</th>' in page.table(
        ["node", "at"], [["a", "before"], ["b", "never"], ["c", "1.0 s"]]
    )


def test_a_table_too_wide_for_a_phone_becomes_a_list():
    narrow, wide = (page.table(["case", "why"], [["sine", "long " * count]]) for count in (3, 20))
    assert 'class="listed"' not in narrow
    assert '<td data-column="why" class="words">' in wide


def test_text_between_backticks_is_code():
    assert page.paragraph("run `ehls identify` & <see>") == "<p>run <code>ehls identify</code> &amp; &lt;see&gt;</p>"


def test_a_part_without_blocks_has_neither_heading_nor_link():
    contents, *blocks = page.sections([("Valve", ["one", ""]), ("Motion", ["", ""]), ("Force", ["two"])])
    assert re.findall(r'href="#(.*?)"', contents) == ["valve", "force"]
    assert [block for block in blocks if not block.startswith("<h2")] == ["one", "two"]
    assert len(blocks) == 4
