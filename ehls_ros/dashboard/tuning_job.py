"""Tuning of a law beside a running graph: one separate process at a time, of low priority, that never outlives this one."""

import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from ehls_ros.dashboard.graph import TUNING_DOCUMENTS, Answer, Tuning, TuningResult, shortened
from ehls_ros.dashboard.tuning_process import Report, task_for
from ehls_ros.errors import BadInput
from ehls_ros.experiments.run_folder import RunFolder
from ehls_ros.experiments.spec import Spec
from ehls_ros.report.tuning import TuningFiles, tuning_files
from ehls_ros.schema import from_json

END_TIME = 5.0
"""Time that a process has to end after SIGTERM before it is killed [s]."""


class Applicable(NamedTuple):
    """Numbers that can be applied, and what they were found for.

    Attributes:
        law: the law.
        result: the result with the numbers.
        task: experiment and rig of the simulation.
    """

    law: str
    result: TuningResult
    task: Spec

    def is_for(self, spec: Spec, name: str) -> bool:
        """Return whether the numbers were found for an experiment and the rig that its controller knows."""
        return task_for(spec, self.law, name).spec == self.task


def process_command(folder: Path, law: str) -> list[str]:
    """Return the command that tunes a law for the experiment in a folder."""
    module = f"{__package__}.tuning_process"
    return ["nice", sys.executable, "-m", module, str(folder), law, str(os.getpid())]


class TuningJob:
    """The last tuning begun, with its process while it runs; thread-safe."""

    def __init__(self, command: Callable[[Path, str], Sequence[str]] = process_command) -> None:
        """Start without a tuning.

        Args:
            command: returns the command of a process that prints reports, from run folder and law.
        """
        self._command = command
        self._changing = threading.Lock()
        self._run: _Run | None = None
        self._closed = False

    def state(self) -> Tuning | None:
        """Return the last tuning; None before the first."""
        return None if self._run is None else self._run.state()

    def begin(self, spec: Spec, name: str, law: str) -> Answer:
        """Begin to tune a law, unless a tuning runs.

        Args:
            spec: the experiment.
            name: its name.
            law: the law.
        """
        with self._changing:
            if self._closed:
                return Answer(done=False, message="the dashboard is shutting down")
            if self._run is not None and self._run.state().running:
                return Answer(done=False, message="a tuning is running: wait for it or cancel it")
            try:
                task = task_for(spec, law, name).spec
                folder = RunFolder.create(None, f"{name}-tuning", overwrite=False)
                folder.write_spec(spec)
            except (BadInput, OSError) as error:
                return Answer(done=False, message=shortened(str(error)))
            before = self.state()
            applications = 0 if before is None else before.applications
            tuning = Tuning(law, name, folder=str(folder.path), applications=applications)
            self._run = _Run(self._command(folder.path, law), folder.path, tuning, task)
            return Answer(done=True, message=f"tuning {law} for {name}")

    def cancel(self) -> Answer:
        """End the process of the running tuning."""
        with self._changing:
            if self._run is None or not self._run.state().running:
                return Answer(done=False, message="no tuning is running")
            self._run.cancel()
            return Answer(done=True, message="the tuning was cancelled")

    def close(self) -> None:
        """End a running tuning and accept no other."""
        with self._changing:
            self._closed = True
            if self._run is not None:
                self._run.cancel()

    def applicable(self, folder: str) -> Applicable:
        """Return the numbers of the last tuning for application.

        Args:
            folder: folder of the tuning meant.

        Raises:
            BadInput: it is not the last one, has no result, or has found nothing that holds the force.
        """
        run = self._run
        tuning = None if run is None else run.state()
        if run is None or tuning is None or tuning.result is None or tuning.folder != folder:
            raise BadInput("the result is no longer that of the last tuning", "Apply", "the latest result")
        if tuning.result.lost:
            raise BadInput("the numbers found do not hold the force", "Apply", "numbers that hold it in simulation")
        return Applicable(tuning.law, tuning.result, run.task)

    def note_application(self, applied: Applicable, sentence: str) -> None:
        """Note that numbers were applied to a running controller.

        Args:
            applied: what was applied.
            sentence: about it.
        """
        if self._run is not None and self._run.task is applied.task:
            self._run.note_application(sentence)

    def document(self, name: str) -> Path | None:
        """Return a document of :data:`~ehls_ros.dashboard.graph.TUNING_DOCUMENTS`; None if there is none."""
        if name not in TUNING_DOCUMENTS or self._run is None or self._run.state().result is None:
            return None
        files = self._run.files
        return {"tuning-report": files.report, "tuning-experiment": files.spec, "tuning-numbers": files.numbers}[name]


class _Run:
    """One tuning: a process, and the thread that reads its reports.

    Attributes:
        task: experiment and rig of the simulation.
        files: files that the process writes.
    """

    def __init__(self, command: Sequence[str], folder: Path, tuning: Tuning, task: Spec) -> None:
        self.task = task
        self.files: TuningFiles = tuning_files(folder, tuning.law)
        self._command, self._folder = command, folder
        self._tuning = tuning
        self._began = time.monotonic()
        self._remark = ""
        self._result: TuningResult | None = None
        self._cancelled = threading.Event()
        self._process: subprocess.Popen[str] | None = None
        # Not a thread that serves requests: the kernel ends the process with the thread that has started it.
        self._thread = threading.Thread(target=self._follow, name="tuning")
        self._thread.start()

    def state(self) -> Tuning:
        tuning = self._tuning
        return tuning._replace(seconds=time.monotonic() - self._began) if tuning.running else tuning

    def cancel(self) -> None:
        """End the process, and wait for its end."""
        self._cancelled.set()
        self._signal(subprocess.Popen.terminate)
        self._thread.join(END_TIME)
        if self._thread.is_alive():
            self._signal(subprocess.Popen.kill)
            self._thread.join()

    def note_application(self, sentence: str) -> None:
        self._tuning = self._tuning._replace(applied=sentence, applications=self._tuning.applications + 1)

    def _signal(self, send: Callable[["subprocess.Popen[str]"], None]) -> None:
        if self._process is not None:
            send(self._process)

    def _follow(self) -> None:
        code = -1
        try:
            # In a separate session, so that Ctrl-C reaches only this process, which then ends the other.
            with subprocess.Popen(
                self._command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                encoding="utf-8",
                errors="replace",
                start_new_session=True,
            ) as process:
                self._process = process
                if self._cancelled.is_set():
                    process.terminate()
                for line in process.stdout or ():
                    self._read(line)
            code = process.returncode
        except OSError as error:
            self._remark = str(error)
        self._end(code)

    def _read(self, line: str) -> None:
        try:
            report: Report = from_json(Report, line)
        except ValueError:
            self._remark = line.strip() or self._remark
            return
        if report.result is None:
            self._tuning = self._tuning._replace(done=report.done, most=report.most)
        self._result = report.result

    def _end(self, code: int) -> None:
        failure = ""
        if self._cancelled.is_set():
            failure = "cancelled"
        elif code or self._result is None:
            failure = shortened(self._remark) or f"its process ended with code {code}"
        if failure:
            shutil.rmtree(self._folder, ignore_errors=True)
        result = None if failure else self._result
        self._tuning = self.state()._replace(running=False, failure=failure, result=result)
