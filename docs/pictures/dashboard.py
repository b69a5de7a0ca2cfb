"""Take the pictures of the dashboard: a graph in lockstep, the dashboard that joins it, and a headless browser.

`.venv/bin/python docs/pictures/dashboard.py` writes dashboard.png, dashboard_dark.png and dashboard_experiment.png here.
"""

import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT / "test" / "dashboard"))

from headless_browser import Tab, browser  # noqa: E402 - found by the line above

SPEC = ROOT / "config" / "experiments" / "sine_fd2.yaml"
DURATION = 1000.0
"""Of the graph in plant time [s]; it is ended when the pictures are taken."""


def main() -> None:
    """Start both, take the pictures, end both."""
    sys.path.insert(0, str(ROOT))
    from ehls_ros.nodes.graph import graph_environment  # noqa: PLC0415 - found by the line above

    environment = graph_environment()
    ehls = [sys.executable, "-m", "ehls_ros.cli.main"]
    with tempfile.TemporaryDirectory() as folder:
        experiment = [*ehls, "experiment", str(SPEC), "--duration", str(DURATION), "--out", f"{folder}/run"]
        graph = subprocess.Popen(experiment, env=environment, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        server = subprocess.Popen(
            [*ehls, "dashboard", "--port", "0"], env=environment, cwd=folder, stdout=subprocess.PIPE, text=True
        )
        try:
            address = server.stdout.readline().strip() if server.stdout else ""
            with browser(Path(folder) / "chromium") as chromium, chromium.tab(address) as tab:
                take(tab)
        finally:
            for process in (server, graph):
                process.send_signal(signal.SIGINT)
            for process in (server, graph):
                process.wait(60.0)


def take(tab: Tab) -> None:
    """Take the pictures once ten seconds of the graph are there."""
    tab.resize(1366, 768)
    tab.prefer("light")
    tab.until(
        "typeof ehlsLive !== 'undefined' && ehlsLive.last() > 800 && !!document.querySelector('[data-name=value-k]')", 180.0
    )
    save(tab, "dashboard")
    tab.type_into("[data-name=value-k]", "1e9")
    tab.until("document.querySelector('[data-name=refused-k]').innerText.length > 0")
    tab.prefer("dark")
    save(tab, "dashboard_dark")
    tab.prefer("light")
    tab.click("[data-name=tab-experiment]")
    tab.type_into("[data-name=effect]", "dead zone", "ArrowDown", "Enter")
    tab.click("[data-name='add effect']")
    tab.type_into("[data-name=effect]", "entrained", "ArrowDown", "Enter")
    save(tab, "dashboard_experiment")


def save(tab: Tab, name: str) -> None:
    """Write a picture once the page has come to rest."""
    time.sleep(3.0)
    path = HERE / f"{name}.png"
    path.write_bytes(tab.picture())
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
