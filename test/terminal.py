"""A command on a terminal, answered as a user would."""

import codecs
import os
import pty
import select
from collections.abc import Sequence
from contextlib import suppress

INTERRUPT, END = "\x03", "\x04"
"""Ctrl-C and Ctrl-D."""

REPEATED_AFTER = 1.0
"""Time without an output after which an interrupt is sent again [s]."""


def dialogue(command: Sequence[str], answers: Sequence[str], prompt: str = "> ") -> tuple[int, str]:
    """Answer the questions of a command as they are asked; return its exit code and the terminal's content."""
    process, terminal = pty.fork()
    if process == 0:
        os.execv(command[0], command)
    shown, left, sent = "", list(answers), ""
    # A read may end within a character.
    decoder = codecs.getincrementaldecoder("utf-8")()
    with suppress(OSError):  # Linux: the terminal's last user is gone
        while True:
            if not select.select([terminal], [], [], REPEATED_AFTER)[0]:
                # Python loses an interrupt between its prompt and its wait for the answer; a user presses again.
                if sent == INTERRUPT and "interrupted" not in shown:
                    os.write(terminal, sent.encode())
                continue
            if not (more := os.read(terminal, 4096)):
                break
            shown += decoder.decode(more)
            if shown.endswith(prompt):
                # A question too many ends the input.
                sent = left.pop(0) if left else END
                os.write(terminal, sent.encode())
    os.close(terminal)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), shown
