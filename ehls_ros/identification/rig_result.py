"""Result of the identification of a whole rig, and its content in ``identification.json``."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.coefficients import NO_ERRORS, RelativeErrors
from ehls_ros.diagnosis.stages import CHANNELS, Channel
from ehls_ros.estimate import Estimate
from ehls_ros.physics.rig import Rig


class ChannelFit(NamedTuple):
    """Rms of one residual, as a fraction of the largest term of its balance.

    Attributes:
        before: of the given rig.
        after: of the fitted rig.
        noise: of noise alone, the rms of the noise floor.
    """

    before: float
    after: float
    noise: float


class RigIdentification(NamedTuple):
    """A rig identified from recordings.

    Attributes:
        rig: the rig with the identified coefficients; those not identifiable keep their given values.
        estimates: the identified coefficients, by dotted section and name in the rig file. A list of stiffnesses is represented
            by its sum: all are changed by one factor.
        covariance: of the estimates, shape (n, n), in their order.
        correlations: likewise.
        absent: biases and sensor errors that were fitted but are not significant; the rig has none of them.
        not_identifiable: coefficients that the data do not identify, with the reason.
        channels: goodness of fit, by residual.
        recordings: names of the recordings used.
        remarks: sentences about the data and the limits of the result.
        wall_s: wall time [s].
        errors: of all coefficients that were fitted, also of those not identifiable.
    """

    rig: Rig
    estimates: Mapping[str, Estimate]
    covariance: Array
    correlations: Array
    absent: Mapping[str, Estimate]
    not_identifiable: Mapping[str, str]
    channels: Mapping[Channel, ChannelFit]
    recordings: tuple[str, ...]
    remarks: tuple[str, ...]
    wall_s: float
    errors: RelativeErrors = NO_ERRORS


def rig_to_json(found: RigIdentification) -> dict[str, Any]:
    """Return the content of ``identification.json``."""
    return {
        "parameters": {path: estimate._asdict() for path, estimate in found.estimates.items()},
        "correlations": {"names": list(found.estimates), "matrix": found.correlations.tolist()},
        "absent": {path: estimate._asdict() for path, estimate in found.absent.items()},
        "not_identifiable": dict(found.not_identifiable),
        "residuals": {name: {"stage": CHANNELS[name], **channel._asdict()} for name, channel in found.channels.items()},
        "recordings": list(found.recordings),
        "remarks": list(found.remarks),
        "wall_s": found.wall_s,
    }
