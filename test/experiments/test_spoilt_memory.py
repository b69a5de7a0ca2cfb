"""A sample of the spoilt files of ``benchmarks/spoilt_memory.py``: each way, for each kind of memory."""

import tempfile
from pathlib import Path

import pytest
from tiers import tiered

from benchmarks import spoilt_memory
from benchmarks.spoilt_memory import ASIDE, KINDS, REFUSED, TAKEN, WAYS, Case, left_alone, spoil_kind


@pytest.mark.parametrize("kind", tiered(KINDS, *KINDS[::4]), ids=lambda kind: kind.name)
def test_no_spoilt_file_crashes_hangs_or_costs_a_foreign_file(kind, monkeypatch):
    monkeypatch.setattr(spoilt_memory, "BOMB", 20_000_000)
    # Not below pytest's folder, which a user without rights may not enter.
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        cases = spoil_kind(kind, len(WAYS), 7, Path(folder))
    assert [case.failure for case in cases if case.failure] == []
    assert [case.changed for case in cases if case.changed] == []
    assert all(case.unwritten or case.outcome in {TAKEN, REFUSED, ASIDE} for case in cases)
    # Files that are healthy except for the disk are never lost silently.
    for (way, surroundings), case in zip(WAYS, cases, strict=True):
        if way is left_alone and (surroundings.full or surroundings.read_only) and kind.name != "accepted rig":
            assert case.unwritten or case.outcome == REFUSED


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_what_is_healthy_is_taken(kind, tmp_path):
    kind.make(tmp_path)
    assert kind.use(tmp_path) == TAKEN
    assert kind.name.startswith("flight") or kind.use(tmp_path) == TAKEN


def test_a_failure_would_be_seen(tmp_path):
    """The benchmark itself: a program that damages a foreign file and one that fails."""

    def breaks(folder):
        (folder / "notes.txt").unlink()
        raise ZeroDivisionError

    kind = KINDS[0]._replace(use=breaks)
    [case] = spoil_kind(kind, 1, 1, tmp_path)
    assert isinstance(case, Case)
    assert case.changed == ("notes.txt",)
    assert case.failure.startswith("ZeroDivisionError")
