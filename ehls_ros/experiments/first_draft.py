"""Wrong numbers of a rig file, and first drafts: those are fitted before the causes of the remaining error are sought."""

from collections.abc import Mapping

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.result import Fitted
from ehls_ros.identification.rig_coefficients import read
from ehls_ros.identification.rig_result import RigIdentification
from ehls_ros.physics.rig import Rig

OFF = 0.1
"""Relative error above which a wrong number of plant or friction is one of a first draft."""

CERTAIN = 5.0
"""Standard errors by which a wrong number differs from the identified one."""

OF_FILE = ("plant.", "friction.", "cylinder.", "valve.gain_")
"""Beginnings of the paths of coefficients that count; overlaps and roundings, like effects, may be anything."""

DRAFT = 4
"""Number of such ones from which a rig file counts as a first draft.

One or two wrong numbers are causes of an error: a diagnosis names them, with their rivals. Four at once are none: their shares
of the error cannot be separated one by one, and a fault that shifts four coefficients of the model is not on the list.
"""


def wrong_numbers(given: Rig, found: RigIdentification) -> dict[str, Fitted]:
    """Return the numbers of a rig file that recordings contradict, by dotted section and name, the least probable first.

    There are none if the residuals of the given rig are no larger by a relevant fraction of a balance.

    Args:
        given: the rig of the file.
        found: the rig identified from recordings.
    """
    gained = max((c.before**2 - c.after**2 for c in found.channels.values()), default=0.0)
    if gained < rules.RELEVANT**2:
        return {}
    sigmas = {path: abs(e.value - read(given, path)) / max(e.std, 1e-300) for path, e in found.estimates.items()}
    order = sorted((path for path in sigmas if sigmas[path] > CERTAIN), key=lambda path: -sigmas[path])
    return {path: Fitted(read(given, path), found.estimates[path], None) for path in order}


def is_first_draft(wrong: Mapping[str, Fitted]) -> bool:
    """Return whether a rig file has so many numbers that are far off that it has to be fitted first."""
    off = [path for path, w in wrong.items() if abs(w.fitted.value - w.given) > OFF * abs(w.fitted.value)]
    return sum(path.startswith(OF_FILE) for path in off) >= DRAFT
