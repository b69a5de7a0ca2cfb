"""Gain of a found model on another recording, to which nothing was fitted."""

from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import gather
from ehls_ros.diagnosis.loss import power
from ehls_ros.diagnosis.measurement import BEYOND_MEASUREMENT
from ehls_ros.diagnosis.record import prepare
from ehls_ros.diagnosis.result import ChannelGain, Diagnosis
from ehls_ros.diagnosis.stages import Channel, setup
from ehls_ros.trajectory import Trajectory


def carried_over(found: Diagnosis, other: Trajectory, name: str, *, seed: int = 0) -> dict[Channel, ChannelGain]:
    """Return the fraction of another recording's error that the extended model closes, by channel with an error.

    It is negative where the extension makes an error, and -1 where there was none.

    Args:
        found: the diagnosis; its extended model is taken as it is.
        other: another recording of the same rig, best with another motion.
        name: its name in errors.
        seed: of the noise added to find the noise floor.

    Raises:
        BadInput: the recording cannot be one of such a rig.
    """
    record = prepare(other, found.rig, name)
    compared = setup(record, found.rig)
    if not compared.channels:
        return {}
    evidence = BEYOND_MEASUREMENT.judged(gather(record, found.rig, compared, seed))
    after = evidence.residuals(evidence.comparison(), found.extended)
    out = dict[Channel, ChannelGain]()
    for c in evidence.channels:
        before, then, noise = (power(e) for e in (evidence.base.values[c], after.values[c], evidence.noise[c]))
        if max(before, then) > rules.REMOVABLE * noise:
            removable = max(before, then) - noise
            out[c] = ChannelGain(min((before - then) / removable, 1.0), noise / removable)
    return out
