"""`ehls commission` from the command line; the steps are those of test_commissioning.py."""

import pytest

from ehls_ros.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--yes"),
        (["--yes", "--period", "0"], "period"),
        (["--yes", "--bridge", "nowhere.yaml"], "nowhere.yaml"),
        (["--yes", "--lockstep", "--bridge", "comedi.yaml"], "no --lockstep"),
        (["--yes", "--margins", "-1", "30"], "0 or more"),
    ],
)
def test_bad_input_is_one_line(tmp_path, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "comedi.yaml").write_text(
        "backend: {name: comedi}\nchannels: {position: {channel: 0, scale: 0.03, range: [-10.0, 10.0]}}\n"
        "command: {channel: 0, scale: 2.0e-3, range: [-5.0, 5.0]}\n",
        encoding="utf-8",
    )
    assert main(["commission", "rig_paper", "--out", str(tmp_path / "out"), *arguments]) == 2
    [line] = capsys.readouterr().err.strip().splitlines()
    assert words in line
