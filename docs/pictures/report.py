"""Take report.png, the top of the report of the README's experiment, and keep the run's figures in report.json beside it."""

import contextlib
import hashlib
import json
import sys
import tempfile
from pathlib import Path

from ehls_ros.cli.main import main

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT / "test" / "dashboard"))
sys.path.insert(0, str(ROOT / "test"))

from headless_browser import browser  # noqa: E402 - found by the lines above

SPEC = ROOT / "config" / "experiments" / "sine_fd2.yaml"
KEPT = ("max_error_n", "rms_error_n", "convergence_s", "cycles")
WIDTH, HEIGHT = 1024, 1090


def take() -> None:
    """Run the experiment over DDS in lockstep, as `make demo` does, and take the picture."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, contextlib.chdir(folder):
        run = Path("runs", "demo")
        if main(["experiment", str(SPEC), "--out", str(run)]) != 0:
            sys.exit("the experiment failed")
        page = (run / "report.html").resolve().as_uri()
        with browser(Path(folder) / "profile") as chromium, chromium.tab(page) as tab:
            tab.resize(WIDTH, HEIGHT)
            tab.prefer("light")
            tab.command("Emulation.setScrollbarsHidden", hidden=True)
            tab.until("document.querySelectorAll('.js-plotly-plot .main-svg').length > 3")
            tab.evaluate("new Promise(done => setTimeout(done, 1000))")
            picture = tab.picture()
        metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    (HERE / "report.png").write_bytes(picture)
    figures = {name: metrics[name] for name in KEPT} | {"picture_sha256": hashlib.sha256(picture).hexdigest()}
    (HERE / "report.json").write_text(f"{json.dumps(figures, indent=2)}\n", encoding="utf-8")
    print(HERE / "report.png")


if __name__ == "__main__":
    take()
