"""Entry point of the `ehls` command: runs a verb and turns errors into exit codes."""

import argparse
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

from ehls_ros import __version__
from ehls_ros.cli.completion import add_completion
from ehls_ros.cli.verbs import VERBS
from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.process import end

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit codes."""


def parser(only: str = "") -> argparse.ArgumentParser:
    """Return the parser.

    Args:
        only: the requested verb, since loading them all takes over a second; all are loaded if it is not a verb.
    """
    top = argparse.ArgumentParser(prog="ehls", description="Electro-hydraulic load simulator: run, record, report.")
    top.add_argument("--version", action="version", version=__version__)
    verbs = top.add_subparsers(dest="verb", metavar="VERB", required=True)
    names = VERBS.names()
    requested = only.replace("-", "_")
    for name in (requested,) if requested in names else names:
        verb = VERBS.load(name)
        verb.arguments(verbs.add_parser(name.replace("_", "-"), help=verb.HELP, description=verb.HELP))
    add_completion(top)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: words after `ehls`; by default those of the process.

    Returns:
        The exit code.
    """
    words = sys.argv[1:] if arguments is None else arguments
    verb = words[0] if words else ""
    try:
        options = parser(verb).parse_args(words)
        return VERBS.load(options.verb.replace("-", "_")).run(options)
    except BadInput as error:
        print(f"ehls {verb}: {error}", file=sys.stderr)
        return BAD_INPUT
    except WorkFailed as error:
        print(f"ehls {verb}: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        print(f"ehls {verb}: interrupted", file=sys.stderr)
        return INTERRUPTED


def entry() -> NoReturn:
    """Run the command line as a process, and exit with its code."""
    # Read when the library of linear algebra is loaded: its threads gain nothing here and slow down those of a diagnosis.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    code = main()
    if "rclpy" in sys.modules:
        end(code)
    sys.exit(code)


if __name__ == "__main__":
    entry()
