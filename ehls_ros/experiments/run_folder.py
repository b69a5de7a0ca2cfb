"""Folder of a run: spec, bag, metrics, report."""

import errno
import json
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from ehls_ros.errors import BadInput, WorkFailed, reason
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.metrics import Metrics
from ehls_ros.experiments.spec import Spec, spec_to_mapping
from ehls_ros.experiments.yaml_files import spec_text

CONTENT = (
    "spec.yaml",
    "bag",
    "metrics.json",
    "report.html",
    "logs",
    "load_cycles.csv",
    "programme_state.json",
    "rig_adapted.yaml",
)
"""Files and folders of a run."""

SET_ASIDE = re.compile(r"(load_cycles\.[0-9]+\.csv|programme_state\.[0-9]+\.json|\.(load_cycles|programme_state)\..+\.part)")
"""Names of files put aside by a restarted programme, and of those left unfinished by a killed process."""

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a full disk, an exhausted quota and a file too large."""


class RunFolder(NamedTuple):
    """Folder with the files of one run."""

    path: Path

    @classmethod
    def create(cls, path: Path | None, name: str, *, overwrite: bool) -> "RunFolder":
        """Create the folder of a new run.

        Args:
            path: the folder; None makes a new one below ``runs/``.
            name: name of the run if ``path`` is None.
            overwrite: whether to replace a run in the folder. Only a run is ever replaced.

        Raises:
            BadInput: the folder cannot be written, or contains files that may not be replaced.
        """
        if path is None:
            path = Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
        try:
            path.mkdir(parents=True, exist_ok=True)
            present = sorted(entry.name for entry in path.iterdir())
            foreign = [entry for entry in present if entry not in CONTENT and not SET_ASIDE.fullmatch(entry)]
            if foreign:
                raise BadInput(f"the run folder holds '{foreign[0]}'", str(path), "a new or empty folder")
            if present and not overwrite:
                raise BadInput("the folder already holds a run", str(path), "a new folder, or --overwrite")
            for entry in present:
                inside = path / entry
                shutil.rmtree(inside) if inside.is_dir() and not inside.is_symlink() else inside.unlink()
            (path / "spec.yaml").touch()
        except OSError as error:
            raise BadInput(f"the run folder cannot be written ({error.strerror})", str(path), "a writable folder") from None
        return cls(path)

    @contextmanager
    def filling(self) -> Iterator[None]:
        """Convert write errors to a one-line message.

        Raises:
            WorkFailed: writing failed, for lack of space for example.
        """
        try:
            yield
        except OSError as error:
            advice = ": free some space, or choose another --out" if error.errno in FULL else ""
            raise WorkFailed(f"the run in {self.path} cannot go on ({reason(error)}){advice}") from None

    @property
    def bag(self) -> Path:
        """Folder of the bag."""
        return self.path / "bag"

    @property
    def report(self) -> Path:
        """Path of the report."""
        return self.path / "report.html"

    @property
    def spec(self) -> Path:
        """Path of the spec, with the content of all referenced files."""
        return self.path / "spec.yaml"

    @property
    def rig_adapted(self) -> Path:
        """Path of the rig file with the adapted values."""
        return self.path / "rig_adapted.yaml"

    @property
    def logs(self) -> Path:
        """Folder of the nodes' output, one file each."""
        return self.path / "logs"

    def write_spec(self, spec: Spec) -> None:
        """Write the spec."""
        self.spec.write_text(spec_text(spec_to_mapping(spec)), encoding="utf-8")

    def write_metrics(self, metrics: Metrics) -> None:
        """Write the metrics."""
        (self.path / "metrics.json").write_text(json.dumps(json_document(metrics), indent=2) + "\n", encoding="utf-8")


def recording_in(path: Path) -> Path:
    """Return the bag of a run's folder; any other path unchanged."""
    bag = path / "bag"
    return bag if bag.is_dir() else path
