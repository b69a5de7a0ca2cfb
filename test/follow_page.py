"""Runs the Python blocks and commands of a page in order, in the present folder: ``follow_page.py [--slow] PAGE MODULE...``.

With ``--slow``, those marked as slow run too. Their output is compared with the page. The modules are those documented by the
page: they must be loaded at the end.
"""

import io
import os
import subprocess
import sys
from contextlib import redirect_stdout

from docs_snippets import EHLS, PYTHON, ROOT, Block, Command, Unknown, blocks, check_output, commands

from ehls_ros.cli.main import main

try:
    import ehls_msgs.msg._loader_state  # noqa: F401 - shows whether the messages are built, where the folder is on the path
except ImportError:
    MARKS = {""}
else:
    MARKS = {"", "ros"}


def follow(page: str) -> None:
    names: dict[str, object] = {}
    printed = ""
    for block in blocks(page):
        if block.mark == "output":
            if printed:
                check_output(block, printed)
            continue
        with redirect_stdout(io.StringIO()) as out:
            if block.mark in MARKS and block.language == "python":
                exec(compile(block.text, str(block), "exec"), names)
            elif block.mark in MARKS and block.language == "sh":
                for command in commands(block):
                    run(block, command)
        printed = out.getvalue()


def run(block: Block, command: Command) -> None:
    """Run a command; the tests of the project run in its folder."""
    program, *words = command.words
    if program in EHLS:
        done = main(words)
    elif program in PYTHON and words[:2] == ["-m", "pytest"]:
        environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
        tests = subprocess.run([sys.executable, *words], cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        print(tests.stdout)
        done = tests.returncode
    else:
        raise Unknown(f"{command.shown} is not run here: mark the block with why not")
    if done != 0:
        raise Unknown(f"{command.shown} failed")


if __name__ == "__main__":
    page, *modules = (argument for argument in sys.argv[1:] if argument != "--slow")
    if "--slow" in sys.argv:
        MARKS.add("slow")
    follow(page)
    if missing := set(modules) - sys.modules.keys():
        sys.exit(f"{page}: {', '.join(missing)} was never loaded")
