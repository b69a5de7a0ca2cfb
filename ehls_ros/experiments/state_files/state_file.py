"""State file: envelope of kind, rig, control period and checksum around a document of a declared type.

A file is used only after a complete check, and only a file of the same kind is replaced.
"""

import json
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, BinaryIO, NamedTuple

from ehls_ros.declared_arrays import Arrays
from ehls_ros.errors import BadInput
from ehls_ros.experiments.state_files import access, archive
from ehls_ros.physics.rig import Rig, rig_to_mapping
from ehls_ros.recording.provenance import checksum_of
from ehls_ros.schema import Misfit, fitted, from_json, quantity

CHECKSUM = b', "checksum": "blake2b-'
"""Separator between the checked part of a document and its checksum."""

CHECKSUM_END = b'"}'

HEAD = 256
"""Number of first bytes of a file that contain its mark."""

SAME_PERIOD = 1e-9
"""Relative difference below which two control periods are equal."""

MAX_DIFFERENCES = 3
"""Maximum number of differences between two rigs named in an error."""


class Kind(NamedTuple):
    """A kind of state.

    Attributes:
        name: its name in the file and in errors, such as ``programme state``.
        version: version of its layout; others are not read.
        largest: maximum size of a file [B].
        content: type of its document, as for :func:`ehls_ros.schema.fitted`.
        expected: description of a valid file with the remedy, for errors.
        arrays: maximum number of arrays in a file; 0: the file is only the JSON document.
    """

    name: str
    version: int
    largest: int
    content: Any
    expected: str
    arrays: int = 0

    @property
    def mark(self) -> bytes:
        """The first bytes of its document."""
        return f'{{"format": "ehls_ros {self.name} {self.version}"'.encode()


class Origin(NamedTuple):
    """Rig and control period of a state.

    Attributes:
        rig: content of the rig's file.
        control_period: period of the control cycles [s].
    """

    rig: Mapping[str, Any]
    control_period: float

    @classmethod
    def of(cls, rig: Rig, control_period: float) -> "Origin":
        """Return the origin of a rig's state; ``control_period`` in s."""
        return cls(json.loads(json.dumps(rig_to_mapping(rig))), control_period)

    def difference(self, other: "Origin") -> str:
        """Describe the difference of another origin; empty if there is none."""
        if not math.isclose(self.control_period, other.control_period, rel_tol=SAME_PERIOD):
            return f"a control_period of {other.control_period:g} s, not {self.control_period:g} s"
        if self.rig == other.rig:
            return ""
        differing = [words for words in _differences("", other.rig, self.rig) if words]
        more = f" and {len(differing) - MAX_DIFFERENCES} more" if len(differing) > MAX_DIFFERENCES else ""
        return f"another rig: {', '.join(differing[:MAX_DIFFERENCES])}{more}"


class OfAnotherOrigin(BadInput):
    """A state file of another rig or control period."""


class State(NamedTuple):
    """The content of a state file.

    Attributes:
        content: the document, of the kind's type.
        arrays: arrays by name, not yet checked against a declaration.
        origin: rig and control period.
    """

    content: Any
    arrays: Arrays
    origin: Origin


class _Envelope(NamedTuple):
    format: str
    control_period: Annotated[float, quantity("s", "period of the control cycles", above=0.0, maximum=1e3)]
    rig: Mapping[str, Any]
    content: Any


class StateFile:
    """One state file.

    Attributes:
        path: the file.
        kind: its kind.
    """

    def __init__(self, path: Path, kind: Kind, origin: Origin | None) -> None:
        """Set path, kind and origin.

        Args:
            path: the file; it need not exist.
            kind: its kind.
            origin: rig and control period of its state; None: any, for a reader.
        """
        self.path = path
        self.kind = kind
        self._origin = origin
        self._what = f"the {kind.name}"

    def read(self) -> State | None:
        """Return the state; None if there is no file.

        Raises:
            OfAnotherOrigin: the file belongs to another rig or control period.
            BadInput: the file is of another kind or damaged, or its content is not as declared.
        """
        content = access.read(self.path, self.kind.largest, self.kind.expected, self._what)
        if content is None:
            return None
        if not content:
            raise self.refusal("it is empty")
        try:
            held = archive.read(content, self.kind.arrays) if self.kind.arrays else archive.Archive(content, {})
            return self._checked(held)
        except BadInput:
            raise
        except ValueError as error:
            raise self.refusal(str(error)) from None
        except RecursionError:
            raise self.refusal("it is nested too deeply") from None

    def refusal(self, what: str) -> BadInput:
        """Return the error for a file with unacceptable content."""
        return BadInput(f"{self._what} cannot be used ({what})", str(self.path), self.kind.expected)

    def write(self, content: Any, arrays: Arrays | None = None, *, durable: bool = True) -> None:
        """Replace the file atomically.

        Args:
            content: the document: mappings, lists, texts, booleans, finite numbers and None.
            arrays: arrays by name.
            durable: see :func:`ehls_ros.experiments.state_files.access.replace`.

        Raises:
            access.NotWritten: writing failed, with the path and the reason.
        """
        if self._origin is None:
            raise RuntimeError("a state belongs to a rig")
        if self._is_foreign():
            raise access.NotWritten(f"{self.path}: is not replaced (it is no {self.kind.name}); put it elsewhere")
        try:
            document = _document(self.kind, self._origin, content)
        except ValueError as error:
            raise access.NotWritten(f"{self.path}: cannot be written ({error})") from None

        def write(file: BinaryIO) -> None:
            if self.kind.arrays:
                archive.write(file, document, arrays or {})
            else:
                file.write(document)
            if file.tell() > self.kind.largest:
                raise ValueError(f"it has {file.tell()} bytes, more than {self.kind.largest}")

        access.replace(self.path, write, durable=durable)

    def check_writable(self) -> None:
        """Check before a run that the file can be written.

        Raises:
            BadInput: it cannot be written.
        """
        access.check_writable(self.path, "a place where it can be written", self._what)

    def is_own(self) -> bool:
        """Return whether the file is of this kind, by its mark; others are never replaced or removed."""
        head = access.first_bytes(self.path, HEAD)
        return (archive.beginning_of_document(head) if self.kind.arrays else head).startswith(self.kind.mark)

    def _is_foreign(self) -> bool:
        return os.path.exists(self.path) and not self.is_own()  # noqa: PTH110 - Path.exists raises where nobody may look

    def _checked(self, held: archive.Archive) -> State:
        document = held.document
        if not document.startswith(self.kind.mark):
            raise ValueError("it is something else, or of another version")
        body, mark, checksum = document.rpartition(CHECKSUM)
        if not mark or checksum != _checksum(body) + CHECKSUM_END:
            raise ValueError("it is damaged: its checksum is wrong")
        envelope: _Envelope = from_json(_Envelope, body + b"}")
        origin = Origin(envelope.rig, envelope.control_period)
        difference = self._origin.difference(origin) if self._origin is not None else ""
        if difference:
            raise OfAnotherOrigin(f"{self._what} is of {difference}", str(self.path), self.kind.expected)
        try:
            content = fitted(self.kind.content, envelope.content)
        except Misfit as misfit:
            raise ValueError(f"{misfit}") from None
        return State(content, held.arrays, origin)


def _document(kind: Kind, origin: Origin, content: Any) -> bytes:
    """Return a document with its checksum.

    Raises:
        ValueError: a number is not finite.
    """
    envelope = {
        "format": f"ehls_ros {kind.name} {kind.version}",
        "control_period": origin.control_period,
        "rig": origin.rig,
        "content": content,
    }
    body = json.dumps(envelope, allow_nan=False).encode()[:-1]
    return body + CHECKSUM + _checksum(body) + CHECKSUM_END


def _checksum(body: bytes) -> bytes:
    return f"{checksum_of(body):016x}".encode()


def _differences(place: str, there: Any, here: Any) -> Iterator[str]:
    """Yield the values in which two rigs differ, such as ``plant.piston_area is 0.0026, not 0.003``."""
    if isinstance(there, Mapping) and isinstance(here, Mapping):
        for key in [*here, *(key for key in there if key not in here)]:
            yield from _differences(f"{place}.{key}" if place else str(key), there.get(key), here.get(key))
    elif there is None or here is None:
        yield f"it has {'no' if there is None else 'a'} {place}" if there != here else ""
    elif there != here:
        yield f"{place} is {there!r}, not {here!r}"
