"""Runs the Python blocks and `ehls` commands of a page in order, in the present folder: ``follow_page.py PAGE MODULE...``.

The modules are those the page is about: they have to have been loaded in the end.
"""

import sys

from docs_snippets import EHLS, blocks, commands

from ehls_ros.cli.main import main


def follow(page: str) -> None:
    names: dict[str, object] = {}
    for block in blocks(page):
        if block.mark not in {"", "slow"}:
            continue
        if block.language == "python":
            exec(compile(block.text, str(block), "exec"), names)
        elif block.language == "sh":
            for command in commands(block):
                program, *words = command.words
                if program not in EHLS:
                    sys.exit(f"{block}: {command.shown} is not run here: mark the block with why not")
                if main(words) != 0:
                    sys.exit(f"{block}: {command.shown} failed")


if __name__ == "__main__":
    page, *modules = sys.argv[1:]
    follow(page)
    if missing := set(modules) - sys.modules.keys():
        sys.exit(f"{page}: {', '.join(missing)} was never loaded")
