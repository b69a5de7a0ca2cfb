"""How probable a hypothesis is among its rivals."""

from collections.abc import Sequence

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.diagnosis import rules


def probability_of_first(gains: Sequence[Array], parameters: Sequence[int], seed: int) -> float:
    """Return the probability of the first of several hypotheses, given what each gains on every held-out block.

    Stacking by a Bayesian bootstrap of the blocks (Yao, Vehtari, Simpson, Gelman 2018): the mean over resamplings of its share
    of the likelihood.

    Args:
        gains: of each hypothesis, shape (blocks,) [nats]; empty for one that changes nothing.
        parameters: number of free parameters of each.
        seed: of the resampling.
    """
    rng = np.random.default_rng(seed)
    blocks = max((len(g) for g in gains), default=1)
    table = np.array([np.resize(g, blocks) if len(g) else np.zeros(blocks) for g in gains])
    penalty = rules.PENALTY * np.array(parameters)
    weights = rng.dirichlet(np.ones(blocks), rules.RESAMPLED) * blocks
    scores = weights @ table.T - penalty
    scores -= scores.max(axis=1, keepdims=True)
    likelihood = np.exp(scores)
    return float(np.mean(likelihood[:, 0] / likelihood.sum(axis=1)))
