"""The shared-memory files of Fast DDS, which a killed process leaves behind."""

import fcntl
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - where Fast DDS puts them
NAMES = ("fastrtps_*", "sem.fastrtps_*", "fastdds_*", "sem.fastdds_*")


def used_by(process: int) -> set[Path]:
    """Return the shared-memory files that a process uses; none if the process is gone or another user's."""
    with suppress(OSError):
        # Descriptors before mappings: a file is opened, then mapped, so the other order could miss it.
        files = {descriptor.readlink() for descriptor in Path(f"/proc/{process}/fd").iterdir() if descriptor.is_symlink()}
        lines = Path(f"/proc/{process}/maps").read_text(encoding="utf-8").splitlines()
        files |= {Path(line.split(maxsplit=5)[-1]) for line in lines if str(SHARED_MEMORY) in line}
        return {file for file in files if file.parent == SHARED_MEMORY}
    return set()


def leftovers(of: Collection[Path] | None = None) -> list[Path]:
    """Return the middleware's files that no living process uses, as far as this user can see.

    Args:
        of: files of the segments and ports to consider; None: all.
    """
    left: dict[str, set[Path]] = {}
    for file in (file for name in NAMES for file in SHARED_MEMORY.glob(name)):
        left.setdefault(_owner(file), set()).add(file)
    for process in Path("/proc").glob("[0-9]*") if left else ():
        for file in used_by(int(process.name)):
            left.pop(_owner(file), None)
    considered = left.keys() if of is None else left.keys() & {_owner(file) for file in of}
    return sorted(file for owner in considered if not _locked(owner) for file in left[owner])


def _owner(file: Path) -> str:
    """Return the segment or port a file belongs to, whose lock and mutex files no process keeps open."""
    return file.name.removeprefix("sem.").removesuffix("_mutex").removesuffix("_el").removesuffix("_sl")


def _locked(owner: str) -> bool:
    """Return whether the process that made a segment or port lives; it holds the lock even if it is not visible from here."""
    for lock in (SHARED_MEMORY / f"{owner}_el", SHARED_MEMORY / f"{owner}_sl"):
        try:
            with lock.open("rb") as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except FileNotFoundError:
            continue
        except OSError:
            return True
    return False
