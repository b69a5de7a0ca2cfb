"""Completion of the command line in shells, as a script that is written once and starts no Python at a press of the tab key."""

import argparse
from collections.abc import Iterator
from pathlib import Path

import shtab

SHELLS = ("bash", "zsh")


class PrintCompletion(argparse.Action):
    """Prints the script and ends."""

    def __call__(self, parser: argparse.ArgumentParser, *values: object) -> None:
        """Print the script for the shell that was named."""
        print(shtab.complete(parser, shell=str(values[1])))
        parser.exit()


def add_completion(top: argparse.ArgumentParser) -> None:
    """Add ``--print-completion`` to a parser that has its verbs already.

    Args:
        top: the parser; where it takes a path, files are offered.
    """
    for action in _actions(top):
        if action.type is Path:
            setattr(action, "complete", shtab.FILE)  # noqa: B010 - shtab's own attribute, which argparse does not know
    top.add_argument(
        "--print-completion",
        action=PrintCompletion,
        choices=SHELLS,
        help='print completion for a shell: eval "$(ehls --print-completion bash)" in ~/.bashrc',
    )


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the arguments of a parser and of its verbs."""
    for action in parser._actions:  # noqa: SLF001 - argparse lists them nowhere else
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for verb in action.choices.values():
                yield from _actions(verb)
        else:
            yield action
