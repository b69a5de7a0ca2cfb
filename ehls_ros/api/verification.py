"""Dynamic force verification of a recording as an object, as done by `ehls verify`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ehls_ros.api.recordings import Columns, Data, as_recording
from ehls_ros.api.results import fields_of, figure, html, written
from ehls_ros.api.simulation import RigSource
from ehls_ros.api.simulation import rig as rig_of
from ehls_ros.errors import BadInput, one_of
from ehls_ros.experiments.verification.results import CERTIFIES_NOTHING, Cyclic, Verification
from ehls_ros.experiments.verification.verify import Given, verify_recording
from ehls_ros.report.verification import answer, write_verification_report
from ehls_ros.report.verification_figures import trend

if TYPE_CHECKING:
    from pandas import DataFrame
    from plotly.graph_objects import Figure


@dataclass(frozen=True, kw_only=True, repr=False)
class VerificationResult(Verification):
    """Accuracy of a recording's force with respect to its reference, block by block. It certifies nothing.

    Attributes:
        name: name of the verified recording.
    """

    name: str

    @property
    def sentence(self) -> str:
        """The result in a sentence."""
        return answer(self)[0]

    def to_pandas(self) -> "DataFrame":
        """Return a table with one row per quantity of each cyclic block.

        Values are means over the cycles of a block; uncertainties are expanded, k = 2.
        """
        from pandas import DataFrame  # noqa: PLC0415 - half a second that only tables cost

        columns = ["block", "quantity", "unit", "reference", "measured", "error", "uncertainty", "error_percent"]
        rows = [
            (block.name, q.name, q.unit, q.reference, q.measured, q.error, q.uncertainty.expanded, q.percent)
            for block in self.blocks
            if isinstance(block.found, Cyclic)
            for q in block.found.quantities
        ]
        return DataFrame(rows, columns=columns)

    def plot(self, block: str | None = None) -> "Figure":
        """Draw the peaks and valleys of every cycle of a block.

        Args:
            block: its name; None: the first cyclic one.

        Raises:
            BadInput: there is no cyclic block of that name.
        """
        cyclic = {one.name: one.found for one in self.blocks if isinstance(one.found, Cyclic)}
        chosen = block or next(iter(cyclic), "")
        if chosen not in cyclic:
            raise BadInput(f"there is no cyclic block {chosen!r}", self.name, one_of(chosen, cyclic))
        return figure(trend(cyclic[chosen]))

    def report(self, path: str | Path) -> Path:
        """Write the HTML report of `ehls verify` and return its path.

        Raises:
            BadInput: the file cannot be written.
        """
        return written(path, lambda file: write_verification_report(self, file, self.name))

    def __repr__(self) -> str:
        """Return a one-line summary."""
        return f"<{type(self).__name__} {self.name}: {len(self.blocks)} blocks>"

    def _repr_html_(self) -> str:
        table = self.to_pandas().to_html(index=False, float_format="{:.4g}".format)
        return html(self.sentence, table, (CERTIFIES_NOTHING, *self.remarks))


def verify(
    data: Data,
    rig: RigSource | None = None,
    *,
    columns: Columns | None = None,
    inertia_mass: float | None = None,
    cell_uncertainty: float | None = None,
    settling: int | None = None,
    begin: float | None = None,
    end: float | None = None,
) -> VerificationResult:
    """Verify the force of a cyclic test, block by block.

    Args:
        data: the recording, or its path; with ``force_n`` and ``force_reference_n``.
        rig: the rig or its file, for resolution, noise and lag of its sensors. None: the one in the recording, if any.
        columns: names and units used in the data, for paths.
        inertia_mass: mass between load cell and specimen [kg]; None: its inertia is not corrected.
        cell_uncertainty: expanded uncertainty (k = 2) of the load cell's calibration [% of reading]; None counts as zero.
        settling: cycles left out at the start of each stretch of a block. None: until the error equals that of the later half.
        begin: start of the time to verify, since the start of the recording [s]; None: the start.
        end: end of that time; None: the end.

    Returns:
        The verification: ``blocks`` with peak, valley, mean, range, amplitude and phase, their errors and uncertainties,
        harmonic distortion and repeatability. A block that does not repeat has its error over time, the reason, and gain, lag
        and coherence in bands of frequency.

    Raises:
        BadInput: data or rig cannot be read; force or reference is missing, or the position for the inertia correction.
    """
    recording = as_recording(data, columns)
    given = Given(None if rig is None else rig_of(rig), inertia_mass, cell_uncertainty, settling, begin, end)
    found = verify_recording(recording, given, recording.name)
    return VerificationResult(**fields_of(Verification, found), name=recording.name)
