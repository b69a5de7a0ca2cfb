"""`ehls recover`: make a whole bag of one whose recorder died."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from ehls_ros.errors import WorkFailed
from ehls_ros.recording.reason import reason
from ehls_ros.recording.recovery import recover

HELP = "Make a whole bag of one whose recorder was killed: what was flushed, twice a second, is checked and kept."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("bag", type=Path, help="folder that the recorder left behind; it stays as it is")
    parser.add_argument("--out", type=Path, help="folder of the new bag (default: <bag>_recovered)")


def run(options: Namespace) -> int:
    """Recover it."""
    bag: Path = options.bag
    out: Path = options.out or bag.with_name(f"{bag.resolve().name}_recovered")
    try:
        messages = recover(bag, out)
    except OSError as error:
        raise WorkFailed(f"{out}: {reason(error)}") from None
    print(f"{messages} messages in {out}")
    return 0
