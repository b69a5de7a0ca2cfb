"""A hose to a chamber widens more than the rig file says."""

from typing import Annotated, NamedTuple

from ehls_ros.physics.effects.base import Form, Group, Words
from ehls_ros.physics.rig import Rig
from ehls_ros.schema import quantity

GROUP: Group = "flow"
EQUATION = "H_A -> H_A + first,  H_B -> H_B + second, at least 0"
SOURCE = "Merritt, Hydraulic Control Systems, 1967, ch. 2: elastic walls in the effective bulk modulus"
WORDS = Words(
    "the compliance of a hose",
    lacking=False,
    inspect="look for a long, old or wrong hose between valve and cylinder",
    measure="feel or gauge the hose's diameter under pressure, or replace it by a steel line and record again",
    change="add the fitted value to `hose_compliance_a` or `hose_compliance_b` of the cylinder, or shorten the hose",
)
SIDES = {"first": "a", "second": "b"}


class Parameters(NamedTuple):
    """Changes of the hoses' compliances."""

    first: Annotated[float, quantity("m^3/Pa", "added to the hose to A", minimum=-1e-8, maximum=1e-8)] = 0.0
    second: Annotated[float, quantity("m^3/Pa", "added to the hose to B", minimum=-1e-8, maximum=1e-8)] = 0.0


def shift_chambers(rig: Rig, parameters: Parameters) -> Rig:
    """Return the rig with the compliances added to those of its hoses."""
    own, p = rig.cylinder.parameters, parameters
    return rig.with_cylinder(
        hose_compliance_a=max(own.hose_compliance_a + p.first, 0.0),
        hose_compliance_b=max(own.hose_compliance_b + p.second, 0.0),
    )


def forms(rig: Rig) -> tuple[Form, ...]:
    """One hose or the other."""
    return (Form({"first": ()}), Form({"second": ()})) if rig.cylinder.law.CHAMBERS else ()
