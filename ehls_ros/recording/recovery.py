"""Recovery of damaged or unclosed bags: sound messages go into a new bag, losses are reported.

A storage file contains checksums of its messages (:mod:`ehls_ros.recording.ledger`), so neither the names of folder and file
nor other files are needed. Messages that contradict a checksum are dropped. Messages without a checksum are kept if they are
plausible, and reported as unverified. The new bag is read back before it is accepted.
"""

import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import Reader

from ehls_ros.errors import BadInput, reason
from ehls_ros.recording.bag_reader import read_bag
from ehls_ros.recording.bag_writer import NEW_FOLDER, BagWriter
from ehls_ros.recording.cdr import CdrError, decode, flatten
from ehls_ros.recording.damaged_bag import RECOVERABLE, DamagedBag, damaged_bag, storage_file
from ehls_ros.recording.ledger import Ledger, Range, Tally
from ehls_ros.recording.provenance import checksum_sum, message_checksum
from ehls_ros.recording.salvage import Found, Loss
from ehls_ros.recording.topics import CYCLE_TOPICS, LOADER_STATE, Topic, known_topic
from ehls_ros.recording.typestore import typestore, typestore_of

BLOCK = 4096
"""Messages processed together."""

MAX_NS = (1 << 63) - 1
"""Latest time that a bag can represent [ns]."""


NEIGHBOURS = 17
"""Width of the median filter of the times of sending [messages]."""

MAX_TOPICS = 255
"""Maximum number of topics of the ledger."""

OUTLYING_NS = 10 * 10**9
"""Largest plausible deviation from the median [ns]."""


class TopicRecovery(NamedTuple):
    """Recovery of one topic.

    Attributes:
        recovered: messages in the new bag.
        unverified: recovered messages without a checksum.
        lost: messages that were written but are not in the new bag, as far as known.
        malformed: lost messages that were found but are not plausible messages of the topic.
        lost_between: ranges of the sending times of lost messages, as far as known.
    """

    recovered: int
    unverified: int
    lost: int
    malformed: int
    lost_between: Sequence[Range]


class Recovery(NamedTuple):
    """Recovery of a bag.

    Attributes:
        recovered: messages in the new bag.
        unverified: recovered messages without a checksum.
        lost: messages that were written but are not in the new bag, as far as known.
        topics: recovery of each topic, by full name.
        remarks: remarks on damage and omissions.
    """

    recovered: int
    unverified: int
    lost: int
    topics: Mapping[str, TopicRecovery]
    remarks: Sequence[str]

    def as_json(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        topics = {
            path: {**topic._asdict(), "lost_between": [between._asdict() for between in topic.lost_between]}
            for path, topic in self.topics.items()
        }
        return {**self._asdict(), "topics": topics}


class _UnreadableWithUnverified(Exception):
    """The new bag cannot be read and contains unverified messages."""


def recover(source: Path, out: Path, progress: Callable[[int, int], None] = lambda done, total: None) -> Recovery:
    """Write the sound messages of a damaged bag to a new one.

    Args:
        source: folder of a bag or its storage file, under any name; left unchanged.
        out: folder of the new bag, created only on success.
        progress: called with the number of messages done and the total.

    Returns:
        The recovered and the lost messages.

    Raises:
        BadInput: the remains do not suffice for a bag, or the new bag cannot be created.
        OSError: the disk is full or fails.
    """
    file = storage_file(source)
    if out.exists():
        raise BadInput("the output exists already", str(out), NEW_FOLDER)
    with _moved_on_success(out) as unfinished, damaged_bag(file, unfinished.parent) as (bag, ledger):
        try:
            return _recover(bag, ledger, unfinished, str(source), progress, verified_only=False)
        except _UnreadableWithUnverified as error:
            shutil.rmtree(unfinished)
            remark = f"unverified messages are left out, since the bag could not be read with them ({error})"
            remarked = bag._replace(remarks=[*bag.remarks, remark])
            return _recover(remarked, Ledger(bag.content), unfinished, str(source), progress, verified_only=True)


@contextmanager
def _moved_on_success(out: Path) -> Iterator[Path]:
    """Yield a temporary path that is renamed to ``out`` on success and removed on failure."""
    beside = next(parent for parent in out.parents if parent.exists())
    try:
        temporary = TemporaryDirectory(prefix=".recovering-", dir=beside)
    except OSError as error:
        raise BadInput(f"the output cannot be created ({reason(error)})", str(beside), NEW_FOLDER) from None
    with temporary as unfinished:
        try:
            yield Path(unfinished) / out.name
        except BadInput as error:
            # The temporary folder is of no use to the user.
            raise BadInput(error.what, error.where.replace(unfinished, str(out.parent)), error.expected) from None
        out.parent.mkdir(parents=True, exist_ok=True)
        (Path(unfinished) / out.name).rename(out)


def _recover(
    bag: DamagedBag, ledger: Ledger, out: Path, where: str, progress: Callable[[int, int], None], *, verified_only: bool
) -> Recovery:
    """Write the sound messages to a new bag, read it back and account for every message."""
    namespace, topics, definitions = _topics(bag, where)
    provenance = bag.provenance
    writer = BagWriter.create(
        out,
        bag.storage,
        provenance.configuration if provenance else {},
        namespace=namespace,
        topics=() if definitions else list(topics.values()),
        signals=provenance.signals if provenance else None,
    )
    loss, counts, done = Loss(), {path: _Counts() for path in topics}, 0
    try:
        for path, definition in definitions.items():
            writer.add_topic(topics[path], definition)
        messages = bag.messages(ledger, loss)
        while block := list(islice(messages, BLOCK)):
            for found in _plausible(block, topics, definitions, counts, loss, verified_only=verified_only):
                writer.write(topics[found.topic].name, found.stamp_ns, found.serialized)
                counts[found.topic].add(found)
            done += len(block)
            progress(done, max(done, sum(ledger.counts.values())))
        recovery = _account(bag, ledger, loss, counts)
        writer.set_recovery(recovery.as_json())
        writer.close()
    except BaseException:
        writer.abort()
        raise
    needed = list(topics) if definitions else [LOADER_STATE.resolve(namespace)]
    if not any(counts[path].tally.messages for path in needed):
        what = "no sound message" if definitions else f"no sound message of {LOADER_STATE.name}"
        raise BadInput(f"{what} is left in it", where, RECOVERABLE)
    try:
        if not definitions:
            read_bag(out)
        _check_written(out, {path: count.tally for path, count in counts.items()})
    except BadInput as error:
        if recovery.unverified:
            raise _UnreadableWithUnverified(error.what) from None
        raise BadInput(f"its sound messages do not make a readable bag ({error.what})", where, RECOVERABLE) from None
    return recovery


def _topics(bag: DamagedBag, where: str) -> tuple[str, dict[str, Topic], dict[str, MessageDefinition | None]]:
    """Return the namespace, the topics by full name, and in a bag of another recorder the definitions of their types."""
    paths = set(bag.names.values()) or set(bag.expected)
    ending = f"/{LOADER_STATE.name}"
    namespaces = sorted(path.removesuffix(ending) for path in paths if path.endswith(ending))
    if not namespaces and (definitions := _definitions(bag)):
        return "", {path: Topic(path, bag.kinds[path].type) for path in definitions}, definitions
    if len(namespaces) != 1:
        several = f"it contains several rigs: {', '.join(namespaces)}"
        raise BadInput(several if namespaces else f"no topic {LOADER_STATE.name} is left in it", where, RECOVERABLE)
    known = {path: known_topic(path, namespaces[0]) for path in sorted(paths)}
    return namespaces[0], {path: topic for path, topic in known.items() if topic is not None}, {}


def _definitions(bag: DamagedBag) -> dict[str, MessageDefinition | None]:
    """Return the definitions of the topics that can be written, by full name; None for a known type."""
    found: dict[str, MessageDefinition | None] = {}
    for path, kind in sorted(bag.kinds.items())[:MAX_TOPICS]:
        known = kind.definition.format is MessageDefinitionFormat.NONE
        # A damaged definition is invalid in any way.
        with suppress(Exception):
            typestore_of(kind.definition, kind.type).hash_rihs01(kind.type)
            found[path] = None if known else kind.definition
    return found


class _Counts:
    """Running counts of one topic."""

    def __init__(self) -> None:
        self.tally = Tally(0, 0, 0)
        self.unverified = 0
        self.malformed = 0

    def add(self, found: Found) -> None:
        messages, checksum, newest_ns = self.tally
        added = message_checksum(found.topic, found.stamp_ns, found.serialized)
        self.tally = Tally(messages + 1, checksum_sum([checksum, added]), max(newest_ns, found.stamp_ns))
        self.unverified += not found.verified


def _plausible(
    block: Sequence[Found],
    topics: Mapping[str, Topic],
    definitions: Mapping[str, MessageDefinition | None],
    counts: Mapping[str, _Counts],
    loss: Loss,
    *,
    verified_only: bool,
) -> list[Found]:
    """Return the verified and the plausible messages, in the same order, and count the rest."""
    # A message without a checksum must be sent at about the time of its neighbours; a lasting step of the clock is plausible.
    stamps = np.array([found.stamp_ns for found in block], np.float64)
    usual: NDArray[np.float64] = scipy.ndimage.median_filter(stamps, NEIGHBOURS, mode="nearest")
    in_time = np.abs(stamps - usual) <= OUTLYING_NS
    by_topic: dict[str, list[int]] = defaultdict(list)
    for index, found in enumerate(block):
        if found.topic not in topics:
            loss.foreign.add(found.topic)
        elif found.verified or not verified_only:
            by_topic[found.topic].append(index)
        else:
            loss.count(found.topic)
    kept: list[int] = []
    for path, indices in by_topic.items():
        formed = _well_formed(topics[path], definitions.get(path), [block[index].serialized for index in indices])
        good = [
            index
            for index, decodes in zip(indices, formed, strict=True)
            if decodes and block[index].stamp_ns <= MAX_NS and (block[index].verified or in_time[index])
        ]
        counts[path].malformed += len(indices) - len(good)
        kept += good
    return [block[index] for index in sorted(kept)]


def _account(bag: DamagedBag, ledger: Ledger, loss: Loss, counts: Mapping[str, _Counts]) -> Recovery:
    """Account for every message."""
    known_lost = ledger.lost()
    why = (
        "is not a topic of ehls_ros"
        if any(topic.endswith(f"/{LOADER_STATE.name}") for topic in counts)
        else "is of an unknown type"
    )
    topics: dict[str, TopicRecovery] = {}
    for path, count in counts.items():
        expected = bag.expected.get(path)
        written = max(ledger.counts.get(path, 0), expected.messages if expected else 0)
        dropped = loss.damaged.get(path, 0) + count.malformed
        missing = max(0, written - count.tally.messages)
        # Damage may have assigned a dropped message to this topic, so a known number of messages takes precedence.
        lost = missing if expected or ledger.complete else max(missing, dropped)
        between = known_lost.get(path, [])
        rest = lost - count.malformed - sum(part.messages for part in between)
        if expected and rest > 0 and expected.newest_ns > count.tally.newest_ns:
            between = [*between, Range(rest, count.tally.newest_ns, expected.newest_ns)]
        topics[path] = TopicRecovery(count.tally.messages, count.unverified, lost, count.malformed, between)
    return Recovery(
        sum(topic.recovered for topic in topics.values()),
        sum(topic.unverified for topic in topics.values()),
        sum(topic.lost for topic in topics.values()),
        topics,
        [*bag.remarks, *loss.places, *(f"{path} {why} and is left out" for path in sorted(loss.foreign))],
    )


def _check_written(bag: Path, written: Mapping[str, Tally]) -> None:
    """Compare the messages of a bag with those written.

    Raises:
        BadInput: the messages differ.
    """
    counts: dict[str, int] = dict.fromkeys(written, 0)
    checksums: dict[str, int] = dict.fromkeys(written, 0)
    with Reader(bag) as reader:
        for connection, stamp_ns, message in reader.messages():
            counts[connection.topic] += 1
            checksums[connection.topic] += message_checksum(connection.topic, stamp_ns, message)
    for path, tally in written.items():
        if (counts[path], checksum_sum([checksums[path]])) != (tally.messages, tally.checksum):
            what = f"messages on {path} differ from what was written"
            raise BadInput(what, str(bag), "a disk without faults")


def _well_formed(topic: Topic, definition: MessageDefinition | None, messages: Sequence[bytes]) -> list[bool]:
    """Return for each message whether it decodes as the topic's type; all do if the type has fields that are not read."""
    fields = flatten(typestore().fielddefs, topic.type) if topic in CYCLE_TOPICS else None
    if definition is not None:
        try:
            fields = flatten(typestore_of(definition, topic.type).fielddefs, topic.type)
        except CdrError:
            return [True] * len(messages)

    def decodes(some: Sequence[bytes]) -> bool:
        try:
            if fields is not None:
                decode(some, fields, ())
            else:
                for message in some:
                    typestore().deserialize_cdr(message, topic.type)
        except Exception:  # noqa: BLE001 - rosbags raises any exception on invalid bytes
            return False
        return True

    return [True] * len(messages) if decodes(messages) else [decodes([message]) for message in messages]
