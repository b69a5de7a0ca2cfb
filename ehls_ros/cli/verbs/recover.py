"""`ehls recover`: restore a damaged or unfinished bag."""

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path

from ehls_ros.cli.arguments import add_json
from ehls_ros.errors import WorkFailed, reason
from ehls_ros.progress import progress_bar
from ehls_ros.recording.ledger import Range
from ehls_ros.recording.recovery import Recovery, recover

HELP = "Restore a damaged bag, or one of a killed recorder: intact messages are kept, lost ones are listed."

LISTED = 5
"""Maximum number of ranges of lost messages listed per topic."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("bag", type=Path, help="folder of the bag, or its storage file under any name; it is not changed")
    parser.add_argument("--out", type=Path, help="folder of the new bag (default: <bag>_recovered)")
    add_json(parser, "recovered and lost messages")


def run(options: Namespace) -> int:
    """Recover the bag."""
    bag: Path = options.bag
    name = bag.stem if bag.is_file() else bag.resolve().name
    out: Path = options.out or bag.with_name(f"{name}_recovered")
    try:
        with progress_bar(f"recovering {bag}") as bar:
            recovery = recover(bag, out, bar)
    except OSError as error:
        raise WorkFailed(f"{out}: {reason(error)}") from None
    print("\n".join(listing(recovery, out)))
    if options.json:
        print(json.dumps({"bag": str(out), **recovery.as_json()}))
    return 0


def listing(recovery: Recovery, out: Path) -> list[str]:
    """List the recovered and the lost messages, one line each.

    Args:
        recovery: result of the recovery.
        out: folder of the new bag.
    """
    lines = [f"{recovery.recovered} messages in {out}, {recovery.lost or 'none'} known to be lost"]
    for path, topic in recovery.topics.items():
        if topic.lost:
            malformed = f", {topic.malformed} of them not of its type" if topic.malformed else ""
            lines.append(f"  {path}: {topic.lost} lost of {topic.recovered + topic.lost}{malformed}")
            lines += [f"    {_range(between)}" for between in topic.lost_between[:LISTED]]
            if len(topic.lost_between) > LISTED:
                lines.append(f"    and {len(topic.lost_between) - LISTED} more gaps")
        if topic.unverified:
            lines.append(f"  {path}: {topic.unverified} of {topic.recovered} are not verified, as no checksum covers them")
    return [*lines, *(f"  {remark}" for remark in recovery.remarks)]


def _range(between: Range) -> str:
    first, last = between.first_ns / 1e9, between.last_ns / 1e9
    when = f"at {first:.3f} s" if first == last else f"from {first:.3f} to {last:.3f} s"
    return f"{between.messages} sent {when}"
