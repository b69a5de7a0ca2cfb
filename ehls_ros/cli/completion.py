"""Shell completion as a static script, so that completion does not start Python."""

import argparse
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from ehls_ros.cli.arguments import Configured
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import configured_names

SHELLS = ("bash", "zsh")

FILES_AND_NAMES = {
    "bash": "{name}() {{ _shtab_compgen_files $1; compgen -W '{names}' -- $1; }}",
    "zsh": "{name}() {{ _alternative 'files:file:_files' 'names:name:({names})' }}",
}
"""Shell functions to complete an argument that is a path or the name of a file of the package."""


class PrintCompletion(argparse.Action):
    """Print the completion script and exit."""

    def __call__(self, parser: argparse.ArgumentParser, *values: object) -> None:
        """Print the script for the given shell."""
        try:
            shtab: Any = import_module("shtab")
        except ImportError:
            raise BadInput("shtab is not installed", "this Python", "pip install shtab, or apt install python3-shtab") from None
        shell = str(values[1])
        functions = {}
        for action in _actions(parser):
            if isinstance(action, Configured):
                name = f"_ehls_{action.folder or 'rigs'}"
                functions[name] = FILES_AND_NAMES[shell].format(name=name, names=" ".join(configured_names(action.folder)))
                setattr(action, "complete", {shell: name})  # noqa: B010 - shtab's attribute, unknown to argparse
            elif action.type is Path:
                setattr(action, "complete", shtab.FILE)  # noqa: B010 - the same
        print(shtab.complete(parser, shell=shell, preamble={shell: "\n".join(functions.values())}))
        parser.exit()


def add_completion(top: argparse.ArgumentParser) -> None:
    """Add ``--print-completion`` to a parser.

    Args:
        top: the parser, with all its verbs; path arguments complete file names.
    """
    top.add_argument(
        "--print-completion",
        action=PrintCompletion,
        choices=SHELLS,
        help='print shell completion; in ~/.bashrc: eval "$(ehls --print-completion bash)"',
    )


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the arguments of a parser and of its verbs."""
    for action in parser._actions:  # noqa: SLF001 - argparse has no public list
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for verb in action.choices.values():
                yield from _actions(verb)
        else:
            yield action
