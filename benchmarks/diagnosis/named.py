"""Terms found for effects on no list, written as effects: their contract test, and their naming in fresh cases.

    python -m benchmarks.diagnosis.named --seed 7 --cases 10

For each kind a recording of truth_generator is diagnosed; its term is written by `ehls effect new` into a package of a scratch
folder. The family's contract test is run on all of them. Then fresh recordings of the same kind, with other seeds, sizes and
motions, are diagnosed with the package installed. A case counts as named if the effect, or one declared equivalent to it, is
the first cause.
"""

import json
import os
import secrets
import subprocess
import sys
import tempfile
from argparse import Namespace
from concurrent.futures import ProcessPoolExecutor
from itertools import count, islice, repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import ROOT, parser_of
from benchmarks.diagnosis.cases import Case, recording_of, rig, rig_file, shown, trajectory_of
from ehls_ros.cli.main import main as ehls
from ehls_ros.diagnosis.diagnose import diagnose
from ehls_ros.experiments.json_document import json_document
from ehls_ros.physics.effects import EFFECTS
from truth_generator import draw_effect

KINDS = ("quadratic_drag", "ratchet_cogging", "stick_patch", "line_restriction", "mains_hum")
"""Effects outside the list: a power, a wave and a bump in the force balance, a power in the flow, a wave in the valve."""

FOUND, CLEAR, TRIES = 0.9, 5.0, 5
"""Part of the error that a term must close, and least visibility of the hidden effect, for an effect to be written from it;
most recordings in which it is sought."""

PACKAGE = "found_effects"
"""Name of the package."""

PREFIX = "found_"
"""Beginning of the effects' names."""


def drawn(name: str, seed: int, duration: float) -> Case:
    """Draw a visible case of an effect."""
    random = np.random.default_rng([seed, 3])
    return shown(random, seed, 0, "outside", duration, lambda: {name: draw_effect(name, random, rig_file())})


def written(name: str, seed: int, duration: float, folder: Path) -> str:
    """Find the term of an effect and write it into the package of a folder; return the formula, empty if none was found."""
    result = folder / f"{name}.json"
    if result.exists():
        return _formula(name, result, folder)
    clear = (case for k in count() if max((case := drawn(name, seed + k, duration)).visibility[name].values()) >= CLEAR)
    for case in islice(clear, TRIES):
        found = diagnose(trajectory_of(recording_of(case)), rig(), name, threads=1)
        if found.term is None or found.term.closed < FOUND:
            continue
        result.write_text(json.dumps(json_document({"verdict": found.verdict, "term": found.term})), encoding="utf-8")
        return _formula(name, result, folder)
    return ""


def _formula(name: str, result: Path, folder: Path) -> str:
    """Write an effect from the result of a diagnosis, and return its formula."""
    code = ehls(["effect", "new", PREFIX + name, "--from", str(result), "--package", str(folder), "--overwrite"])
    if code != 0:
        raise RuntimeError(f"ehls effect new ended with {code}")
    return next(line for line in _effect_file(folder, name).read_text(encoding="utf-8").splitlines() if "EQUATION" in line)


def _effect_file(folder: Path, name: str) -> Path:
    return folder / folder.name / f"{PREFIX}{name}.py"


def named(name: str, seed: int, duration: float) -> dict[str, Any]:
    """Diagnose a fresh case of an effect and return its row; the package is installed."""
    found = diagnose(trajectory_of(recording_of(drawn(name, seed, duration))), rig(), name, threads=1)
    wanted, causes = PREFIX + name, found.causes
    right = bool(causes) and wanted in (causes[0].name, *causes[0].equivalent_to)
    said = " + ".join(f"{cause.name} {cause.probability:.0%}" for cause in causes) or (found.unknown_stage or "")
    row = {"name": name, "right": right, "exact": right and len(causes) == 1, "verdict": found.verdict, "said": said}
    closed = 0.0 if found.gain is None else found.gain.closed_fraction
    return row | {"seed": seed, "closed": closed, "wall_s": found.wall_s}


def installed(folder: Path, names: list[str]) -> None:
    """Leave the metadata that pip would leave, so that the package on the path counts as installed."""
    info = folder / f"{folder.name}-1.0.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {folder.name}\nVersion: 1.0\n", encoding="utf-8")
    lines = [f"[{EFFECTS.group}]", *(f"{PREFIX}{name} = {folder.name}.{PREFIX}{name}" for name in names)]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    """Read the command line and run."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=None, help="seed of the cases; a fresh one by default")
    parser.add_argument("--cases", type=int, default=10, help="fresh cases of each effect (%(default)s)")
    parser.add_argument("--duration", type=float, default=30.0, help="of each recording, s (%(default)s)")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), help="effects outside the list (default: %(default)s)")
    parser.add_argument("--folder", type=Path, help="folder to keep the package in; terms found there are used again")
    parser.add_argument("--jobs", type=int, default=1, help="processes (%(default)s)")
    options = parser.parse_args()
    seed = secrets.randbits(24) if options.seed is None else options.seed
    print(f"seed {seed}, {options.cases} fresh cases of {options.duration:g} s each", flush=True)
    if options.folder is not None:
        run(options.folder.resolve() / PACKAGE, seed, options)
        return
    with tempfile.TemporaryDirectory(prefix="effects_") as scratch:
        run(Path(scratch) / PACKAGE, seed, options)


def run(folder: Path, seed: int, options: Namespace) -> None:
    """Write the effects into a package, test them, and print how often they are named."""
    folder.mkdir(parents=True, exist_ok=True)
    formulas = dict[str, str]()
    for k, name in enumerate(options.kinds):
        formulas[name] = written(name, seed + 100 * k, options.duration, folder)
        print(f"{name:20} {formulas[name] or 'no term found'}", flush=True)
    names = [name for name, formula in formulas.items() if formula]
    installed(folder, names)
    path = os.pathsep.join([str(folder), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": path}
    test = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "test/physics/test_effects.py", "-k", PREFIX]
    subprocess.run([sys.executable, *test], cwd=ROOT, env=environment, check=True)
    sys.path.insert(0, str(folder))  # which the processes take over
    fresh = [(n, seed + 10_000 + 100 * k + i) for i in range(options.cases) for k, n in enumerate(names)]
    rows = list[dict[str, Any]]()
    # Processes that start with the package installed.
    with ProcessPoolExecutor(options.jobs, get_context("spawn")) as workers:
        for row in workers.map(named, *zip(*fresh, strict=True), repeat(options.duration)):
            rows.append(row)
            gain = f"{row['closed']:6.1%} {row['wall_s']:5.1f} s"
            print(f"{row['name']:20} {row['verdict']:9} {row['right']!s:5} {gain}  {row['said']}", flush=True)
    for name in names:
        own = [row for row in rows if row["name"] == name]
        print(f"{name:20} named in {sum(r['right'] for r in own)} of {len(own)}, alone in {sum(r['exact'] for r in own)}")
    print(f"named in {sum(row['right'] for row in rows)} of {len(rows)}")


if __name__ == "__main__":
    main()
