"""Files that Fast DDS keeps in shared memory; a process that is killed leaves its own behind."""

import fcntl
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - where Fast DDS puts them
NAMES = ("fastrtps_*", "sem.fastrtps_*", "fastdds_*", "sem.fastdds_*")


def used_by(process: int) -> set[Path]:
    """Return the files in shared memory that a process uses; none for one that is gone or another user's."""
    with suppress(OSError):
        # A file is opened first and mapped then: looked for the other way round, one on its way from here to there is missed.
        files = {descriptor.readlink() for descriptor in Path(f"/proc/{process}/fd").iterdir() if descriptor.is_symlink()}
        lines = Path(f"/proc/{process}/maps").read_text(encoding="utf-8").splitlines()
        files |= {Path(line.split(maxsplit=5)[-1]) for line in lines if str(SHARED_MEMORY) in line}
        return {file for file in files if file.parent == SHARED_MEMORY}
    return set()


def leftovers(of: Collection[Path] | None = None) -> list[Path]:
    """Return the middleware's files that no living process uses, as far as this user may see.

    Args:
        of: files of the segments and ports that are meant; None: all there are.
    """
    left: dict[str, set[Path]] = {}
    for file in (file for name in NAMES for file in SHARED_MEMORY.glob(name)):
        left.setdefault(_owner(file), set()).add(file)
    for process in Path("/proc").glob("[0-9]*") if left else ():
        for file in used_by(int(process.name)):
            left.pop(_owner(file), None)
    meant = left.keys() if of is None else left.keys() & {_owner(file) for file in of}
    return sorted(file for owner in meant if not _locked(owner) for file in left[owner])


def _owner(file: Path) -> str:
    """Return the segment or port a file belongs to: beside it lie its lock and its mutex, which nobody keeps open."""
    return file.name.removeprefix("sem.").removesuffix("_mutex").removesuffix("_el").removesuffix("_sl")


def _locked(owner: str) -> bool:
    """Tell whether the process that made a segment or port lives: it holds the lock even where it cannot be seen from here."""
    for lock in (SHARED_MEMORY / f"{owner}_el", SHARED_MEMORY / f"{owner}_sl"):
        try:
            with lock.open("rb") as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except FileNotFoundError:
            continue
        except OSError:
            return True
    return False
