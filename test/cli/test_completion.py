"""Tab completion in a shell, and colours only on a terminal."""

import os
import pty
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ehls_ros.cli.main import main
from ehls_ros.cli.verbs import VERBS

ESCAPE = "\x1b"
RED = "\x1b[31m"
ASK = """
. "$1"
shift
COMP_WORDS=("$@")
COMP_CWORD=$(($# - 1))
_shtab_ehls ehls "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def script(tmp_path, capsys):
    """Return a function that writes the completion for a shell to a file."""
    pytest.importorskip("shtab", reason="needs `pip install shtab`, or on Ubuntu python3-shtab")

    def write(shell: str) -> Path:
        with pytest.raises(SystemExit) as ended:
            main(["--print-completion", shell])
        assert ended.value.code == 0
        path = tmp_path / f"completion.{shell}"
        path.write_text(capsys.readouterr().out, encoding="utf-8")
        return path

    return write


def completions(script: Path, *words: str, folder: Path | None = None) -> set[str]:
    """Return bash's completions of the last word."""
    command = ["bash", "-c", ASK, "bash", str(script), *words]
    return set(subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout.split())


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_script_is_one_of_its_shell(script, shell):
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    subprocess.run([shell, "-n", str(script(shell))], check=True)


def test_zsh_is_told_every_verb(script):
    text = script("zsh").read_text(encoding="utf-8")
    assert text.startswith("#compdef ehls")
    assert all(f"    {name.replace('_', '-')}:" in text for name in VERBS.names())


def test_bash_completes_verbs_options_choices_and_files(script, tmp_path):
    bash = script("bash")
    assert completions(bash, "ehls", "") >= {name.replace("_", "-") for name in VERBS.names()}
    assert completions(bash, "ehls", "exp") == {"experiment"}
    assert completions(bash, "ehls", "experiment", "--tim") == {"--timing"}
    assert completions(bash, "ehls", "experiment", "--timing", "") == {"lockstep", "realtime"}
    assert completions(bash, "ehls", "run", "plant") == {"plant_sim_node"}
    assert completions(bash, "ehls", "run", "sic") == {"sic_node"}
    (tmp_path / "my_rig.yaml").touch()
    assert "my_rig.yaml" in completions(bash, "ehls", "experiment", "my_r", folder=tmp_path)
    assert completions(bash, "ehls", "experiment", "sine_", folder=tmp_path) == {"sine_fd1", "sine_fd2"}
    rigs = {"rig_paper", "rig_paper_measured", "rig_single_rod"}
    assert completions(bash, "ehls", "diagnose", "--rig", "rig_", folder=tmp_path) == rigs
    assert "my_rig.yaml" in completions(bash, "ehls", "identify", "--rig", "my_r", folder=tmp_path)


PROBLEM = """
from argparse import Namespace
from ehls_ros.cli.checks import Finding
from ehls_ros.cli.verbs import doctor
doctor.CHECKS = (lambda: Finding("tide", "problem", "too high"),)
doctor.run(Namespace(clean=False, json=False))
"""
"""`ehls doctor`, which shows problems in red, with a single check."""


def on_a_terminal(**variables: str) -> str:
    """Return its output to a terminal."""
    environment = {name: value for name, value in os.environ.items() if name not in {"NO_COLOR", "FORCE_COLOR"}}
    ours, theirs = pty.openpty()
    try:
        command = [sys.executable, "-c", PROBLEM]
        environment |= {"TERM": "xterm", **variables}
        subprocess.run(command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment, check=True)
        return os.read(ours, 1 << 16).decode()
    finally:
        os.close(theirs)
        os.close(ours)


def test_colours_are_for_terminals_that_want_them(monkeypatch):
    assert f"{RED}problem" in on_a_terminal()
    plain = on_a_terminal(NO_COLOR="1")
    assert "problem" in plain
    assert RED not in plain
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    piped = subprocess.run([sys.executable, "-c", PROBLEM], check=True, capture_output=True, text=True)
    assert "problem" in piped.stdout
    assert ESCAPE not in piped.stdout + piped.stderr


@pytest.mark.parametrize("arguments", [["--help"], ["experiment", "--help"], ["foxglove", "--help"]])
def test_help_that_is_piped_has_no_colours(arguments, capsys):
    with pytest.raises(SystemExit):
        main(arguments)
    shown = capsys.readouterr().out
    assert "usage: ehls" in shown
    assert ESCAPE not in shown
