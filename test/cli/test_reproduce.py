"""`ehls reproduce` from the command line."""

import contextlib
import io
import json
from pathlib import Path

import pytest

from ehls_ros.cli.main import main


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory) -> tuple[Path, list[str]]:
    """The folder of one run, and the lines it printed."""
    out, printed = tmp_path_factory.mktemp("reproduce"), io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert main(["reproduce", "--quick", "--json", "--out", str(out)]) == 0
    return out, printed.getvalue().splitlines()


@pytest.fixture(scope="module")
def folder(reproduced) -> Path:
    return reproduced[0]


@pytest.mark.long
def test_table_3_holds_the_papers_number_beside_ours(folder):
    cells = json.loads((folder / "table3.json").read_text())["cells"]
    assert {(c["controller"], c["reference"], c["disturbance"]) for c in cells} == {
        (controller, reference, disturbance)
        for controller in ("SIC", "FASMC I", "FASMC II")
        for reference in ("constant", "sine")
        for disturbance in ("fd1", "fd2")
    }
    for cell in cells:
        assert cell["relative_percent"] == pytest.approx(cell["max_error_n"] / 100.0)
        assert cell["paper_convergence_s"] > 0.0
        assert {"paper_percent", "convergence_s"} <= set(cell)


@pytest.mark.long
def test_everything_and_the_report_are_there(folder):
    everything = json.loads((folder / "reproduction.json").read_text())
    assert everything["quick"] is True
    assert everything["theory"]["error_bound_n"] == pytest.approx(78.07, abs=0.01)
    assert (folder / "report.html").stat().st_size > 1e5


@pytest.mark.long
def test_the_table_is_printed_with_the_times(reproduced):
    folder, lines = reproduced
    assert json.loads(lines[-1]) == json.loads((folder / "table3.json").read_text())
    printed = "\n".join(lines)
    assert "(91.3)" in printed
    assert "to compile or load the kernels" in printed


@pytest.mark.parametrize("workers", ["0", "-2"])
def test_no_workers_is_bad_input(tmp_path, capsys, workers):
    assert main(["reproduce", "--quick", "--workers", workers, "--out", str(tmp_path / "out")]) == 2
    assert f"--workers is {workers}" in capsys.readouterr().err


def test_a_file_in_the_folders_place_is_bad_input(tmp_path, capsys):
    (tmp_path / "out").touch()
    assert main(["reproduce", "--quick", "--out", str(tmp_path / "out")]) == 2
    assert "cannot be written" in capsys.readouterr().err
