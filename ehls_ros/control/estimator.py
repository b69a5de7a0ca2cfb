"""A friction estimator ready to run: its observer compiled, and its state."""

from typing import Any

from ehls_ros.arrays import Array
from ehls_ros.control.composition import observer_kernel
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.observers.base import ELEMENTS
from ehls_ros.physics.parameters import Friction


class FrictionEstimator:
    """One friction observer of any kind, updated once a cycle."""

    def __init__(self, name: str, friction: Friction, period: float, parameters: Any = None) -> None:
        """Prepare and compile (or load) the observer.

        Args:
            name: file name of the observer.
            friction: identified friction of the rig.
            period: time between updates [s].
            parameters: its parameters; None: the declared defaults.
        """
        self._observer = OBSERVERS.load(name)
        self._update = observer_kernel(name).update
        self.friction = friction
        self.period = period
        self.parameters = parameters if parameters is not None else self._observer.Parameters()
        self.reset()
        for velocity in (0.0, 1e-3):
            self.update(velocity)
        self.reset()

    def reset(self) -> None:
        """Put the elements at rest."""
        self.state = self._observer.state(self.friction)

    def update(self, velocity: float, elapsed: int = 1) -> Array:
        """Take one more measured velocity.

        Args:
            velocity: as measured [m/s].
            elapsed: cycles since the last one.

        Returns:
            The estimate as :mod:`ehls_ros.control.observers.base` lays it out; the same array every time.
        """
        self._update(velocity, elapsed * self.period, self.friction, self.parameters, self.state)
        return self.state.estimate

    @property
    def element_forces(self) -> Array:
        """Force of each element [N]."""
        estimate = self.state.estimate
        elements: Array = estimate[ELEMENTS : ELEMENTS + (estimate.size - ELEMENTS) // 2]
        return elements

    @property
    def slipping(self) -> Array:
        """1 for each element that slips, 0 for one that sticks."""
        estimate = self.state.estimate
        flags: Array = estimate[ELEMENTS + (estimate.size - ELEMENTS) // 2 :]
        return flags
