"""The pages of examples/ with data: their commands are valid, and reproduce the stated results."""

import json
import shlex
from pathlib import Path

import pytest

from ehls_ros.cli.main import main, parser

ROOT = Path(__file__).parents[2]


def commands(page):
    """Return the arguments of each command on a page of the examples."""
    lines = (ROOT / "examples" / page / "README.md").read_text().splitlines()
    return [shlex.split(line)[1:] for line in lines if line.startswith("    .venv/bin/ehls ")]


@pytest.mark.parametrize("page", ["rotary", "seals"])
def test_every_command_is_valid_and_its_files_are_there(page):
    assert commands(page)
    for words in commands(page):
        options = parser().parse_args(words)
        for path in (*options.data, *options.baseline, options.rig, options.columns):
            assert (ROOT / path).is_file()


@pytest.mark.long
@pytest.mark.parametrize(("page", "number", "verdict"), [("rotary", 0, "insufficient"), ("seals", 0, "unchanged")])
def test_what_the_page_says_comes_out(page, number, verdict, tmp_path, monkeypatch, capsys):
    words = commands(page)[number]
    words[words.index("--out") + 1] = str(tmp_path)
    monkeypatch.chdir(ROOT)
    assert main([*words, "--threads", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["verdict"] == verdict
