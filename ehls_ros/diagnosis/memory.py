"""Noise that a model remembers: the force of friction after each reversal depends on the noise of the motion until it slides.

Such an error is the same in many windows, so together they tell as little of a cause as one. Added noise shows where and how
large it is: there the mean of many windows scatters as much as each of them.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from ehls_ros.arrays import Array
from ehls_ros.diagnosis.windows import OVERLAP

LENGTH = 20
"""Windows over which noise is averaged where a model may remember it."""

LASTING = 2.5
"""Variance of that mean, in multiples of that of independent windows, from which they have one error.

Origin: in residuals without memory it is 1.1 at most in 99 of 100 windows.
"""


def remembered(added: Sequence[Array], times: Array) -> list[Array]:
    """Return the standard deviation of each error that lasts over its windows, 0 in the others, each of shape (n,).

    Args:
        added: change of the residuals by each realisation of added noise, each of shape (n,).
        times: of the windows, shape (n,) [s].
    """
    if not added or len(times) < 2 * LENGTH:
        return []
    changes = np.array(added)
    slow = np.mean(scipy.ndimage.uniform_filter1d(changes, LENGTH, axis=1) ** 2, axis=0)
    every = scipy.ndimage.uniform_filter1d(np.mean(changes**2, axis=0), LENGTH)
    lasting = LENGTH * slow > LASTING * OVERLAP * every
    step = np.diff(times)
    # Across a pause there is another error.
    bounds = 1 + np.flatnonzero((lasting[1:] != lasting[:-1]) | (step > LENGTH * float(np.median(step))))
    out = []
    for begin, end in zip([0, *bounds], [*bounds, len(times)], strict=True):
        if lasting[begin] and end - begin >= LENGTH // 4:
            out.append(np.zeros(len(times)))
            out[-1][begin:end] = np.sqrt(slow[begin:end])
    return out
