"""A metering edge is worn: it opens earlier, or is rounded and leaks about null."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Share, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.physics.valve.four_edges import CHAMBER_OF_EDGE, EDGES
from ehls_ros.schema import quantity

GROUP: Group = "valve"
EQUATION = "overlap of an edge -> overlap - lap,  rounding -> rounding + round"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 5: underlap, rounded edges and radial clearance"
WORDS = Words(
    "wear of a metering edge",
    inspect="inspect that land of spool and sleeve for erosion",
    measure="block both ports and measure the flow from P to T over the command about null: the wear raises one flank",
    change="keep `edge_wear` under `effects` in the rig file until the valve is replaced, or change the edge's overlap there",
)
SIDES = {f"{kind}_{edge}": side for kind in ("lap", "round") for edge, side in CHAMBER_OF_EDGE.items()}

STARTS = (0.005, 0.03)
"""Rounding at the start of a fit, as a fraction of the largest spool displacement."""

_LAP, _ROUND = "taken from the overlap of edge {}", "added to the rounding of edge {}"


class Parameters(NamedTuple):
    """Wear of the four edges."""

    lap_pa: Annotated[float, quantity("m", _LAP.format("P-A"), minimum=-0.01, maximum=0.01)] = 0.0
    lap_at: Annotated[float, quantity("m", _LAP.format("A-T"), minimum=-0.01, maximum=0.01)] = 0.0
    lap_pb: Annotated[float, quantity("m", _LAP.format("P-B"), minimum=-0.01, maximum=0.01)] = 0.0
    lap_bt: Annotated[float, quantity("m", _LAP.format("B-T"), minimum=-0.01, maximum=0.01)] = 0.0
    round_pa: Annotated[float, quantity("m", _ROUND.format("P-A"), minimum=0.0, maximum=0.01)] = 0.0
    round_at: Annotated[float, quantity("m", _ROUND.format("A-T"), minimum=0.0, maximum=0.01)] = 0.0
    round_pb: Annotated[float, quantity("m", _ROUND.format("P-B"), minimum=0.0, maximum=0.01)] = 0.0
    round_bt: Annotated[float, quantity("m", _ROUND.format("B-T"), minimum=0.0, maximum=0.01)] = 0.0


def shift_chambers(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with worn edges."""
    own, changed = rig.valve.parameters, dict[str, float]()
    for edge in EDGES:
        changed[f"overlap_{edge}"] = getattr(own, f"overlap_{edge}") - getattr(parameters, f"lap_{edge}")
        changed[f"rounding_{edge}"] = getattr(own, f"rounding_{edge}") + getattr(parameters, f"round_{edge}")
    return rig.with_valve(**changed)


def forms(rig: Rig) -> tuple[Form, ...]:
    """One edge at a time that opens earlier, or is rounded, or both."""
    if not rig.cylinder.law.CHAMBERS:
        return ()
    starts = tuple(Share("spool_m", part) for part in STARTS)
    laps = tuple(Form({f"lap_{edge}": ()}) for edge in EDGES)
    rounded = tuple(Form({f"round_{edge}": starts}) for edge in EDGES)
    both = tuple(Form({f"lap_{edge}": (), f"round_{edge}": starts}) for edge in EDGES)
    return (*laps, *rounded, *both)
