"""The public exam: cases for any tool of diagnosis, and the score of its answers.

    python -m truth_generator.exam make FOLDER --seed 38001 --cases 40     # recordings and rig files
    python -m truth_generator.exam score FOLDER answers.json               # points by kind of case
    python -m truth_generator.exam schema > answers.schema.json            # form of the answers

Each case is a folder with `recording.csv`, in SI units, and `rig.yaml`, the numbers of the rig as its owner believes them. The
truth is not written: `score` draws it again from the version and the seed in `exam.json`.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from .cases import draw_case, kind_of
from .effects import EFFECTS, LISTED, STAGES
from .recording import appears_in, record
from .scoring import SCHEMA, checked, score

VERSION = 1
"""Version of the exam; it changes whenever a seed would give other cases."""

RIG = Path(__file__).parents[1] / "config" / "rig_paper_measured.yaml"
"""Rig file of all cases."""

DURATION = 30.0


def make(folder: Path, seed: int, cases: int, duration: float = DURATION, rig_path: Path = RIG) -> dict[str, Any]:
    """Write the cases of an exam, and return the content of `exam.json`.

    Args:
        folder: folder to write to; it must not hold an exam already.
        seed: seed of the cases.
        cases: their number.
        duration: duration of each recording [s].
        rig_path: rig file.

    Raises:
        FileExistsError: there is an exam already.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / "exam.json").exists():
        raise FileExistsError(f"{folder} holds an exam already")
    text = rig_path.read_text(encoding="utf-8")
    rig = yaml.safe_load(text)
    for number in range(cases):
        drawn = draw_case(rig, seed, number, duration)
        recording = record(rig, drawn.hidden, drawn.experiment, seed=drawn.record_seed, duration=duration)
        place = folder / case_name(number)
        place.mkdir(exist_ok=True)
        (place / "rig.yaml").write_text(text, encoding="utf-8")
        recording.write_csv(place / "recording.csv")
    about = {
        "exam": f"{VERSION}-{seed}",
        "version": VERSION,
        "seed": seed,
        "cases": cases,
        "duration": duration,
        "effects": {name: {"stage": effect.stage, "range": effect.range} for name, effect in sorted(LISTED.items())},
        "stages": list(STAGES),
    }
    (folder / "exam.json").write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    return about


def case_name(number: int) -> str:
    """Return the name of a case's folder."""
    return f"case_{number:04d}"


def truth_of(folder: Path, rig_path: Path = RIG) -> dict[str, dict[str, Any]]:
    """Return kind, hidden effects and stage of each case of an exam, drawn again from its seed.

    Raises:
        ValueError: the folder holds no exam of this version.
    """
    path = folder / "exam.json"
    about = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if about.get("version") != VERSION:
        raise ValueError(f"{path}: the exam has version {about.get('version')}: {VERSION} is expected")
    rig = yaml.safe_load(rig_path.read_text(encoding="utf-8"))
    out = {}
    for number in range(about["cases"]):
        drawn = draw_case(rig, about["seed"], number, about["duration"])
        stages = [appears_in(rig, name, sizes) for name, sizes in drawn.hidden.items()]
        near = sorted({near for name in drawn.hidden for near in EFFECTS[name].near})
        out[case_name(number)] = {
            "kind": kind_of(number),
            "hidden": drawn.hidden,
            "stage": stages[0] if stages else None,
            "near": near,
            "experiment": drawn.experiment,
        }
    return out


def main(words: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m truth_generator.exam", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    actions = parser.add_subparsers(dest="action", required=True)
    making = actions.add_parser("make", help="write the cases")
    making.add_argument("folder", type=Path)
    making.add_argument("--seed", type=int, required=True)
    making.add_argument("--cases", type=int, default=40)
    making.add_argument("--duration", type=float, default=DURATION, help="of each recording, s (%(default)s)")
    scoring = actions.add_parser("score", help="print the points of answers")
    scoring.add_argument("folder", type=Path)
    scoring.add_argument("answers", type=Path, nargs="+")
    scoring.add_argument("--json", action="store_true", help="print JSON")
    actions.add_parser("schema", help="print the JSON schema of the answers")
    options = parser.parse_args(words)
    if options.action == "schema":
        print(json.dumps(SCHEMA, indent=2))
        return 0
    try:
        if options.action == "make":
            about = make(options.folder, options.seed, options.cases, options.duration)
            print(f"exam {about['exam']}: {about['cases']} cases in {options.folder}")
        else:
            print_scores(options.folder, options.answers, as_json=options.json)
    except (OSError, ValueError) as error:
        print(f"exam: {error}", file=sys.stderr)
        return 2
    return 0


def print_scores(folder: Path, files: Sequence[Path], *, as_json: bool) -> None:
    """Print the score of each file of answers.

    Raises:
        ValueError: a file holds no valid answers to this exam.
    """
    truth = truth_of(folder)
    exam = json.loads((folder / "exam.json").read_text(encoding="utf-8"))["exam"]
    for path in files:
        try:
            answers = checked(json.loads(path.read_text(encoding="utf-8")))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        if answers["exam"] != exam:
            raise ValueError(f"{path}: answers to exam {answers['exam']}: {exam} is expected")
        if strange := set(answers["answers"]) - set(truth):
            raise ValueError(f"{path}: the exam has no {', '.join(sorted(strange))}")
        lines = score(answers["answers"], truth)
        if as_json:
            print(json.dumps({"entrant": answers["entrant"], "exam": exam, "score": [line._asdict() for line in lines]}))
            continue
        print(answers["entrant"])
        for line in lines:
            share = f"{line.right / line.cases:4.0%} ({line.low:.0%} to {line.high:.0%})" if line.cases else ""
            print(
                f"  {line.kind:8} {line.right:3d} of {line.cases:3d} right {share:22} confidently wrong {line.confident_wrong}"
            )


if __name__ == "__main__":
    sys.exit(main())
