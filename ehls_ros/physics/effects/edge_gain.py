"""A metering edge passes more or less flow than in the rig file."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.physics.valve.four_edges import CHAMBER_OF_EDGE, EDGES
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = "gain of an edge -> factor gain"
SOURCE = "Jelali, Kroll, Hydraulic Servo-systems, 2003, ch. 4: flow coefficients by edge"
WORDS = Words(
    "the flow gain of a metering edge",
    lacking=False,
    inspect="look for dirt or a chipped notch at that edge, and for a sleeve of another valve",
    measure="apply the same command in both directions and compare the flows into and out of each chamber",
    change="multiply the edge's `gain` of the valve in the rig file by the factor",
)
SIDES = {f"gain_{edge}": side for edge, side in CHAMBER_OF_EDGE.items()}


class Parameters(NamedTuple):
    """Factors on the edges' gains."""

    gain_pa: Annotated[float, quantity("1", "factor on the gain of edge P-A", minimum=0.02, maximum=20.0)] = 1.0
    gain_at: Annotated[float, quantity("1", "the same of edge A-T", minimum=0.02, maximum=20.0)] = 1.0
    gain_pb: Annotated[float, quantity("1", "the same of edge P-B", minimum=0.02, maximum=20.0)] = 1.0
    gain_bt: Annotated[float, quantity("1", "the same of edge B-T", minimum=0.02, maximum=20.0)] = 1.0


def shift_chambers(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the gains scaled."""
    own = rig.valve.parameters
    return rig.with_valve(**{f"gain_{e}": getattr(own, f"gain_{e}") * getattr(parameters, f"gain_{e}") for e in EDGES})


def forms(rig: Rig) -> tuple[Form, ...]:
    """One edge at a time."""
    return tuple(Form({f"gain_{edge}": ()}) for edge in EDGES) if rig.cylinder.law.CHAMBERS else ()
