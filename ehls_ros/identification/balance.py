"""Force balance (3), (5) along a recorded motion.

    F = m0 a + (B0 + σf) v + ks x + F0 + Ff

The balance is linear in mass, viscous damping, spring and constant force. Only the friction model has to be run along the
motion.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ehls_ros.arrays import Array
from ehls_ros.errors import BadInput
from ehls_ros.identification.motion import Motion
from ehls_ros.physics.rig import Rig
from ehls_ros.samples import Mask

UNIT_FACTOR = 100.0
"""Factor by which a result may differ from the rig file before a wrong unit is suspected."""


class Recorded(NamedTuple):
    """Recordings to which the force balance is fitted.

    Attributes:
        motions: the recordings.
        usable: mask of the blocks to be fitted, of shape (n,) for each recording.
        linear: linear coefficients to fit, a subset of ``viscous``, ``spring``, ``constant`` and ``mass``.
    """

    motions: tuple[Motion, ...]
    usable: tuple[Mask, ...]
    linear: tuple[str, ...]

    def chosen(self, which: Iterable[int]) -> "Recorded":
        """Return a selection of the recordings by index."""
        which = list(which)
        return self._replace(motions=tuple(self.motions[i] for i in which), usable=tuple(self.usable[i] for i in which))


def linear_columns(motion: Motion, names: Sequence[str]) -> Array:
    """Return the regressors of the linear coefficients.

    Args:
        motion: the recording, n blocks.
        names: linear coefficients, a subset of ``viscous``, ``spring``, ``constant`` and ``mass``.

    Returns:
        Array of shape (n, len(names)): velocity [m/s], position [m], 1 and acceleration [m/s^2].
    """
    columns = {
        "viscous": motion.velocity,
        "spring": motion.position,
        "constant": np.ones(len(motion.velocity)),
        "mass": motion.acceleration,
    }
    return np.column_stack([columns[name] for name in names])


def without_known(motion: Motion, linear: Sequence[str], rig: Rig) -> Motion:
    """Return a motion less the rig file's spring and inertia forces, unless spring and mass are fitted."""
    force = motion.force.copy()
    if "spring" not in linear:
        force -= rig.plant.spring_stiffness * motion.position
    if "mass" not in linear:
        force -= rig.plant.moving_mass * motion.acceleration
    return motion._replace(force=force)


def check_unit(what: str, found: float, known: float, names: str) -> None:
    """Reject a result that only a wrong unit explains.

    Args:
        what: the coefficient, for the error.
        found: its value from the recordings.
        known: its value in the rig file.
        names: the recordings, for the error.

    Raises:
        BadInput: they differ by more than :data:`UNIT_FACTOR`.
    """
    ratio = abs(found) / known
    if not 1.0 / UNIT_FACTOR < ratio < UNIT_FACTOR:
        raise BadInput(
            f"force_n and position_m make the {what} {found:.3g}, {ratio:.2g} times the rig file's {known:.3g}",
            names,
            "SI units, N and m (see --columns), or a rig file with a closer guess",
        )
