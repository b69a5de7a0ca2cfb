"""The identified rig from which the monitor starts, and the numbers of the rig file that are wrong."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.hypotheses import only_shifts
from ehls_ros.diagnosis.monitoring.tracking import COEFFICIENTS, IdentifiedRig
from ehls_ros.errors import BadInput
from ehls_ros.estimate import Estimate
from ehls_ros.identification.rig_coefficients import Sizes, coefficients, read
from ehls_ros.identification.rig_identifiability import ACCURACY
from ehls_ros.identification.rig_result import RigIdentification
from ehls_ros.identification.rig_stages import MIN_SIGMAS
from ehls_ros.identification.whole_rig import identify_rig
from ehls_ros.physics.rig import Rig
from ehls_ros.trajectory import Trajectory


class WrongValue(NamedTuple):
    """A number of the rig file that the recordings contradict.

    Attributes:
        name: dotted section and name in the rig file.
        given: value in the file.
        fitted: identified value.
        std: its standard error.
        unit: unit of all.
    """

    name: str
    given: float
    fitted: float
    std: float
    unit: str


class Identification(NamedTuple):
    """Identification of the rig from recordings.

    Attributes:
        rig: the identified rig.
        wrong: numbers of the given rig that the recordings contradict, the least probable first; none if the given rig is
            as good.
        estimates: identified coefficients, by dotted section and name in the rig file; also errors that are not significant.
        why_not: reasons for those not identifiable.
    """

    rig: Rig
    wrong: tuple[WrongValue, ...]
    estimates: Mapping[str, Estimate]
    why_not: Mapping[str, str]

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
    return Identification(found.rig, _wrong_values(found, rig), {**found.absent, **found.estimates}, found.not_identifiable)


def with_shifts_included(rig: Rig) -> Rig:
    """Return a rig whose coefficients include the shifts of its effects, which are left out."""
    shifts = tuple(use for use in rig.effects if only_shifts(use.name))
    whole = rig._replace(effects=shifts).effective()
    others = tuple(use for use in rig.effects if use not in shifts)
    return rig._replace(plant=whole.plant, friction=whole.friction, sensors=whole.sensors, effects=others)


def _wrong_values(found: RigIdentification, rig: Rig) -> tuple[WrongValue, ...]:
    """Return the significantly wrong numbers of the given rig if its residuals are larger by a relevant part of a balance."""
    gained = max((math.sqrt(max(c.before**2 - c.after**2, 0.0)) for c in found.channels.values()), default=0.0)
    if gained < rules.RELEVANT:
        return ()
    sigmas = {path: abs(e.value - read(rig, path)) / max(e.std, 1e-300) for path, e in found.estimates.items()}
    order = sorted((path for path in sigmas if sigmas[path] > MIN_SIGMAS), key=lambda path: -sigmas[path])
    return tuple(WrongValue(path, read(rig, path), *found.estimates[path]) for path in order)


def wrong_values(wrong: tuple[WrongValue, ...]) -> str:
    """Describe wrong numbers of the rig file."""
    parts = (
        f"{w.name.partition('.')[2]} {w.given:.3g}, the recordings say {w.fitted:.4g} ± {1.96 * w.std:.2g}"
        f"{'' if w.unit == '1' else f' {w.unit}'}"
        for w in wrong
    )
    return "; ".join(parts)
