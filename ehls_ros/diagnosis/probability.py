"""Relative probabilities of competing hypotheses."""

from collections.abc import Sequence

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules


def probabilities(gains: Sequence[Array], parameters: Sequence[int], seed: int) -> Array:
    """Return the probability of each of several hypotheses, given their gains on the held-out blocks.

    Stacking by a Bayesian bootstrap of the blocks (Yao, Vehtari, Simpson, Gelman 2018): the mean over resamplings of its share
    of the likelihood.

    Args:
        gains: of each hypothesis, shape (blocks,) [nats]; empty for a hypothesis that changes nothing.
        parameters: number of free parameters of each.
        seed: of the resampling.

    Returns:
        The probabilities, shape (hypotheses,).
    """
    rng = np.random.default_rng(seed)
    blocks = max((len(g) for g in gains), default=1)
    table = np.array([np.resize(g, blocks) if len(g) else np.zeros(blocks) for g in gains])
    penalty = rules.PENALTY * np.array(parameters)
    weights = rng.dirichlet(np.ones(blocks), rules.RESAMPLED) * blocks
    scores = weights @ table.T - penalty
    scores -= scores.max(axis=1, keepdims=True)
    likelihood = np.exp(scores)
    mean: Array = np.mean(likelihood / likelihood.sum(axis=1, keepdims=True), axis=0)
    return mean
