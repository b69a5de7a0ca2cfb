"""The URDF of a rig: well formed, one tree, and with the rig file's limits."""

import math
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import chosen_spec, load_rig
from ehls_ros.nodes.frames import BASE, BEAM, CYLINDER, JOINT, frame_prefix, robot_description
from ehls_ros.recording.topics import LOADER_FRAME

RIG = chosen_spec("", "").rig
LOPSIDED = RIG._replace(
    plant=RIG.plant._replace(arm_length=0.8),
    limits=RIG.limits._replace(position=(-0.05, 0.25), force=5e3, velocity=0.7),
)


def parsed(rig):
    robot = ET.fromstring(robot_description(rig))
    joints = {joint.attrib["name"]: joint for joint in robot.findall("joint")}
    return [link.attrib["name"] for link in robot.findall("link")], joints


def numbers(element, attribute):
    return [float(value) for value in element.attrib[attribute].split()]


def placed(joints, rig, position):
    """Return each link's position and rotation in the base's frame when the piston is at a position [m]."""
    where = {BASE: np.eye(4)}
    for joint in joints.values():
        origin = joint.find("origin")
        pose = np.eye(4)
        pose[:3, 3] = numbers(origin, "xyz")
        pose[:3, :3] = turned([0.0, 1.0, 0.0], numbers(origin, "rpy")[1])
        assert numbers(origin, "rpy")[::2] == [0.0, 0.0]
        moved = np.eye(4)
        if joint.attrib["type"] == "prismatic":
            moved[:3, 3] = position * np.array(numbers(joint.find("axis"), "xyz"))
        elif joint.attrib["type"] == "revolute":
            follows = joint.find("mimic")
            assert follows.attrib["joint"] == JOINT
            moved[:3, :3] = turned(numbers(joint.find("axis"), "xyz"), float(follows.attrib["multiplier"]) * position)
        where[joint.find("child").attrib["link"]] = where[joint.find("parent").attrib["link"]] @ pose @ moved
    return where


def turned(axis, angle):
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


@pytest.mark.parametrize("rig", [RIG, LOPSIDED], ids=["paper", "lopsided"])
def test_links_and_joints_are_one_tree_and_the_limits_are_the_rigs(rig):
    links, joints = parsed(rig)
    assert sorted(links) == sorted({BASE, CYLINDER, LOADER_FRAME, BEAM})
    assert sorted(joint.find("child").attrib["link"] for joint in joints.values()) == sorted(set(links) - {BASE})
    piston, hinge = joints[JOINT], next(joint for joint in joints.values() if joint.attrib["type"] == "revolute")
    assert [piston.attrib["type"], piston.find("child").attrib["link"]] == ["prismatic", LOADER_FRAME]
    limits = {name: float(value) for name, value in piston.find("limit").attrib.items()}
    low, high = rig.limits.position
    assert limits == {"lower": low, "upper": high, "effort": rig.limits.force, "velocity": rig.limits.velocity}
    arm = rig.plant.arm_length
    assert [float(hinge.find("limit").attrib[name]) for name in ("lower", "upper")] == pytest.approx([low / arm, high / arm])


@pytest.mark.parametrize("rig", [RIG, LOPSIDED], ids=["paper", "lopsided"])
def test_the_piston_rises_along_x_of_its_frame_and_carries_the_end_of_the_beam(rig):
    _, joints = parsed(rig)
    arm = rig.plant.arm_length
    rest = placed(joints, rig, 0.0)
    end = rest[BEAM] @ [arm, 0.0, 0.0, 1.0]
    assert end == pytest.approx(rest[LOADER_FRAME][:, 3], abs=1e-9)
    step = 1e-3
    moved = placed(joints, rig, step)
    assert moved[LOADER_FRAME][:3, 3] - rest[LOADER_FRAME][:3, 3] == pytest.approx([0.0, 0.0, step], abs=1e-9)
    assert rest[LOADER_FRAME][:3, 0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
    # For small motions, the drawn beam and the piston stay together.
    assert moved[BEAM] @ [arm, 0.0, 0.0, 1.0] == pytest.approx(moved[LOADER_FRAME][:, 3], abs=step**2 / arm)


def test_a_second_rig_has_frames_of_its_own():
    assert [frame_prefix(namespace) for namespace in ("/ehls", "/rig2", "/lab/rig2", "/")] == ["", "rig2/", "lab/rig2/", ""]


def test_a_single_rod_has_its_bore_and_rod():
    single = load_rig(configured("rig_single_rod"))
    robot = ET.fromstring(robot_description(single))
    radii = {
        link.attrib["name"]: float(shape.attrib["radius"])
        for link in robot.findall("link")
        if (shape := link.find("visual/geometry/cylinder")) is not None
    }
    # 63 mm bore, 45 mm rod.
    assert radii[CYLINDER] == pytest.approx(1.5 * 0.0315, rel=1e-2)
    assert radii[LOADER_FRAME] == pytest.approx(0.0225, rel=1e-2)
