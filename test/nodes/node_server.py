"""Starts node processes as forks of one process with all imports done: a start takes a tenth of the time.

As a program, it reads a request per line, and answers with the number of each process it starts and the exit code of each
that ends. :class:`NodeServer` is its client.
"""

import contextlib
import errno
import faulthandler
import gc
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

NODES = "ehls_ros.nodes."
COMMAND = "ehls_ros.cli.main"
PARENT = "EHLS_PARENT"


class ServedProcess:
    """A process started by the server, with the part of the ``subprocess`` interface that the tests need."""

    stdin = None

    def __init__(self, server: "NodeServer", pid: int) -> None:
        self._server, self.pid = server, pid

    def poll(self) -> int | None:
        """Return the exit code; None while the process runs."""
        self._server.listen(0.0)
        return self._server.ended.get(self.pid)

    def wait(self, timeout: float = float("inf")) -> int:
        """Wait for the end, at most for a time [s], and return the exit code."""
        deadline = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if (left := deadline - time.monotonic()) <= 0.0:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            self._server.listen(min(left, 1.0))
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless the process has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        """Kill the process."""
        self.send_signal(signal.SIGKILL)


class NodeServer:
    """The client of a server.

    Attributes:
        ended: exit codes by process number; negative for a signal.
    """

    def __init__(self) -> None:
        self.ended: dict[int, int] = {}
        self._path = os.environ.get("PYTHONPATH", "")
        self._begun: list[int] = []
        self._rest = b""
        self._process = subprocess.Popen([sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._to, self._from = self._process.stdin, self._process.stdout

    def serves(self, arguments: Sequence[str], environment: Mapping[str, str]) -> bool:
        """Return whether the server can run a Python command line: it has the same packages, and its parent does not matter."""
        own_module = arguments[0] == "-m" and (arguments[1].startswith(NODES) or arguments[1] == COMMAND)
        return own_module and environment.get("PYTHONPATH", "") == self._path and PARENT not in environment

    def start(
        self, arguments: Sequence[str], log: Path, environment: Mapping[str, str], before: Mapping[str, Any] | None = None
    ) -> ServedProcess:
        """Start a process.

        Args:
            arguments: command line after the interpreter, for which :meth:`serves` holds.
            log: file to which its output is appended.
            environment: its environment.
            before: a function to call first: ``module``, ``function`` and ``arguments``.
        """
        request = {"arguments": list(arguments), "log": str(log), "environment": dict(environment), "before": before}
        self._to.write(f"{json.dumps(request)}\n".encode())
        self._to.flush()
        while not self._begun:
            self.listen(1.0)
        return ServedProcess(self, self._begun.pop())

    def listen(self, seconds: float) -> None:
        """Read the server's answers, waiting for one at most for a time [s]."""
        while select.select([self._from], [], [], seconds)[0]:
            read = os.read(self._from.fileno(), 65536)
            if not read:
                raise RuntimeError("the node server has ended")
            *lines, self._rest = (self._rest + read).split(b"\n")
            for line in lines:
                answer = json.loads(line)
                if "code" in answer:
                    self.ended[answer["pid"]] = answer["code"]
                else:
                    self._begun.append(answer["pid"])
            seconds = 0.0

    def close(self) -> None:
        """End the server."""
        self._to.close()
        self._process.wait()
        self._from.close()


def serve() -> None:
    """Fork a process for each line on standard input, until that is closed."""
    import ehls_ros.cli.verbs.run
    import ehls_ros.nodes.composed
    import ehls_ros.nodes.monitor_node
    import ehls_ros.nodes.programme_node
    import ehls_ros.nodes.recorder_node  # noqa: F401

    gc.collect()
    gc.freeze()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    woken, wake = os.pipe()
    for end in (woken, wake):
        os.set_blocking(end, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake)
    rest = b""
    while True:
        ready, _, _ = select.select([0, woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
            _report_ended()
        if 0 in ready:
            read = os.read(0, 65536)
            if not read:
                return
            *lines, rest = (rest + read).split(b"\n")
            for line in lines:
                # A process told to stop before it handles that would otherwise go on ignoring it.
                signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
                pid = os.fork()
                if pid == 0:
                    signal.set_wakeup_fd(-1)
                    for end in (woken, wake):
                        os.close(end)
                    _become(json.loads(line))
                signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
                _answer(pid=pid)


def _report_ended() -> None:
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except OSError as error:
            if error.errno == errno.ECHILD:
                return
            raise
        if pid == 0:
            return
        _answer(pid=pid, code=os.waitstatus_to_exitcode(status))


def _answer(**words: int) -> None:
    os.write(1, f"{json.dumps(words)}\n".encode())


def _become(request: Mapping[str, Any]) -> None:
    """Run the requested command line in this process, and exit."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    null, log = os.open(os.devnull, os.O_RDONLY), os.open(request["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for target, source in ((0, null), (1, log), (2, log)):
        os.dup2(source, target)
    faulthandler.enable()
    # Python 3.11 keeps the thread number of the parent.
    threading.main_thread()._set_native_id()  # type: ignore[attr-defined]
    os.environ.clear()
    os.environ.update(request["environment"])
    code: Any = 1
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        if (before := request["before"]) is not None:
            getattr(import_module(before["module"]), before["function"])(**before["arguments"])
        _, module, *arguments = request["arguments"]
        if module == COMMAND:
            from ehls_ros.cli.main import main

            code = main(arguments)
        else:
            sys.argv = [module, *arguments]
            code = import_module(module).main()
    except SystemExit as error:
        code = error.code
    except BaseException:  # noqa: BLE001
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(int(code or 0))


if __name__ == "__main__":
    serve()
