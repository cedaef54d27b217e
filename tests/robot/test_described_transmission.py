"""Transmissions that descriptions have: tendons of MJCF, elements of URDF, files beside."""

from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.errors import ModelError
from tests.helpers.data import random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import described_arm

MJCF = """
<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="a" axis="0 1 0"/><inertial mass="1" pos="0.1 0 -0.2" diaginertia="1 1 1"/>
<body pos="0 0 -0.4"><joint name="b" axis="0 1 0"/>
<inertial mass="1" pos="0 0.1 -0.2" diaginertia="1 1 1"/>
<body pos="0 0 -0.4"><joint name="c" axis="0 1 0"/>
<inertial mass="1" pos="0 0 -0.2" diaginertia="1 1 1"/></body></body></body></worldbody>
<tendon>{}</tendon><equality>{}</equality><actuator>{}</actuator></mujoco>
"""
SUM = (
    '<fixed name="sum"{}><joint joint="b" coef="1"/><joint joint="c" coef="1"/></fixed>'
    '<fixed name="difference"{}><joint joint="b" coef="1"/><joint joint="c" coef="-1"/></fixed>'
)
MOTORS = '<motor name="left" tendon="sum" gear="2"/><motor name="right" tendon="difference"/>'
LEVEL = '<tendon tendon1="difference" polycoef="0.3 0 0 0 0"/>'


def test_motors_of_tendons_are_taken_where_that_is_asked_for():
    text = MJCF.format(SUM.format(' stiffness="8" springlength="0.4"', ""), "", MOTORS)
    plain = sdpid.load_robot(text)
    assert plain.joint_names == ("a", "b", "c")
    assert "spring of tendon 1" in plain.forces[0]
    robot = sdpid.load_robot(text, transmission="description")
    assert robot.joint_names == ("a", "left", "right")
    np.testing.assert_allclose(robot.expansion, [[1, 0, 0], [0, 0.25, 0.5], [0, 0.25, -0.5]])
    # Half of the motor's angle is the tendon's length.
    assert not robot.forces
    assert robot.springs == (sdpid.friction.Spring("left", 2.0, 0.8),)


def test_kept_tendons_hold_joints_to_others():
    robot = sdpid.load_robot(MJCF.format(SUM.format("", ""), LEVEL, ""))
    assert robot.joint_names == ("a", "b")
    np.testing.assert_allclose(robot.expansion, [[1, 0], [0, 1], [0, 1]])
    np.testing.assert_allclose(robot.offset, [0, 0, -0.3])
    given = {"joints": {"b": {"m": 2.0}, "c": {"m": 2.0, "offset": -0.3}}}
    text = MJCF.format(SUM.format("", ""), LEVEL, "")
    assert sdpid.load_robot(text, transmission=given).joint_names == ("a", "m")


ROS = """<transmission name="one"><type>transmission_interface/SimpleTransmission</type>
<joint name="joint_1"><offset>0.1</offset></joint>
<actuator name="m1"><mechanicalReduction>-50</mechanicalReduction></actuator></transmission>
<transmission name="two"><plugin>transmission_interface/{}</plugin>
<joint name="joint_3" role="joint2"><mechanical_reduction>2</mechanical_reduction></joint>
<joint name="joint_2" role="joint1"><mechanical_reduction>4</mechanical_reduction></joint>
<actuator name="m2" role="actuator1"><mechanical_reduction>10</mechanical_reduction></actuator>
<actuator name="m3" role="actuator2"><mechanical_reduction>20</mechanical_reduction></actuator>
</transmission></robot>"""


def arm() -> str:
    text = described_arm(random_links(np.random.default_rng(1), 3)).urdf
    assert text is not None
    return text


@pytest.mark.parametrize(
    ("kind", "rows"),
    [
        ("DifferentialTransmission", [[1 / 80, 1 / 160], [1 / 40, -1 / 80]]),
        ("FourBarLinkageTransmission", [[1 / 40, 0.0], [-1 / 80, 1 / 40]]),
    ],
)
def test_elements_are_read_as_ros_reads_them(kind: str, rows: list[list[float]]):
    text = arm().replace("</robot>", ROS.format(kind))
    assert sdpid.load_robot(text).joint_names == ("joint_1", "joint_2", "joint_3")
    robot = sdpid.load_robot(text, transmission="description")
    assert robot.joint_names == ("m1", "m2", "m3")
    expected = np.zeros((3, 3))
    expected[0, 0], expected[1:, 1:] = -1 / 50, rows
    np.testing.assert_allclose(robot.expansion, expected)
    np.testing.assert_allclose(robot.offset, [0.1, 0.0, 0.0])


def again(motor: str) -> str:
    """Return an arm whose first joint stands in a further transmission."""
    first = ROS.format("FourBarLinkageTransmission")
    further = first.partition('<transmission name="two">')[0].replace("one", "more")
    return arm().replace("</robot>", further.replace("m1", motor) + first)


def test_a_joint_may_stand_in_two_elements_that_say_the_same():
    robot = sdpid.load_robot(again("m1"), transmission="description")
    assert robot.joint_names == ("m1", "m2", "m3")


def test_a_file_beside_the_description_is_taken(tmp_path: Path):
    (tmp_path / "arm.urdf").write_text(arm())
    (tmp_path / "arm.transmission.toml").write_text("[joints.joint_2]\nmotor = 0.5\n")
    robot = sdpid.load_robot(tmp_path / "arm.urdf")
    assert robot.joint_names == ("joint_1", "motor", "joint_3")
    other = {"joints": {"joint_2": {"axis": 2.0}}}
    assert sdpid.load_robot(tmp_path / "arm.urdf", transmission=other).joint_names[1] == "axis"


def loaded(text: str, transmission: object = "description") -> object:
    return lambda: sdpid.load_robot(text, transmission=transmission)


ALIKE = '<motor tendon="sum"/><motor name="more" tendon="sum"/>'
REFUSED = [
    (loaded(arm()), "has no <transmission>"),
    (loaded(arm().replace("</robot>", ROS.format("Gear"))), "'two' is of the kind .*Gear"),
    (
        loaded(arm().replace("</robot>", ROS.replace("-50", "0").format("SimpleTransmission"))),
        "reduction or offset of actuator 'm1'",
    ),
    (loaded(again("m4")), "'more' and 'one' move joint 'joint_1', each in its own way"),
    (loaded(MJCF.format(SUM.format("", ""), "", "")), "no motor pulls at a fixed tendon"),
    (loaded(MJCF.format(SUM.format("", ""), "", ALIKE)), "move its joints alike"),
    (
        loaded(MJCF.format(SUM.format("", ""), LEVEL, ""), {"joints": {"c": {"m": 1.0}}}),
        "c follow joints that no row names",
    ),
    (
        loaded(
            MJCF.format(SUM.format("", ""), LEVEL, ""),
            {"joints": {"b": {"m": 1.0}, "c": {"m": 1.0}}},
        ),
        "keeps a tendon over b, c at a length",
    ),
    (
        lambda: sdpid.load_robot(
            sdpid.load_robot("denso_vp6242").pin_model, transmission="description"
        ),
        "is no URDF and no MJCF",
    ),
]


@pytest.mark.parametrize(("call", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_what_is_refused(call: object, words: str):
    refuses(ModelError, words, call)  # type: ignore[arg-type]
