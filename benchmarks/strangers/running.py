"""One stranger in all modes, along its engineer's path: data sheet, columns, identification, diagnosis, monitor.

The modes run in this process through the functions behind the verbs, with their default options.
"""

import contextlib
import io
import math
import tempfile
import time
import traceback
from argparse import Namespace
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from benchmarks.diagnosis.cases import sources
from benchmarks.diagnosis.running import told
from benchmarks.rows import Row
from benchmarks.strangers.generator import VALVE_DATA, Rig, Stranger, draw, simulate, table
from ehls_ros.cli.verbs import columns, new_rig
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.diagnosis.record import USED
from ehls_ros.experiments.baseline import diagnose_against
from ehls_ros.experiments.monitoring.monitor import Parameters
from ehls_ros.experiments.monitoring.replay import MonitoredRecording, MonitoringResult, replay
from ehls_ros.experiments.spec import load_rig
from ehls_ros.identification.rig_result import RigIdentification
from ehls_ros.identification.whole_rig import identify_rig
from ehls_ros.physics.rig import Rig as RigFile
from ehls_ros.recording.columns import read_columns
from ehls_ros.recording.load import load
from ehls_ros.report.monitor_findings import answer
from ehls_ros.trajectory import Trajectory

MODES = ("identify", "alone", "baseline", "monitor")
"""The modes: difference of two identifications; diagnosis with the rig as identified before; with two baselines; replay."""

READING_TIME = 10.0
"""Averaging time that the verb takes for a recording of half a minute [s]."""

RECORDINGS = ("before1", "before2", "after")


def prepared(stranger: Stranger, folder: Path) -> tuple[RigFile, dict[str, Trajectory]]:
    """Return the rig file by the data sheet and the loaded recordings of a stranger; the files are written to ``folder``."""
    for turn, name in enumerate(RECORDINGS):
        rig = stranger.changed if name == "after" else stranger.rig
        (folder / f"{name}.csv").write_text(table(stranger, simulate(stranger, rig, turn)), encoding="utf-8")
    (folder / "answers.yaml").write_text(yaml.safe_dump(dict(stranger.answers)), encoding="utf-8")
    out, chart = folder / "my_rig.yaml", folder / "columns.yaml"
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        given = {"answers": folder / "answers.yaml", "template": False, "overwrite": True, "json": False}
        new_rig.run(Namespace(out=out, **given))
        columns.run(Namespace(data=[folder / "before1.csv"], out=chart, valve=VALVE_DATA))
    known = read_columns(chart)
    return load_rig(out), {name: load(folder / f"{name}.csv", known, USED) for name in RECORDINGS}


def run(seed: int, number: int, modes: tuple[str, ...] = MODES, folder: Path | None = None) -> Row:
    """Draw a stranger and run the modes.

    Args:
        seed: seed of the strangers.
        number: number of the stranger.
        modes: the modes to run; `alone` needs `identify`.
        folder: folder that keeps the files of the stranger; by default a temporary one.

    Returns:
        The answers and the truth, JSON-compatible; an exception of a mode is its answer.
    """
    row: Row = {"seed": seed, "number": number, "sources": sources(), "wall_s": {}}
    try:
        stranger = draw(seed, number)
        row |= described(stranger)
        with tempfile.TemporaryDirectory() as scratch:
            rig, given = prepared(stranger, folder or Path(scratch))
    except Exception:  # noqa: BLE001
        # An exception in one case is a result, and must not end a long run.
        return row | {"error": traceback.format_exc(limit=-6)}
    row["signals"] = sorted(given["after"].signals)
    found: dict[str, Any] = {}

    def identified() -> dict[str, Any]:
        found["before"] = identify_rig({"before1": given["before1"]}, rig)
        return {
            "before": _identification(found["before"]),
            "after": _identification(identify_rig({"after": given["after"]}, rig)),
        }

    baselines = {name: given[name] for name in ("before1", "before2")}
    work: Mapping[str, Callable[[], dict[str, Any]]] = {
        "identify": identified,
        "alone": lambda: told_with_power(diagnose(given["after"], found["before"].rig, "after", threads=1)),
        "baseline": lambda: told_with_power(
            diagnose_against(given["after"], [*baselines.values()], rig, "after", threads=1, names=[*baselines])
        ),
        "monitor": lambda: _monitored(
            replay(
                [MonitoredRecording("after", given["after"])],
                rig,
                Parameters(reading_time=READING_TIME),
                baselines=baselines,
                limits={},
                progress=_quiet,
                on_event=lambda event: None,
            )
        ),
    }
    for mode in modes:
        began = time.perf_counter()
        try:
            row[mode] = work[mode]()
        except Exception:  # noqa: BLE001
            row[mode] = {"error": traceback.format_exc(limit=-6)}
        row["wall_s"][mode] = round(time.perf_counter() - began, 1)
    return row


def described(stranger: Stranger) -> dict[str, Any]:
    """Return the truth about a stranger in JSON-compatible form."""
    return {
        "kind": stranger.kind,
        "size": stranger.size,
        "answers": dict(stranger.answers),
        "true": {"before": _values(stranger.rig), "after": _values(stranger.changed)},
        "control": stranger.control._asdict(),
    }


def _values(rig: Rig) -> dict[str, float]:
    return dict(rig._asdict())


def told_with_power(found: Any) -> dict[str, Any]:
    """Return a diagnosis in JSON-compatible form, with the sizes that would have been seen and the fitted coefficients."""
    out = told(found)
    out["power"] = {s.name: [s.parameter, s.smallest] for s in found.sensitivities}
    out["remarks"] = list(found.remarks)
    if found.baseline is not None:
        out["coefficients"] = {
            name: [c.given, c.fitted.value, c.fitted.std, c.spread] for name, c in found.baseline.coefficients.items()
        }
    return out


def _identification(found: RigIdentification) -> dict[str, Any]:
    return {
        "estimates": {path: [e.value, e.std] for path, e in found.estimates.items()},
        "absent": {path: [e.value, e.std] for path, e in found.absent.items()},
        "not_identifiable": dict(found.not_identifiable),
        "channels": {name: list(fit) for name, fit in found.channels.items()},
        "remarks": list(found.remarks),
    }


def _quiet(done: int, total: int, doing: str = "") -> None:
    """Report no progress."""


def _monitored(found: MonitoringResult) -> dict[str, Any]:
    changes = [change for change in found.health.changes if change.active and not change.before]
    return {
        "headline": answer(found)[0],
        "changes": [
            {
                "stage": change.stage,
                "causes": [
                    {
                        "name": cause.name,
                        "probability": cause.probability,
                        "equivalent_to": list(cause.equivalent_to),
                        "parameters": {name: [e.value, e.std] for name, e in cause.parameters.items()},
                    }
                    for cause in change.causes
                ],
            }
            for change in changes
        ],
        "readings": {
            r.name: [r.value, r.deviation if math.isfinite(r.deviation) else None, r.why_not] for r in found.health.readings
        },
        "events": [[event.time, event.kind, event.text] for event in found.events],
        "watched": found.health.watched,
    }
