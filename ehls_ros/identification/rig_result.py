"""The result of identifying a whole rig, and what ``identification.json`` holds of it."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.stages import CHANNELS, Channel
from ehls_ros.estimate import Estimate
from ehls_ros.physics.rig import Rig


class ChannelFit(NamedTuple):
    """How well the model does in one residual, as rms and as a fraction of the largest term of its balance.

    Attributes:
        before: of the given rig.
        after: of the fitted rig.
        noise: that noise alone gives, the rms of the noise floor.
    """

    before: float
    after: float
    noise: float


class RigIdentification(NamedTuple):
    """A rig identified from recordings.

    Attributes:
        rig: the rig with the identified coefficients; what the data do not tell is as it was given.
        estimates: what the data tell, by section and name in the rig file, with dots. A list of stiffnesses stands for its
            sum: all are changed by one factor.
        covariance: of the estimates, shape (n, n), in their order.
        correlations: likewise.
        absent: biases and sensor errors that were looked for and are not told from none; the rig has none of them.
        not_identifiable: coefficients that the data do not tell, with the reason.
        channels: how well the model does, by residual.
        recordings: names of the recordings that were used.
        remarks: sentences about the data and the limits of the result.
        wall_s: wall time [s].
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


def rig_to_json(found: RigIdentification) -> dict[str, Any]:
    """Return what ``identification.json`` holds."""
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
