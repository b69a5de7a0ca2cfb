"""`ehls programme`: its summary of a programme, and its rainflow counts against those of the unrolled one."""

import json

import numpy as np
import pytest

from ehls_ros.cli.main import main
from ehls_ros.control.programme.declaration import Parameters
from ehls_ros.control.programme.expansion import Programme
from ehls_ros.experiments.programme_summary import in_bins, rainflow_of
from ehls_ros.schema import parse

rainflow = pytest.importorskip("rainflow", reason="needs `make setup WITH=programme`")

CYCLES = {"block": "cycles", "mean": 1e3, "amplitude": 500.0, "frequency": 10.0, "count": 7}
PULSES = {"block": "cycles", "waveform": "haversine", "mean": 2e3, "amplitude": 300.0, "frequency": 5.0, "count": 5}
RECORDED = {"block": "spectrum", "points": [[0.0, 10.0], [0.5, 900.0], [1.1, -200.0]], "count": 6}
BLOCKS = [
    {"block": "ramp", "to": 400.0, "rate": 2e3},
    {"repeat": 5, "blocks": [CYCLES, {"repeat": 4, "blocks": [PULSES]}, RECORDED]},
]


def test_rainflow_counts_are_those_of_the_unrolled_programme():
    programme = Programme(parse(Parameters, {"blocks": BLOCKS}, "test"))
    unrolled = programme.sample(np.arange(0.0, programme.duration + 1e-3, 1e-3))[:, 0]
    expected = sorted(rainflow.count_cycles(unrolled, ndigits=-1))
    found = rainflow_of(programme)
    for size, number in expected:
        assert sum(n for own, _, n in found if abs(own - size) < 10.0) == pytest.approx(number, abs=1e-9), size
    assert sum(n for _, _, n in found) == pytest.approx(sum(n for _, n in expected))
    assert sum(n for _, _, n in in_bins(found)) == pytest.approx(sum(n for _, n in expected))


def test_it_prints_blocks_and_counts_and_what_the_rig_cannot_do(tmp_path, capsys):
    file = tmp_path / "mine.yaml"
    file.write_text("title: mine\nblocks: [{block: cycles, name: huge, amplitude: 3.0e+4, frequency: 1.0, count: 4}]\n")
    assert main(["programme", str(file), "--json", "--out", str(tmp_path / "mine.html")]) == 0
    printed = capsys.readouterr().out
    summary = json.loads(printed.splitlines()[-1])
    assert (summary["load_cycles"], summary["duration_s"], summary["ramps"]) == (4, 4.5, 1)
    assert summary["blocks"][0]["peak_n"] == pytest.approx(3e4)
    assert summary["rainflow"][0][0] == pytest.approx(6e4, rel=1e-3)
    assert "! huge reaches 30000 N, the rig's limit is" in printed
    assert "huge" in (tmp_path / "mine.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["fatigue", "service_load"])
def test_programmes_of_the_package_are_within_the_rigs_limits(name, capsys):
    assert main(["programme", name]) == 0
    assert "!" not in capsys.readouterr().out
