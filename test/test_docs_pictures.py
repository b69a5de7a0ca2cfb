"""The pictures of README.md and docs/, made by docs/make_pictures.py, match the text and a present run."""

import hashlib
import json
import re
import runpy
from pathlib import Path

import pytest
from docs_snippets import ROOT, pages

from ehls_ros.experiments.loop import run_in_process
from ehls_ros.experiments.metrics import evaluate
from ehls_ros.experiments.spec import load_spec
from ehls_ros.trajectory import SIGNALS

PICTURES = ROOT / "docs" / "pictures"
FIGURES = json.loads((PICTURES / "report.json").read_text(encoding="utf-8"))
"""Figures of the run in report.png, and the picture's digest."""


def test_the_sketch_is_what_its_script_draws_and_names_signals_that_there_are() -> None:
    drawn = runpy.run_path(str(PICTURES / "rig.py"))["sketch"]()
    assert (PICTURES / "rig.svg").read_text(encoding="utf-8") == drawn
    named = re.findall(r'class="signal"[^>]*>(\w+)<', drawn)
    assert len(named) == len(set(named)) > 0
    assert set(named) <= set(SIGNALS)
    concepts = (ROOT / "docs" / "concepts.md").read_text(encoding="utf-8")
    assert [name for name in named if f"| `{name}` " not in concepts] == []


def test_the_figures_belong_to_the_picture_and_are_those_of_a_run() -> None:
    assert hashlib.sha256((PICTURES / "report.png").read_bytes()).hexdigest() == FIGURES["picture_sha256"]
    metrics = evaluate(run_in_process(load_spec(ROOT / "config" / "experiments" / "sine_fd2.yaml")))._asdict()
    shown = {name: value for name, value in FIGURES.items() if name in metrics}
    assert {name: metrics[name] for name in shown} == pytest.approx(shown, rel=1e-6)


@pytest.mark.parametrize("page", ["README.md", "docs/tour.md", "docs/measured.md"])
def test_the_text_has_the_pictures_error(page: str) -> None:
    assert f"{FIGURES['max_error_n']:.1f}" in (ROOT / page).read_text(encoding="utf-8")


def test_every_picture_is_shown_and_made_by_a_script() -> None:
    shown: set[str] = set()
    for page in pages():
        text = (ROOT / page).read_text(encoding="utf-8")
        shown |= {Path(target).name for target in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)}
    stored = {path.name for path in PICTURES.iterdir() if path.suffix in {".png", ".svg"}}
    assert shown == stored
    scripts = {path.stem for path in PICTURES.glob("*.py")}
    assert {path.partition(".")[0].partition("_")[0] for path in stored} <= scripts
