"""Files that Fast DDS keeps in shared memory; a process that is killed leaves its own behind."""

from contextlib import suppress
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - where Fast DDS puts them
NAMES = ("fastrtps_*", "sem.fastrtps_*", "fastdds_*", "sem.fastdds_*")


def used_by(process: int) -> set[Path]:
    """Return the files in shared memory that a process uses; none for one that is gone or another user's."""
    with suppress(OSError):
        lines = Path(f"/proc/{process}/maps").read_text(encoding="utf-8").splitlines()
        files = {Path(line.split(maxsplit=5)[-1]) for line in lines if str(SHARED_MEMORY) in line}
        files |= {descriptor.readlink() for descriptor in Path(f"/proc/{process}/fd").iterdir() if descriptor.is_symlink()}
        return {file for file in files if file.parent == SHARED_MEMORY}
    return set()


def leftovers() -> list[Path]:
    """Return the middleware's files that no living process uses, as far as this user may see."""
    left = {file for name in NAMES for file in SHARED_MEMORY.glob(name)}
    for process in Path("/proc").glob("[0-9]*") if left else ():
        left -= used_by(int(process.name))
    # A reader that is under way locks beside the segment; the one goes with the other.
    return sorted(left)
