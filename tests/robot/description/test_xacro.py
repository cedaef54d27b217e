"""Robots from xacro files, and from names of robot_descriptions."""

import importlib.metadata
import sys
from pathlib import Path
from types import ModuleType

import pytest

from sdpid.assurance.descriptions.audit import audit_urdf
from sdpid.errors import ModelError
from sdpid.output.robots.repair import repair_urdf
from sdpid.robot.description.catalog import example_robots
from sdpid.robot.model.load import load_robot
from tests.helpers.descriptions import chain
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE

pytest.importorskip("xacrodoc")

MACRO = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:macro name="link" params="name"><link name="${name}"/></xacro:macro></robot>"""
ARM = """<robot name="made" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="tool" default="hand"/>
<xacro:include filename="macro.xacro"/>
<xacro:include filename="$(find our_robot)/urdf/macro.xacro"/>
<xacro:link name="base"/><xacro:link name="$(arg tool)"/>
<joint name="j" type="revolute"><origin xyz="0 0 ${2*pi}"/><parent link="base"/>
<child link="$(arg tool)"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """The folder of a ROS package with a xacro file that includes another in two ways."""
    folder = tmp_path / "ours" / "urdf"
    folder.mkdir(parents=True)
    (tmp_path / "ours" / "package.xml").write_text("<package><name>our_robot</name></package>")
    (folder / "macro.xacro").write_text(MACRO)
    (folder / "arm.urdf.xacro").write_text(ARM)
    return folder


def test_a_xacro_file_is_expanded(package: Path) -> None:
    robot = load_robot(package / "arm.urdf.xacro")
    assert (robot.name, robot.joint_names, robot.link_names) == ("made", ("j",), ("hand",))
    other = load_robot(package / "arm.urdf.xacro", xacro_args={"tool": "drill"})
    assert other.link_names == ("drill",)
    assert "xacro:" not in str(other.urdf)


def test_text_is_expanded_without_a_file() -> None:
    text = ARM.replace('<xacro:include filename="macro.xacro"/>', MACRO.partition("\n")[2][:-8])
    text = text.replace('<xacro:include filename="$(find our_robot)/urdf/macro.xacro"/>', "")
    assert load_robot(text).link_names == ("hand",)


def test_what_cannot_be_expanded_is_refused(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (package / "bad.xacro").write_text(ARM.replace("${2*pi}", "${nonsense}"))
    with pytest.raises(ModelError, match=r"bad\.xacro: xacro cannot expand it \(.*nonsense"):
        load_robot(package / "bad.xacro")
    monkeypatch.setattr("sdpid.robot.description.xml.TIMEOUT", 2.0)
    (package / "loop.xacro").write_text(ARM.replace("${2*pi}", "${[0 for i in range(10**12)]}"))
    refuses(ModelError, r"loop\.xacro", load_robot, package / "loop.xacro")
    refuses(ModelError, "no xacro file", load_robot, TREE, xacro_args={"tool": "drill"})


BODIES = """<robot name="a" xmlns:xacro="http://ros.org/wiki/xacro">
<xacro:arg name="m" default="3"/><xacro:macro name="body" params="mass moment">
<inertial><mass value="${mass}"/>
<inertia ixx="1" iyy="1" izz="${moment}" ixy="0" ixz="0" iyz="0"/></inertial></xacro:macro>"""


def test_what_macros_make_is_audited_and_repaired(tmp_path: Path) -> None:
    path, out, arguments = tmp_path / "arm.xacro", tmp_path / "arm.urdf", {"m": "-3"}
    links = ('<xacro:body mass="$(arg m)" moment="1"/>', '<xacro:body mass="2" moment="3"/>')
    path.write_text(BODIES + chain(*links).partition('name="chain">')[2])
    found = {each.link: each.kind for each in audit_urdf(path, xacro_args=arguments).errors}
    assert found == {"link1": "negative_mass", "link2": "triangle"}
    report = repair_urdf(path, target=out, xacro_args=arguments)
    assert report.left == ("link1",)
    assert "1 bodies repaired in the URDF that the xacro file stands for" in report.describe()
    assert "xacro" not in out.read_text()
    assert [each.link for each in audit_urdf(out).errors] == ["link1"]


def test_names_of_robot_descriptions(
    tmp_path: Path, package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tree.urdf").write_text(TREE)
    catalog, plain, macro = (ModuleType(f"robot_descriptions{end}") for end in ("", ".a", ".b"))
    names = ("plain_description", "macro_description", "gone_description")
    catalog.DESCRIPTIONS = dict.fromkeys(names)
    catalog.__path__ = []
    plain.URDF_PATH = str(tmp_path / "tree.urdf")
    macro.XACRO_PATH = str(package / "arm.urdf.xacro")
    monkeypatch.setitem(sys.modules, "robot_descriptions", catalog)
    monkeypatch.setitem(sys.modules, "robot_descriptions.plain_description", plain)
    monkeypatch.setitem(sys.modules, "robot_descriptions.macro_description", macro)
    assert load_robot("plain_description").name == "tree"
    assert load_robot("macro_description").link_names == ("hand",)
    refuses(ModelError, r"'gone_description' cannot be fetched", load_robot, "gone_description")
    refuses(ModelError, r"near it are .*plain_description", load_robot, "plain_descriptoin")


def test_without_robot_descriptions_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    with pytest.raises(ModelError, match=r"pip install .*\[descriptions\]'"):
        load_robot("no_such_description")


def test_robots_that_conda_installed_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_record(name: str) -> None:
        raise importlib.metadata.PackageNotFoundError(name)

    robots = tmp_path / "robots/share/example-robot-data/robots"
    written = robots / "two_description/robots/two_arms.urdf"
    written.parent.mkdir(parents=True)
    written.write_text("<robot/>")
    monkeypatch.setattr(importlib.metadata, "files", no_record)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "robots"))
    assert example_robots.__wrapped__() == {"two_description/two_arms": written}
