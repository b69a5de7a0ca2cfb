"""The frames of a rig, and their description as URDF for RViz, Foxglove and robot_state_publisher.

The rig is drawn upright, as plain boxes and cylinders: the loading cylinder is below one end of a beam that pivots about a
hinge at its centre. Stroke, arm and bore are the rig file's; other dimensions, such as the height of the hinge, are chosen so
that the parts meet.
"""

import math
from xml.etree import ElementTree as ET

from ehls_ros.physics.rig import Rig
from ehls_ros.recording.topics import LOADER_FRAME, NAMESPACE

BASE, CYLINDER, BEAM = "base_link", "cylinder", "beam"
"""The other frames: the ground below the hinge, x towards the loading cylinder and z up; the cylinder's barrel; the beam."""

JOINT = "loader"
"""Joint of ``joint_states``: its position is the piston's, its effort the driving force."""

Triple = tuple[float, float, float]

UPRIGHT = (0.0, -math.pi / 2.0, 0.0)
"""Roll, pitch and yaw that turn a frame's x axis up [rad]."""


def frame_prefix(namespace: str) -> str:
    """Return the prefix of a rig's frames, since all rigs share /tf; empty in the default namespace.

    Args:
        namespace: of the rig's nodes, such as ``/rig2``.
    """
    return "" if namespace in {"", "/", NAMESPACE} else f"{namespace.strip('/')}/"


def loader_frame(namespace: str) -> str:
    """Return the frame that a rig's messages refer to."""
    return frame_prefix(namespace) + LOADER_FRAME


def robot_description(rig: Rig) -> str:
    """Return the URDF of a rig: barrel, piston and beam on the ground.

    The beam follows the piston by position over arm, the small-angle approximation. The model has no masses: it is for display.

    Args:
        rig: the rig; its arm, areas and limits are used.
    """
    arm, limits = rig.plant.arm_length, rig.limits
    low, high = limits.position
    stroke, (radius, rod) = high - low, _radii(rig)
    robot = ET.Element("robot", name="ehls")
    ET.SubElement(robot, "link", name=BASE)
    _cylinder(robot, CYLINDER, 1.5 * radius, stroke, 0.5 * stroke, (0.35, 0.4, 0.45))
    # The rod ends at the piston's frame and is inside the barrel where the piston is at its lower end.
    _cylinder(robot, LOADER_FRAME, rod, stroke, -0.5 * stroke, (0.75, 0.75, 0.78))
    beam = _visual(robot, BEAM, (0.85, 0.55, 0.15))
    ET.SubElement(ET.SubElement(beam, "geometry"), "box", size=_numbers(2.0 * arm, 2.0 * radius, 2.0 * radius))

    _joint(robot, "barrel", "fixed", (BASE, CYLINDER), (arm, 0.0, 0.0), UPRIGHT)
    piston = _joint(robot, JOINT, "prismatic", (CYLINDER, LOADER_FRAME), (stroke - low, 0.0, 0.0))
    ET.SubElement(piston, "axis", xyz="1 0 0")
    _limit(piston, low, high, limits.force, limits.velocity)
    hinge = _joint(robot, "hinge", "revolute", (BASE, BEAM), (0.0, 0.0, stroke - low))
    # About -y, the end at +x rises with the piston.
    ET.SubElement(hinge, "axis", xyz="0 -1 0")
    _limit(hinge, low / arm, high / arm, limits.force * arm, limits.velocity / arm)
    ET.SubElement(hinge, "mimic", joint=JOINT, multiplier=_numbers(1.0 / arm))
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode")


def _radii(rig: Rig) -> tuple[float, float]:
    """Return the radii of piston and rod [m]; a rod that the rig file does not tell has half of the piston's."""
    areas = rig.plant.piston_area, rig.plant.piston_area
    if rig.cylinder.law.CHAMBERS:
        areas = rig.cylinder.parameters.area_a, rig.cylinder.parameters.area_b
    radius, rod = math.sqrt(max(areas) / math.pi), math.sqrt(abs(areas[0] - areas[1]) / math.pi)
    return radius, rod or 0.5 * radius


def _visual(robot: ET.Element, link: str, colour: Triple) -> ET.Element:
    visual = ET.SubElement(ET.SubElement(robot, "link", name=link), "visual")
    material = ET.SubElement(visual, "material", name=link)
    ET.SubElement(material, "color", rgba=_numbers(*colour, 1.0))
    return visual


def _cylinder(robot: ET.Element, link: str, radius: float, length: float, middle: float, colour: Triple) -> None:
    """Add a link drawn as a cylinder along x, centred at a position on x."""
    visual = _visual(robot, link, colour)
    # The axis of URDF's cylinder is z.
    ET.SubElement(visual, "origin", xyz=_numbers(middle, 0.0, 0.0), rpy=_numbers(0.0, math.pi / 2.0, 0.0))
    ET.SubElement(ET.SubElement(visual, "geometry"), "cylinder", radius=_numbers(radius), length=_numbers(length))


def _joint(
    robot: ET.Element, name: str, kind: str, links: tuple[str, str], at: Triple, turned: Triple = (0.0, 0.0, 0.0)
) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    for tag, link in zip(("parent", "child"), links, strict=True):
        ET.SubElement(joint, tag, link=link)
    ET.SubElement(joint, "origin", xyz=_numbers(*at), rpy=_numbers(*turned))
    return joint


def _limit(joint: ET.Element, lower: float, upper: float, effort: float, velocity: float) -> None:
    values = {"lower": lower, "upper": upper, "effort": effort, "velocity": velocity}
    ET.SubElement(joint, "limit", {name: _numbers(value) for name, value in values.items()})


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.12g}" for value in values)
