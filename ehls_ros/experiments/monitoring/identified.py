"""The identified rig from which the monitor starts, and the numbers of the rig file that are wrong."""

from collections.abc import Mapping
from typing import NamedTuple

from ehls_ros.diagnosis.hypotheses import only_shifts
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, IdentifiedRig
from ehls_ros.diagnosis.result import Fitted
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.experiments.first_draft import wrong_numbers
from ehls_ros.identification.rig_coefficients import Sizes, coefficients
from ehls_ros.identification.rig_identifiability import ACCURACY
from ehls_ros.identification.rig_result import RigIdentification
from ehls_ros.identification.whole_rig import identify_rig
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory


class Identification(NamedTuple):
    """Identification of the rig from recordings.

    Attributes:
        rig: the identified rig.
        wrong: numbers of the given rig that the recordings contradict, by dotted section and name, the least probable first.
        estimates: identified coefficients, by dotted section and name in the rig file; also errors that are not significant.
        why_not: reasons for those not identifiable.
        whole: the identification itself; None of one that was saved.
    """

    rig: Rig
    wrong: Mapping[str, Fitted]
    estimates: Mapping[str, Estimate]
    why_not: Mapping[str, str]
    whole: RigIdentification | None = None

    def tracked(self, model: Rig) -> IdentifiedRig:
        """Return the identification as the tracked coefficients need it, for a model that starts from it.

        Args:
            model: the model; its values have the errors of the identification, or of the approximation if the rig file's
                values are kept.
        """
        paths = {name: coefficient.path for name, coefficient in COEFFICIENTS.items()}
        deviation = {
            name: abs(COEFFICIENTS[name].given(model)) * ACCURACY[path] for name, path in paths.items() if path in ACCURACY
        }
        if self.wrong:
            deviation |= {name: self.estimates[path].std for name, path in paths.items() if path in self.estimates}
        limits = model.limits
        sizes = Sizes(limits.spool, limits.force, limits.velocity)
        scales = {c.path: c.scale for c in coefficients(model, sizes) if c.path.startswith(("plant.", "friction."))}
        return IdentifiedRig(
            model,
            deviation,
            {name: scales[path] for name, path in paths.items() if scales.get(path)},
            {name: self.why_not[path] for name, path in paths.items() if path in self.why_not},
        )

    def errors(self) -> dict[str, float]:
        """Return the standard errors of the tracked coefficients of the model, by their names; a right rig file has none."""
        return {name: estimate.std for name, estimate in self.readings().items()} if self.wrong else {}

    def readings(self) -> dict[str, Estimate]:
        """Return the identified ones of the tracked coefficients, by their names."""
        return {name: self.estimates[c.path] for name, c in COEFFICIENTS.items() if c.path in self.estimates}


def identify(recordings: Mapping[str, Trajectory], rig: Rig) -> Identification | None:
    """Identify the rig from recordings; None if they allow none.

    Args:
        recordings: recordings of the rig, by name.
        rig: the rig as described in its file, the first guess.
    """
    rig = with_shifts_included(rig)
    try:
        found = identify_rig(recordings, rig)
    except BadInput:
        return None
    estimates = {**found.absent, **found.estimates}
    return Identification(found.rig, wrong_numbers(rig, found), estimates, found.not_identifiable, found)


def with_shifts_included(rig: Rig) -> Rig:
    """Return a rig whose coefficients include the shifts of its effects, which are left out."""
    shifts = tuple(use for use in rig.effects if only_shifts(use.name))
    whole = rig._replace(effects=shifts).effective()
    others = tuple(use for use in rig.effects if use not in shifts)
    return rig._replace(plant=whole.plant, friction=whole.friction, sensors=whole.sensors, effects=others)


def written(wrong: Mapping[str, Fitted]) -> str:
    """Describe wrong numbers of the rig file."""
    parts = (
        f"{path.partition('.')[2]} {w.given:.3g}, the recordings say {w.fitted.value:.4g} ± {1.96 * w.fitted.std:.2g}"
        f"{'' if w.fitted.unit == '1' else f' {w.fitted.unit}'}"
        for path, w in wrong.items()
    )
    return "; ".join(parts)
