"""Evidence, candidates and assessments made of plain arrays, for tests that need no recording."""

import numpy as np

from ehls_ros.diagnosis.evidence import Evidence, Residuals
from ehls_ros.diagnosis.fit import Fit
from ehls_ros.diagnosis.held_out import Assessment, HeldOut, assess
from ehls_ros.diagnosis.hypotheses import Candidate
from ehls_ros.diagnosis.loss import loss
from ehls_ros.diagnosis.record import USED

SIZE = 100.0
"""Rms of the largest term in each balance, in units of the noise floor."""


def evidence_of(base, noise=None, blocks=12):
    """Return evidence with whitened residuals of the given model by channel, their windows split evenly into blocks.

    Without noise given, another realisation of standard deviation 1 is taken.
    """
    rng = np.random.default_rng(99)
    block = {c: np.arange(len(e)) * blocks // len(e) for c, e in base.items()}
    return Evidence(
        record=USED,  # nothing is missing
        rig=None,
        setup=None,
        channels=tuple(base),
        masks={c: np.ones(len(e), dtype=bool) for c, e in base.items()},
        floor={c: np.ones(len(e)) for c, e in base.items()},
        sizes=dict.fromkeys(base, SIZE),
        times={c: 2.5 * b for c, b in block.items()},
        block=block,
        blocks=blocks,
        base=Residuals(base),
        noise={c: rng.standard_normal(len(e)) for c, e in base.items()} if noise is None else noise,
        noisy_record=None,
        travel=0.1,
    )


def candidate(name, *free, lower=-np.inf, upper=np.inf, neutral=0.0):
    """Return an effect with free parameters that start at their neutral values."""
    p = len(free)
    values = np.full(p, neutral)
    return Candidate(name, 0, free, (), values[None, :], np.full(p, lower), np.full(p, upper), ("1",) * p, values)


MASS = candidate("mass_shift", "factor", neutral=1.0)
VISCOUS = candidate("viscous_shift", "added")
VALVE = candidate("valve_gain_shift", "gain", neutral=1.0)


def linear_fit(evidence, hypothesis, jacobian, channel="force"):
    """Return the least-squares fit of a model whose residuals are linear in its parameters, assessed on held-out blocks."""
    base = evidence.base.values[channel]
    values = -np.linalg.lstsq(jacobian, base, rcond=None)[0]
    e = base + jacobian @ values
    residuals = Residuals({**evidence.base.values, channel: e})
    fit = Fit(hypothesis, values, (channel,), residuals, jacobian, float(np.sum(loss(e))), np.ones(len(values)))
    return assess(evidence, fit)


def nothing(evidence):
    """Return the given model as a hypothesis without causes."""
    return assess(evidence, Fit((), np.empty(0), (), evidence.base, np.empty((0, 0)), 0.0, np.empty(0)))


def assessed(hypothesis, residuals, values=(), gain=None, covariance=None):
    """Return an assessment with residuals that are the same in and out of the fit, and gains by channel and block."""
    kept, values = Residuals(residuals), np.array(values, dtype=float)
    covariance = np.eye(len(values)) if covariance is None else covariance
    channels = tuple(gain) if gain is not None else tuple(residuals)
    fit = Fit(hypothesis, values, channels, kept, np.empty((0, 0)), 0.0, np.ones(len(values)))
    return Assessment(fit, HeldOut({c: np.zeros(12) for c in channels} if gain is None else gain, kept, covariance, 0.0))
