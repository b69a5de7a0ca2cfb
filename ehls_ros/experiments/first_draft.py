"""First drafts of rig files: their wrong numbers are corrected before the causes of the remaining error are sought."""

from collections.abc import Mapping

from ehls_ros.diagnosis.result import Fitted
from ehls_ros.identification.rig_coefficients import read
from ehls_ros.identification.rig_result import RigIdentification
from ehls_ros.physics.rig import Rig

OFF = 0.1
"""Relative error above which a number of a rig file counts as wrong."""

CERTAIN = 5.0
"""Standard errors by which it has to differ from the identified one."""

DRAFT = 4
"""Number of wrong ones from which a rig file counts as a first draft.

One or two wrong numbers are causes of an error: a diagnosis names them, with their rivals. Four at once are none: their shares
of the error cannot be separated one by one, and a fault that shifts four coefficients of the model is not on the list.
"""


def wrong_numbers(given: Rig, found: RigIdentification) -> dict[str, Fitted]:
    """Return the coefficients of plant and friction that contradict their values in the rig file, by their names there.

    Args:
        given: the rig of the file.
        found: the rig identified from recordings.
    """
    out = {}
    for path, estimate in found.estimates.items():
        section, _, name = path.partition(".")
        if section in ("plant", "friction"):
            off = abs(estimate.value - read(given, path))
            if off > OFF * abs(estimate.value) and off > CERTAIN * estimate.std:
                out[name] = Fitted(read(given, path), estimate, None)
    return out


def is_first_draft(wrong: Mapping[str, Fitted]) -> bool:
    """Return whether a rig file has so many wrong numbers that it has to be fitted first."""
    return len(wrong) >= DRAFT
