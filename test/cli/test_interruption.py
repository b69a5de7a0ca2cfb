"""Ctrl-C: one line, exit code 130, and no process that keeps running."""

import os
import signal
import subprocess
import sys

from patience import PATIENCE

from ehls_ros.cli import main as entry
from ehls_ros.cli.main import main

DEAF = r"""
from functools import partial
from ehls_ros.parallel import Workers

if __name__ == "__main__":
    deaf = "import itertools, os; sum(itertools.chain(map(os.write, [1], [b'begun\\n']), range(10**12)))"
    with Workers(2) as workers:
        workers.run([partial(exec, deaf), partial(exec, deaf)])
"""
"""Long tasks inside compiled code that Python's signal handlers cannot interrupt."""


def test_ctrl_c_while_a_verb_is_loaded_is_one_line(monkeypatch, capsys):
    def interrupt(name):
        raise KeyboardInterrupt

    monkeypatch.setattr(entry.VERBS, "load", interrupt)
    assert main(["diagnose", "axis.csv"]) == 130
    assert capsys.readouterr().err == "ehls diagnose: interrupted\n"


def test_ctrl_c_ends_processes_inside_compiled_code(tmp_path):
    script = tmp_path / "deaf.py"
    script.write_text(DEAF)
    process = subprocess.Popen([sys.executable, script], start_new_session=True, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert [process.stdout.readline() for _ in range(2)] == ["begun\n", "begun\n"]
        os.killpg(process.pid, signal.SIGINT)
        # End of the output: no process that inherited it is left.
        process.communicate(timeout=PATIENCE)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    assert process.returncode == -signal.SIGINT
