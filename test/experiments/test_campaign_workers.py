"""Campaigns in separate processes: a killed Dask worker, a killed local one, Ctrl-C."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from campaign_cases import BASE, DRAWS, write
from patience import PATIENCE

from ehls_ros.experiments.campaign import backends
from ehls_ros.experiments.campaign.backends import dask, local
from ehls_ros.experiments.campaign.conduct import conduct
from ehls_ros.experiments.campaign.plan import load_plan
from ehls_ros.experiments.campaign.store import opened, read_results

pytest.importorskip("pyarrow", reason="pyarrow, of the extra campaign, is not installed")
psutil = pytest.importorskip("psutil", reason="psutil is not installed")
Client = pytest.importorskip("distributed", reason="distributed, of the extra campaign, is not installed").Client

COUNT = 60
CAMPAIGN = {"base": {**BASE, "duration": 10.0}, "runs": COUNT, "vary": DRAWS}


@pytest.fixture
def campaign(tmp_path):
    """A campaign of a few seconds of work."""
    return write(tmp_path, **CAMPAIGN)


@pytest.fixture
def processes():
    """Start programs; end those still running at the end."""
    with contextlib.ExitStack() as stack:

        def start(*arguments, **options):
            process = stack.enter_context(subprocess.Popen([sys.executable, "-m", *arguments], text=True, **options))
            stack.callback(process.wait, PATIENCE)
            stack.callback(process.terminate)
            return process

        yield start


@pytest.fixture
def cluster(processes, tmp_path, monkeypatch):
    """A scheduler on a free port of the loopback and two worker processes without nanny, by name."""
    monkeypatch.setattr(backends, "CONNECTING_S", PATIENCE)
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT", f"{PATIENCE}s")
    file = tmp_path / "scheduler.json"
    common = ["--scheduler-file", str(file), "--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
    log = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    processes("dask", "scheduler", "--port", "0", *common, **log)
    wait_until(file.exists)
    own = ["--nthreads", "1", "--no-nanny", "--local-directory", str(tmp_path)]
    workers = {name: processes("dask", "worker", "--name", name, *own, *common, **log) for name in ("one", "two")}
    with Client(json.loads(file.read_text())["address"], set_as_default=False, timeout=PATIENCE) as client:
        client.wait_for_workers(2, timeout=PATIENCE)
        yield client, workers


def wait_until(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


def runs(process):
    """Return whether a process exists and is not a zombie."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return process.status() != psutil.STATUS_ZOMBIE
    return False


def make(path, out, place, progress=None):
    plan = load_plan(path)
    with opened(out) as folder:
        return conduct(plan, folder, place, progress)


def kept(out):
    return [digest for part in (out / "parts").glob("*.parquet") for digest in read_results(part)["digest"]]


def numbers(out):
    """Return the table without its clock-dependent columns."""
    return {name: column for name, column in read_results(out / "results.parquet").items() if name != "wall_s"}


@pytest.fixture(scope="module")
def made_by_one(tmp_path_factory):
    """Results of the campaign in a single process."""
    folder = tmp_path_factory.mktemp("one")
    make(write(folder, **CAMPAIGN), folder / "out", local(1))
    return numbers(folder / "out")


@pytest.mark.long
def test_a_killed_dask_worker_loses_nothing(campaign, cluster, made_by_one, tmp_path):
    client, workers = cluster
    held = []

    def kill_one_at_work(done, total):
        if done == 0 or held:
            return
        # Stopped first, so that it does not run out of work meanwhile.
        os.kill(workers["two"].pid, signal.SIGSTOP)
        addresses = {worker["name"]: address for address, worker in client.scheduler_info(n_workers=-1)["workers"].items()}
        wait_until(lambda: client.processing()[addresses["two"]])
        held.extend(client.processing()[addresses["two"]])
        os.kill(workers["two"].pid, signal.SIGKILL)
        workers["two"].wait(PATIENCE)

    out = tmp_path / "dask"
    outcome = make(campaign, out, dask(client.scheduler.address), kill_one_at_work)
    assert held, "the worker had nothing to lose"
    assert list(client.nthreads().values()) == [1]
    assert outcome[:2] == (COUNT, COUNT)
    digests = kept(out)
    assert len(digests) == len(set(digests)) == COUNT
    assert numbers(out) == made_by_one


def start_command(processes, campaign, out, **options):
    """Start `ehls campaign` on two processes and wait until some of it is kept."""
    arguments = ["campaign", str(campaign), "--out", str(out), "--jobs", "2"]
    command = processes("ehls_ros.cli.main", *arguments, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, **options)
    wait_until(lambda: command.poll() is not None or list((out / "parts").glob("*.parquet")))
    assert command.poll() is None, command.stderr.read()
    return command


@pytest.fixture
def long_campaign(tmp_path):
    """A campaign that runs until it is stopped."""
    return write(tmp_path, **(CAMPAIGN | {"runs": 100_000}))


@pytest.mark.long
def test_ctrl_c_ends_all_processes_and_keeps_what_is_done(processes, long_campaign, tmp_path):
    out = tmp_path / "out"
    command = start_command(processes, long_campaign, out, start_new_session=True)
    children = psutil.Process(command.pid).children(recursive=True)
    os.killpg(command.pid, signal.SIGINT)  # as a terminal does
    _, said = command.communicate(timeout=PATIENCE)
    assert command.returncode == 130
    assert said.splitlines()[-2:] == [
        f"finished runs are kept in {out / 'parts'}; start again to continue",
        "ehls campaign: interrupted",
    ]
    assert "Traceback" not in said
    wait_until(lambda: not any(runs(child) for child in children))
    digests = kept(out)
    assert len(digests) == len(set(digests)) > 0
    assert not list(Path(out).rglob("*.writing"))


@pytest.mark.long
def test_a_killed_local_worker_ends_in_one_line_and_keeps_what_is_done(processes, long_campaign, tmp_path):
    out = tmp_path / "out"
    command = start_command(processes, long_campaign, out)
    workers = [child for child in psutil.Process(command.pid).children() if "LokyProcess" in " ".join(child.cmdline())]
    workers[0].kill()
    _, said = command.communicate(timeout=PATIENCE)
    assert command.returncode == 1
    assert "a worker process was killed" in said.splitlines()[-1]
    assert kept(out)


@pytest.mark.long
def test_two_processes_give_what_one_gives(processes, campaign, made_by_one, tmp_path):
    command = processes(
        "ehls_ros.cli.main", "campaign", str(campaign), "--out", str(tmp_path / "two"), "--jobs", "2", stdout=subprocess.DEVNULL
    )
    assert command.wait(PATIENCE) == 0
    assert numbers(tmp_path / "two") == made_by_one
