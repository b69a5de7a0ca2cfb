"""Files with the learnt arrays of companions: read and checked for writing before a run, and replaced at its end."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ehls_ros.control.companion_chain import CompanionChain
from ehls_ros.control.companions.base import Companion, Kept
from ehls_ros.declared_arrays import Arrays
from ehls_ros.experiments.spec import Spec
from ehls_ros.experiments.state_files.access import NotWritten
from ehls_ros.experiments.state_files.kinds import LEARNT, LearntAbout
from ehls_ros.experiments.state_files.state_file import Origin, StateFile


def recall(company: CompanionChain, spec: Spec) -> None:
    """Restore companions from their files, and check that the files can be written.

    Args:
        company: the companions, before the first cycle.
        spec: their experiment.

    Raises:
        BadInput: a file cannot be written, is not a learnt file, or was learnt under other conditions.
    """
    for name, companion, file in _files(company, spec):
        file.check_writable()
        state = file.read()
        if state is None:
            continue
        about: LearntAbout = state.content
        expected = companion.kept().about
        if about.companion != name:
            raise file.refusal(f"the companion {about.companion} has learnt it, not {name}")
        for key, value in expected.items():
            if about.about.get(key) != value:
                raise file.refusal(f"it was learnt with {key} {about.about.get(key)}, not {value}")
        try:
            companion.recall(Kept(about.about, _parts(about.parts, state.arrays)))
        except ValueError as error:
            raise file.refusal(str(error)) from None


def keep(company: CompanionChain, spec: Spec) -> None:
    """Write the learnt arrays of companions to their files; without learnt arrays a file is left unchanged.

    Args:
        company: the companions, after the last cycle.
        spec: their experiment.

    Raises:
        NotWritten: files could not be written, with the reasons; raised after all files have been tried.
    """
    failures = []
    for name, companion, file in _files(company, spec):
        kept = companion.kept()
        if not kept.parts:
            continue
        arrays = {f"{part}.{key}": array for part, arrays in kept.parts.items() for key, array in arrays.items()}
        about = LearntAbout(name, dict(kept.about), tuple(sorted(kept.parts)))
        try:
            file.write(about._asdict(), arrays)
        except NotWritten as error:
            failures.append(str(error))
    if failures:
        raise NotWritten(f"learnt arrays are lost: {'; '.join(failures)}")


def _files(company: CompanionChain, spec: Spec) -> Iterator[tuple[str, Companion, StateFile]]:
    """Yield name and file of each companion that has one."""
    origin = Origin.of(spec.controller_rig, spec.settings.control_period)
    for use in spec.companions:
        if path := getattr(use.parameters, "file", ""):
            yield use.name, company.members[use.name], StateFile(Path(path), LEARNT, origin)


def _parts(numbers: tuple[int, ...], arrays: Arrays) -> dict[int, dict[str, NDArray[Any]]]:
    """Return arrays by part, from names such as ``3.period``.

    Raises:
        ValueError: an array belongs to no part.
    """
    parts: dict[int, dict[str, NDArray[Any]]] = {number: {} for number in numbers}
    for name, array in arrays.items():
        number, _, key = name.partition(".")
        if not number.isdecimal() or int(number) not in parts:
            raise ValueError(f"the array {name!r} is of no part")
        parts[int(number)][key] = array
    return parts
