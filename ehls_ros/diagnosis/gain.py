"""Gain of the extended model on held-out data."""

from collections.abc import Mapping

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules
from ehls_ros.diagnosis.evidence import Evidence
from ehls_ros.diagnosis.held_out import RESAMPLED, Assessment
from ehls_ros.diagnosis.loss import closed, power
from ehls_ros.diagnosis.result import ChannelGain, Gain
from ehls_ros.diagnosis.stages import Channel


def gain(evidence: Evidence, best: Assessment, noise: Mapping[Channel, float], seed: int) -> Gain | None:
    """Return the gain of the causes on held-out data; None if they change nothing.

    Args:
        evidence: the recording compared with the given model.
        best: the causes.
        noise: rms noise in each channel, as a fraction of the largest term.
        seed: of the resampling.
    """
    channels = tuple(best.held_out.gain)
    if not channels:
        return None
    base, held_out = evidence.base.values, best.held_out.residuals.values

    def removed(c: Channel) -> float:
        return float(np.sum(base[c] ** 2 - held_out[c] ** 2))

    main = max(channels, key=removed)
    # A channel without removable error holds no information on the fraction removed.
    counted = tuple(c for c in channels if power(base[c]) > rules.REMOVABLE * power(evidence.noise[c])) or (main,)
    before, after, chance = (
        np.sum([np.bincount(evidence.block[c], e[c] ** 2, evidence.blocks) for c in counted], axis=0)
        for e in (base, held_out, evidence.noise)
    )
    fraction, ci95 = closed_fraction(before, after, chance, seed)
    return Gain(
        channel=main,
        heldout_nrmse_before=evidence.nrmse(main, base[main]),
        heldout_nrmse_after=evidence.nrmse(main, held_out[main]),
        noise_floor=noise[main],
        closed_fraction=fraction,
        ci95=ci95,
        channels={c: _channel_gain(evidence, held_out[c], c) for c in counted},
    )


def _channel_gain(evidence: Evidence, after: Array, channel: Channel) -> ChannelGain:
    before, noise = evidence.base.values[channel], evidence.noise[channel]
    removable = max(power(before) - power(noise), 1e-300)
    return ChannelGain(min(closed(before, after, noise), 1.0), power(noise) / removable)


def closed_fraction(before: Array, after: Array, noise: Array, seed: int) -> tuple[float, tuple[float, float]]:
    """Return the fraction of the removable power that was removed, and its 95 % interval from a bootstrap of the blocks.

    Args:
        before: sum of squares of the given model's whitened residuals, by block.
        after: the same of the extended model.
        noise: the same of noise alone.
        seed: of the resampling.
    """
    blocks = len(before)
    weights = np.random.default_rng(seed).multinomial(blocks, np.ones(blocks) / blocks, RESAMPLED)
    with np.errstate(divide="ignore", invalid="ignore"):
        fractions = (weights @ (before - after)) / (weights @ (before - noise))
    fractions = fractions[np.isfinite(fractions)]
    low, high = np.quantile(fractions, [0.025, 0.975]) if fractions.size else (0.0, 0.0)
    removable = float(before.sum() - noise.sum())
    enough = removable > (rules.REMOVABLE - 1.0) * float(noise.sum())
    closed = float(before.sum() - after.sum()) / removable if enough else 0.0
    return min(closed, 1.0), (float(min(low, 1.0)), float(min(high, 1.0)))
