"""Arguments that several verbs share: their declaration, and the checks of their values."""

import argparse
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import configured

if TYPE_CHECKING:
    from ehls_ros.recording.columns import ColumnMap


class Configured(argparse.Action):
    """Resolve a file: the path if it exists, otherwise the package's file of that name."""

    def __init__(self, option_strings: list[str], dest: str, folder: str = "", **options: object) -> None:
        """Set the folder of the package's files of this kind.

        Args:
            option_strings: the option's names.
            dest: the attribute that takes the path.
            folder: see :func:`ehls_ros.experiments.files.configured`.
            options: further options of argparse.
        """
        super().__init__(option_strings, dest, **options)  # type: ignore[arg-type]
        self.folder = folder

    def __call__(self, parser: ArgumentParser, namespace: Namespace, values: object, option_string: str | None = None) -> None:
        """Store the resolved path."""
        setattr(namespace, self.dest, configured(Path(str(values)), self.folder))


def add_configured(parser: ArgumentParser, name: str, folder: str, about: str, metavar: str | None = None) -> None:
    """Add a file given by its path, or by the name of a file of the package.

    Args:
        parser: of the verb.
        name: of the argument, or of the option with its dashes.
        folder: of the package's files: "experiments", "campaigns", "programmes"; empty: rig files.
        about: help text.
        metavar: its name in the help text; by default that of the argument.
    """
    parser.add_argument(name, type=Path, action=Configured, folder=folder, metavar=metavar, help=about)


def add_rig(parser: ArgumentParser, about: str, *, required: bool = True) -> None:
    """Add ``--rig``, a rig file or the name of one of the package."""
    parser.add_argument("--rig", type=Path, action=Configured, required=required, help=about)


def add_columns(parser: ArgumentParser) -> None:
    """Add ``--columns``, a map of the columns of foreign data."""
    parser.add_argument("--columns", type=Path, help="YAML map of the column names and units of the data")


def add_span(parser: ArgumentParser) -> None:
    """Add ``--from`` and ``--to``, the part of a recording to use."""
    about = "time to begin and to end, since the start of the recording [s] (default: all of it)"
    parser.add_argument("--from", dest="begin", type=float, metavar="S", default=0.0, help=about)
    parser.add_argument("--to", dest="end", type=float, metavar="S", default=float("inf"), help="likewise")


def add_results(parser: ArgumentParser, folder: str, document: str) -> None:
    """Add ``--out`` and ``--json``.

    Args:
        parser: of the verb.
        folder: default folder of the results.
        document: content of the line of JSON.
    """
    parser.add_argument("--out", type=Path, default=Path(folder), help="folder of the results (%(default)s)")
    add_json(parser, document)


def add_margins(parser: ArgumentParser, usual: Sequence[float]) -> None:
    """Add ``--margins``, those asked of a control law, with their default."""
    about = "gain margin [dB] and phase margin [degree] asked of the law (default: {:g} {:g})".format(*usual)
    parser.add_argument("--margins", type=float, nargs=2, metavar=("DB", "DEG"), default=list(usual), help=about)


def add_json(parser: ArgumentParser, document: str) -> None:
    """Add ``--json``, which ends the output with one line of JSON."""
    parser.add_argument("--json", action="store_true", help=f"end with one line of JSON: {document}")


def add_namespace(parser: ArgumentParser) -> None:
    """Add ``--namespace``, that of a rig's nodes."""
    parser.add_argument("--namespace", default="ehls", help="namespace of the rig (default: ehls)")


def add_plant(parser: argparse._ActionsContainer) -> None:
    """Add ``--plant`` and ``--bridge``, those of a graph to start; see :func:`check_plant`."""
    parser.add_argument(
        "--plant",
        choices=("sim", "bridge"),
        default="sim",
        help="sim: simulated rig; bridge: the rig behind --bridge, or UDP here",
    )
    parser.add_argument("--bridge", type=Path, help="bridge file: DAQ backend, channels, calibration (with --plant bridge)")


def check_plant(options: Namespace) -> None:
    """Check the options of :func:`add_plant`.

    Raises:
        BadInput: there is a bridge file, but no bridge.
    """
    if options.bridge is not None and options.plant == "sim":
        raise BadInput("--bridge was given", "command line", "--plant bridge with it")


def columns_of(options: Namespace) -> "ColumnMap | None":
    """Return the map given by ``--columns``."""
    from ehls_ros.recording.columns import read_columns  # half a second that not every verb needs

    return read_columns(options.columns) if options.columns else None


def check_range(options: Namespace, name: str, low: float, high: float | None = None, expected: str = "") -> None:
    """Check a number given by an option.

    Args:
        options: the options; one without a value is not checked.
        name: of the option, without dashes in front.
        low: smallest valid value.
        high: largest valid value, if any.
        expected: description of a valid value; by default of the range.

    Raises:
        BadInput: the value is outside.
    """
    value = getattr(options, name.replace("-", "_"))
    if value is not None and not low <= value <= (float("inf") if high is None else high):
        default = f"{low:g} or more" if high is None else f"{low:g} to {high:g}"
        raise BadInput(f"--{name} is {value}", "command line", expected or default)


def check_duration(options: Namespace) -> None:
    """Check the plant time given by ``--duration``, if any.

    Raises:
        BadInput: it is not a time in s.
    """
    if options.duration is not None and not 0.0 < options.duration < 1e6:
        raise BadInput(f"--duration is {options.duration:g}", "command line", "seconds above 0 and below 1e6")


@contextmanager
def needs_ros(otherwise: str = "") -> Iterator[None]:
    """Report a missing ROS in the imports within the context.

    Args:
        otherwise: alternative to ROS, for the error.

    Raises:
        BadInput: a module cannot be imported.
    """
    try:
        yield
    except ImportError as error:
        expected = f"ROS 2 Jazzy sourced, or `make setup`{otherwise}"
        raise BadInput(f"ROS 2 cannot be imported ({error})", "this Python", expected) from None
