"""More or less oil leaks past the piston than in the rig file."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "flow"
EQUATION = "Ctc -> Ctc + added, at least 0"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 6: leakage across the piston"
WORDS = Words(
    "the leakage past the piston",
    lacking=False,
    inspect="inspect the piston seal and the valve's lands",
    measure="hold the piston against a stop under pressure and measure the flow past it",
    change="add the fitted value to `leakage_coefficient` in the rig file",
)


class Parameters(NamedTuple):
    """Change of the leakage coefficient."""

    added: Annotated[float, quantity("m^5/(N s)", "added to the leakage coefficient", minimum=-1e-9, maximum=1e-9)] = 0.0


def shift(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the leakage coefficient shifted."""
    leakage = max(rig.plant.leakage_coefficient + parameters.added, 0.0)
    return rig.with_plant(leakage_coefficient=leakage)


def forms(rig: Rig) -> tuple[Form, ...]:
    """The added coefficient."""
    return (Form({"added": ()}),)
