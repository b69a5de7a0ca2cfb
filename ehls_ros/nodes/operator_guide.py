"""Guidance of a run's operator after an emergency stop or a trip: the commands that resume operation."""

import os
from collections.abc import Callable, Mapping

from ehls_ros.dashboard.status import explained, valve_text
from ehls_ros.hardware.safety_gate import DRIVING, LEFT, steps_to_drive
from ehls_ros.recording.topics import TRIPPED_BY


class OperatorGuide:
    """Guidance after an emergency stop or a trip, printed once for each.

    Attributes:
        tripped: whether the gate is tripped.
        has_tripped: whether it has been since the start.
    """

    def __init__(
        self, say: Callable[[str], None], *, end_on_trip: bool = False, attended: bool = True, has_programme: bool = False
    ) -> None:
        """Begin without a trip.

        Args:
            say: prints a line.
            end_on_trip: whether an emergency stop or a trip ends the run.
            attended: whether an operator may be present; otherwise a trip ends the run, but no emergency stop, which
                someone has given.
            has_programme: whether a programme has to be resumed.
        """
        self._say = say
        self._has_programme = has_programme
        self._end_on_trip, self._attended = end_on_trip, attended
        self._stop = ""
        self.tripped = self.has_tripped = False
        self._said: tuple[str, str] | None = None

    @property
    def ends_run(self) -> bool:
        """Whether the present stop or trip ends the run."""
        return self._end_on_trip or not (self._attended or self._stop)

    @staticmethod
    def prefix() -> str:
        """Return the assignment before a command that is typed in another terminal."""
        return f"ROS_DOMAIN_ID={os.environ.get('ROS_DOMAIN_ID', '0')} "

    def follow(self, figures: Mapping[str, str]) -> None:
        """Print the remedy when the gate trips, and what remains to be done when it is enabled again.

        Args:
            figures: diagnostics of the node with the gate.
        """
        state, stop, cause = (figures.get(key, "") for key in ("state", "stop", TRIPPED_BY))
        self._stop = stop
        # At the end of a run the plant closes the valve itself.
        self.tripped = bool(cause) and not cause.startswith(LEFT.replace("_", " "))
        self.has_tripped |= self.tripped
        steps = [f"rig {step}" for step in steps_to_drive(state, stop)]
        if self._has_programme and self.has_tripped:
            steps.append("programme resume")
        is_new = self._said is None or self._said[0] != cause or stop not in {"", self._said[1]}
        if self.tripped and is_new and not self.ends_run:
            self._said = cause, stop
            self._say(
                f"{explained(cause)} {valve_text(state)} The graph and the recording go on. To go on, in another terminal:"
            )
            for step in steps:
                self._say(f"  {self.prefix()}ehls {step}")
            self._say("Ctrl-C ends the run here.")
        elif self._said is not None and state in DRIVING:
            self._said = None
            further = f"; {self.prefix()}ehls programme resume continues the programme" if self._has_programme else ""
            self._say(f"The rig is enabled again{further}.")
