"""Take the pictures of the dashboard in a headless browser, while it starts a graph and then with it.

`.venv/bin/python docs/pictures/dashboard.py` writes dashboard_starting.png, dashboard.png, dashboard_dark.png and
dashboard_experiment.png here.
"""

import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT / "test"))

from headless_browser import Tab, browser  # noqa: E402 - found by the line above

SPEC = ROOT / "config" / "experiments" / "sine_fd2.yaml"

EHLS = (sys.executable, "-m", "ehls_ros.cli.main")


def main() -> None:
    """Take the pictures, then stop everything."""
    sys.path.insert(0, str(ROOT))
    from ehls_ros.nodes.graph import graph_environment  # noqa: PLC0415 - found by the line above

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # An empty cache: everything has to be compiled.
        environment = graph_environment() | {"EHLS_CACHE_DIR": str(folder / "kernels")}
        take(folder, environment)


def take(folder: Path, environment: Mapping[str, str]) -> None:
    """Take the pictures of a graph while it starts, and once ten seconds of data have arrived."""
    with shown(folder, environment, "--spec", str(SPEC)) as tab:
        tab.until("document.querySelector('[data-name=beginning]').innerText.includes('ready')", 180.0)
        save(tab, "dashboard_starting")
        take_running(tab)


@contextmanager
def shown(folder: Path, environment: Mapping[str, str], *arguments: str) -> Iterator[Tab]:
    """Run a dashboard and a browser with a laptop's screen size."""
    command = [*EHLS, "dashboard", "--port", "0", *arguments]
    server = subprocess.Popen(command, env=environment, cwd=folder, stdout=subprocess.PIPE, text=True)
    try:
        address = server.stdout.readline().strip() if server.stdout else ""
        with (
            tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
            browser(Path(profile)) as chromium,
            chromium.tab(address) as tab,
        ):
            tab.resize(1366, 768)
            tab.prefer("light")
            yield tab
    finally:
        server.send_signal(signal.SIGINT)
        server.wait(60.0)


def take_running(tab: Tab) -> None:
    """Take the pictures of a running graph."""
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
    tab.choose("[data-name=effect]", "dead zone")
    tab.click("[data-name='add effect']")
    tab.until("document.querySelector('.q-chip')?.innerText.includes('dead zone')")
    tab.choose("[data-name=effect]", "entrained")
    tab.until("!!document.querySelector('[data-name=effect-chambers]')")
    save(tab, "dashboard_experiment")


def save(tab: Tab, name: str) -> None:
    """Write a picture once the page has settled."""
    time.sleep(3.0)
    tab.until("!document.body.classList.contains('cut-off')")
    path = HERE / f"{name}.png"
    path.write_bytes(tab.picture())
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
