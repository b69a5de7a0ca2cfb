"""Run a friction estimator: its compiled observer and its state."""

from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

from ehls_ros.arrays import Array, direct
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.observers.base import ELEMENTS, FrictionObserver, check_friction_support
from ehls_ros.control.rig_scale import tuned_for
from ehls_ros.physics.composition import compiled
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.friction.base import FrictionModel
from ehls_ros.physics.rig import Rig


class Compiled(NamedTuple):
    """The compiled ``update`` of a friction observer, see :mod:`ehls_ros.control.observers.base`."""

    update: Callable[..., None]


def build(observer: FrictionObserver, friction: FrictionModel) -> Compiled:
    """Build an observer for a friction model."""
    return Compiled(observer.updater(friction))


def observer_kernel(name: str, model: str) -> ModuleType:
    """Return a module with the compiled ``update`` of one friction observer, for one friction model."""
    members = {"observer": OBSERVERS.load(name), "friction": FRICTION_MODELS.load(model)}
    return compiled(build, {"update": "velocity, period, friction, p, state"}, members)


class FrictionEstimator:
    """Friction observer of any kind, updated once per cycle."""

    def __init__(self, name: str, rig: Rig, period: float, parameters: Any = None) -> None:
        """Prepare the observer, compiling or loading its code.

        Args:
            name: file name of the observer.
            rig: the rig as identified, for its friction.
            period: time between updates [s].
            parameters: parameters of the observer; None for the defaults of the rig.

        Raises:
            BadInput: the observer does not support the rig's friction model.
        """
        check_friction_support(OBSERVERS, name, rig, "friction estimator")
        self._observer = OBSERVERS.load(name)
        self._update = observer_kernel(name, rig.friction_model).update
        self._rig = rig
        self.period = period
        self.parameters = tuned_for(self._observer.Parameters, rig) if parameters is None else parameters
        self.reset()
        self._direct = direct(self._update, 0.0, period, rig.friction, self.parameters, self.state)
        for velocity in (0.0, 1e-3):
            self.update(velocity)
        self.reset()

    def reset(self) -> None:
        """Put the elements at rest."""
        self.state = self._observer.state(self._rig.friction_law, self._rig.friction)

    def update(self, velocity: float, elapsed: int = 1) -> Array:
        """Update the estimate by one more measured velocity.

        Args:
            velocity: measured velocity [m/s].
            elapsed: cycles since the last one.

        Returns:
            The estimate in the layout of :mod:`ehls_ros.control.observers.base`; the same array every time.
        """
        self._direct(velocity, elapsed * self.period, self._rig.friction, self.parameters, self.state)
        return self.state.estimate

    @property
    def element_forces(self) -> Array:
        """Force of each element [N]."""
        estimate = self.state.estimate
        elements: Array = estimate[ELEMENTS : ELEMENTS + (estimate.size - ELEMENTS) // 2]
        return elements

    @property
    def slipping(self) -> Array:
        """1 for each slipping element, 0 for each sticking one."""
        estimate = self.state.estimate
        flags: Array = estimate[ELEMENTS + (estimate.size - ELEMENTS) // 2 :]
        return flags
