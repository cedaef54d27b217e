"""Limits: the tighter of what is given and described, and what is told before any search."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid.errors import DataError, ModelError
from sdpid.excitation.limits.joint_limits import rest_to_rest
from sdpid.excitation.limits.limits import Limits
from tests.helpers.robots import TREE, TREE_MIMIC, planar_arm

ARM = """<robot name="arm"><link name="base"/>{links}{joints}</robot>"""
LINK = """<link name="l{0}"><inertial><origin xyz="0.3 0 0"/><mass value="4"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{before}"/><child link="l{i}"/>
  <origin xyz="0.1 0 0"/><axis xyz="0 1 0"/>{limit}</joint>"""
LIMIT = '<limit lower="-2" upper="1" velocity="3" effort="100"/>'


def arm(*kinds: str, limit: str = LIMIT) -> sdpid.RobotModel:
    """Return an arm of joints a, b, … with the same limits."""
    names = "abcdef"[: len(kinds)]
    links = "".join(LINK.format(i) for i in range(len(kinds)))
    joints = "".join(
        JOINT.format(name=name, kind=kind, before=f"l{i - 1}" if i else "base", i=i, limit=limit)
        for i, (name, kind) in enumerate(zip(names, kinds, strict=True))
    )
    return sdpid.load_robot(ARM.format(links=links, joints=joints))


TWO = ("revolute", "revolute")


def test_description_holds_where_nothing_is_given() -> None:
    found = Limits().of(arm(*TWO))
    assert found.lower.tolist() == [-2.0, -2.0]
    assert found.upper.tolist() == [1.0, 1.0]
    assert found.velocity.tolist() == [3.0, 3.0]
    assert found.torque.tolist() == [100.0, 100.0]
    assert found.acceleration.tolist() == [5.0, 5.0]
    assert found.jerk.tolist() == [50.0, 50.0]
    assert found.sources["velocity"] == ("description", "description")
    assert found.sources["jerk"] == ("assumed", "assumed")
    assert len(found.assumed) == 2
    assert all("all joints have no" in sentence for sentence in found.assumed)
    assert not found.lower.flags.writeable


def test_described_limits_that_limit_nothing_are_told() -> None:
    wide = 'lower="-10" upper="10" velocity="1000" effort="1e5"'
    found = Limits().of(arm(*TWO, limit=f"<limit {wide}/>"))
    told = [text for text in found.assumed if "limit nothing" in text]
    assert [text.split(" in the")[0] for text in told] == [
        "all joints have ranges of positions",
        "all joints have velocity limits",
        "all joints have torque limits",
    ]
    assert "(more than 62.8 rad/s); give the real ones." in told[1]
    real = Limits(lower=-1.0, upper=1.0, velocity={"a": 2.0}, torque=50.0)
    one = real.of(arm(*TWO, limit=f"<limit {wide}/>")).assumed
    assert [text for text in one if "limit nothing" in text] == [
        "b has velocity limits in the description that limit nothing (more than 62.8 rad/s); give "
        "the real ones."
    ]


def test_share_of_the_description_is_told() -> None:
    found = Limits().of(arm(*TWO), share=0.9)
    np.testing.assert_allclose(found.lower, -0.5 - 0.9 * 1.5)
    np.testing.assert_allclose(found.velocity, 2.7)
    np.testing.assert_allclose(found.torque, 90.0)
    assert any("90 %" in sentence for sentence in found.assumed)
    np.testing.assert_allclose(Limits(share=0.5).of(arm(*TWO), share=0.9).velocity, 1.5)
    # What is given is taken at its word.
    assert Limits(velocity=2.9).of(arm(*TWO), share=0.9).velocity.tolist() == [2.9, 2.9]


SIZES = st.one_of(st.none(), st.floats(0.1, 300.0))


@given(st.lists(SIZES, min_size=3, max_size=3), st.floats(-3.0, -0.5), st.floats(0.1, 1.0))
def test_the_tighter_holds(sizes: list[float | None], lower: float, share: float) -> None:
    robot = arm("revolute", "prismatic", "revolute", limit=LIMIT.replace("100", "1000"))
    loose = Limits().of(robot, share=share)
    tight = Limits(velocity=[None if s is None else s / 100 for s in sizes], torque=sizes)
    found = tight.of(robot, share=share, assume=False)
    described = Limits().of(robot)
    assert np.all(found.velocity <= described.velocity)
    assert np.all(found.torque <= described.torque)
    for j, size in enumerate(sizes):
        if size is None:
            assert found.torque[j] == loose.torque[j]
        else:
            assert found.torque[j] == min(size, 1000.0)
    narrowed = Limits(lower=lower).of(robot, share=share, assume=False)
    np.testing.assert_array_equal(narrowed.lower, max(lower, -2.0))
    assert np.all(narrowed.lower <= narrowed.rest)
    assert np.all(narrowed.rest <= narrowed.upper)


def test_wider_limits_are_told_and_may_override() -> None:
    wide = {"upper": {"a": 2.0}, "velocity": 4.0}
    found = Limits(**wide).of(arm(*TWO))  # type: ignore[arg-type]
    assert found.upper.tolist() == [1.0, 1.0]
    assert found.velocity.tolist() == [3.0, 3.0]
    assert found.sources["upper"] == ("description", "description")
    assert any(text.startswith("a has upper limits beyond") for text in found.assumed)
    over = Limits(override=True, **wide).of(arm(*TWO))  # type: ignore[arg-type]
    assert over.upper.tolist() == [2.0, 1.0]
    assert over.velocity.tolist() == [4.0, 4.0]
    assert any("override" in text for text in over.assumed)


def test_infinity_is_no_limit() -> None:
    found = Limits(jerk=math.inf, acceleration={"a": math.inf, "*": 2.0}).of(arm(*TWO))
    assert found.acceleration.tolist() == [math.inf, 2.0]
    assert found.jerk.tolist() == [math.inf, math.inf]
    assert found.sources["jerk"] == ("given", "given")


def test_joints_without_limits() -> None:
    robot = arm("continuous", "prismatic", limit='<limit velocity="0" effort="0"/>')
    found = Limits().of(robot, rest=[0.5, 0.2])
    np.testing.assert_allclose(found.lower, [0.5 - np.pi, 0.1])
    np.testing.assert_allclose(found.upper, [0.5 + np.pi, 0.3])
    assert found.velocity.tolist() == [2.0, 0.25]
    assert np.isinf(found.torque).all()
    told = " ".join(found.assumed)
    for words in (
        "a has no position limits; half a turn",
        "b has no velocity",
        "no torque limits; they are not",
    ):
        assert words in told


def test_rest_is_in_the_middle_where_zero_is_near_an_end() -> None:
    robot = arm(*TWO, limit=LIMIT.replace('lower="-2"', 'lower="-0.05"'))
    np.testing.assert_allclose(Limits().of(robot).rest, 0.475)
    np.testing.assert_array_equal(Limits().of(arm(*TWO)).rest, 0.0)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"lower": 0.5, "upper": 0.2}, ("'a'", "lower 0.5", "upper 0.2")),
        ({"lower": 1.5}, ("'a'", "lower 1.5 (given)", "upper 1 (description)")),
        ({"velocity": -1.0}, ("velocity", "-1.0", "above 0")),
        ({"velocity": {"b": math.nan}}, ("velocity", "'b'", "nan")),
        ({"velocity": "fast"}, ("velocity", "'fast'")),
        ({"velocity": {"c": 1.0}}, ("no joint 'c'", "a, b")),
        ({"torque": [1.0, 2.0, 3.0]}, ("torque", "3 values", "2 joints")),
        ({"lower": -90.0}, ("degrees", "-1.571 rad")),
        ({"velocity": 180.0}, ("degrees", "3.142 rad/s")),
        ({"torque": {"a": 1.0}, "upper": 0.5, "lower": -0.5}, ("'a'", "gravity alone", "1 N·m")),
        ({"tool_speed": 0.0}, ("tool_speed", "above 0")),
        ({"clearance": -0.1}, ("clearance", "from 0")),
        ({"share": 1.1}, ("share", "at most 1")),
        ({"override": "yes"}, ("override",)),
    ],
)
def test_wrong_limits_are_told(limits: dict[str, Any], words: tuple[str, ...]) -> None:
    with pytest.raises(DataError) as caught:
        Limits(**limits).of(arm(*TWO))
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_wrong_rest_is_told() -> None:
    with pytest.raises(DataError, match=r"'b': the rest position 1\.5 rad is above the limit of 1"):
        Limits().of(arm(*TWO), rest=[0.0, 1.5])
    with pytest.raises(DataError, match=r"'a': gravity alone needs 27\.\d* N·m at the rest"):
        Limits(torque=20.0).of(arm(*TWO), rest=[0.0, 0.0])
    with pytest.raises(DataError, match="rest position: 1 values"):
        Limits().of(arm(*TWO), rest=[0.0])


def test_wrong_descriptions_are_told() -> None:
    with pytest.raises(DataError, match="from 1 to -2"):
        Limits().of(arm(*TWO, limit='<limit lower="1" upper="-2" velocity="3" effort="100"/>'))
    with pytest.raises(ModelError, match="floating base"):
        Limits().of(sdpid.load_robot(arm(*TWO).urdf, root="free_flyer"))


def test_millimeters_are_told() -> None:
    with pytest.raises(DataError, match=r"looks like mm; give 0\.3 m"):
        Limits(upper={"slide": 300.0}).of(sdpid.load_robot(TREE))


FILE = """
[arm]
tool_speed = 0.25
clearance = 0.03
velocity = 1.5
jerk = inf

[a]
lower = -1.0
velocity = 1.0

[[joint]]
name = "b"
torque = 60

[[box]]
size = [1, 1, 1]
"""


def test_file(tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(FILE)
    found = Limits.from_toml(path).of(arm(*TWO))
    assert found.lower.tolist() == [-1.0, -2.0]
    assert found.velocity.tolist() == [1.0, 1.5]
    assert found.torque.tolist() == [100.0, 60.0]
    assert np.isinf(found.jerk).all()
    assert (found.tool_speed, found.clearance) == (0.25, 0.03)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[a]\nspeed = 1.0", ("'speed'", "velocity")),
        ("[arm]\nspeed = 1.0", ("[arm]", "'speed'", "tool_speed")),
        ("velocity = 1.0", ("outside of a table", "[arm]")),
        ("[[joint]]\nlower = 0.0", ("without a name",)),
        ("[a]\nlower = 0.0\n[[joint]]\nname = 'a'\nlower = 1.0", ("lower twice",)),
        ("[a]\nlower = 'low'", ("'low'", "give a number")),
        ("[a", ("not a TOML file",)),
    ],
)
def test_wrong_files_are_told(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(text)
    with pytest.raises(DataError) as caught:
        Limits.from_toml(path)
    assert all(word in str(caught.value) for word in ("limits.toml", *words)), str(caught.value)


@pytest.mark.parametrize(
    ("distance", "velocity", "acceleration", "jerk", "seconds"),
    [
        (2.0, 1.0, math.inf, math.inf, 2.0),
        (1.0, math.inf, 4.0, math.inf, 1.0),
        (3.0, 1.0, 2.0, math.inf, 3.5),
        # Four ramps of one second each: half of the way is jerk·1³.
        (2.0, math.inf, math.inf, 1.0, 4.0),
        # The speed is reached by two ramps, then a cruise of one second.
        (3.0, 1.0, math.inf, 1.0, 5.0),
        # All three: ramps of 1 s, 2 s of full acceleration, then a cruise of 2 s.
        (18.0, 3.0, 1.0, 1.0, 10.0),
    ],
)
def test_rest_to_rest(
    distance: float, velocity: float, acceleration: float, jerk: float, seconds: float
) -> None:
    found = rest_to_rest(distance, velocity, acceleration, jerk)
    np.testing.assert_allclose(found, seconds)


POSITIVE = st.floats(0.1, 10.0)


@given(POSITIVE, POSITIVE, POSITIVE, POSITIVE, st.floats(1.0, 3.0))
def test_wider_limits_take_no_longer(d: float, v: float, a: float, j: float, more: float) -> None:
    least = rest_to_rest(d, v, a, j)
    for wider in ((d, more * v, a, j), (d, v, more * a, j), (d, v, a, more * j)):
        assert rest_to_rest(*wider) <= least * (1.0 + 1e-12)
    # Slower by c: time stretches by c.
    slower = rest_to_rest(d, v / more, a / more**2, j / more**3)
    np.testing.assert_allclose(slower, more * least, rtol=1e-9)
    # Limits that do not bind are none.
    near = rest_to_rest(d, v, a, 1e12)
    np.testing.assert_allclose(near, rest_to_rest(d, v, a, math.inf), rtol=1e-3)


def test_shortest_duration() -> None:
    found = Limits(acceleration=1.0, jerk=math.inf).of(arm(*TWO))
    np.testing.assert_allclose(found.shortest_duration(), 4.0 * np.sqrt(0.3))
    assert found.table().header[0] == "joint"


def test_planar_arm_without_any_limit() -> None:
    found = Limits().of(planar_arm())
    assert np.isfinite(found.lower).all()
    assert np.isfinite(found.jerk).all()


def test_infinity_survives_plain_values() -> None:
    given = Limits(jerk=math.inf, velocity=[1.0, None], torque={"a": 60.0, "*": math.inf})
    again = Limits(**json.loads(json.dumps(given.to_dict())))
    assert again.to_dict() == given.to_dict()
    assert np.isinf(again.of(arm(*TWO)).jerk).all()


def test_rest_is_where_the_motors_hold_the_arm() -> None:
    # Stretched out, the first joint carries 4 kg at 0.3 m and 4 kg at 0.4 m: 27 N·m.
    weak = LIMIT.replace("100", "30").replace('lower="-2"', 'lower="-2.5"').replace('"1"', '"2.5"')
    found = Limits().of(arm(*TWO, limit=weak))
    assert np.any(found.rest != 0.0)
    still = np.zeros((1, 2))
    assert np.all(np.abs(arm(*TWO).described_efforts(found.rest[None], still, still)) <= 21.0)
    assert any("motors hold easily" in sentence for sentence in found.assumed)
    # A position that is asked for is kept.
    assert Limits().of(arm(*TWO, limit=weak), rest=[0.0, 0.0]).rest.tolist() == [0.0, 0.0]
    with pytest.raises(DataError, match=r"at the best of .* larger limit with override"):
        Limits().of(arm(*TWO, limit=LIMIT.replace("100", "1").replace("-2", "-0.5")))


def test_limits_of_followers_hold_too() -> None:
    # The thumb is at -0.7·finger + 0.2 and within ±0.3: the finger within -0.14 and 0.71.
    text = TREE_MIMIC.replace(
        'lower="-1" upper="1" effort="5" velocity="3"/><mimic',
        'lower="-0.3" upper="0.3" effort="5" velocity="3"/><mimic',
    )
    found = Limits().of(sdpid.load_robot(text))
    j = found.joint_names.index("finger")
    np.testing.assert_allclose([found.lower[j], found.upper[j]], [-0.1 / 0.7, 0.5 / 0.7])
