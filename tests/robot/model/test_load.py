"""Where robots come from, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from sdpid.errors import ModelError
from sdpid.output.robots.urdf_tree import UrdfTree
from sdpid.robot.description.catalog import (
    bundled_folder,
    bundled_robots,
    example_robots,
    find_robot,
)
from sdpid.robot.description.urdf import check_urdf, inertial_element
from sdpid.robot.description.xml import encode_xml, is_mjcf, parse_xml, read_description
from sdpid.robot.inertia import theta_from_physical
from sdpid.robot.model.load import load_robot
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC

JOINT = """<joint name="j" type="{kind}"><parent link="a"/><child link="b"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>{inside}</joint>"""


def urdf(joint: str = JOINT.format(kind="revolute", inside=""), *, before: str = "") -> str:
    return f'{before}<robot name="r"><link name="a"/><link name="b"/>{joint}</robot>'


def test_bundled_robots() -> None:
    assert "denso_vp6242" in bundled_robots()
    robot = load_robot("denso_vp6242")
    assert robot.name == "denso_vp6242"
    assert (robot.n, robot.n_links) == (6, 6)
    np.testing.assert_array_equal(robot.gravity, [0.0, 0.0, -9.81])
    assert not robot.prior.any()
    refuses(ModelError, "denso_vp6242", bundled_folder, "denso")


def test_text_path_and_string_path_are_the_same_robot(tmp_path: Path) -> None:
    path = tmp_path / "tree.urdf"
    path.write_text(TREE, encoding="utf-8")
    for source in (TREE, "\n " + TREE, path, str(path)):
        robot = load_robot(source)
        assert robot.joint_names == load_robot(TREE).joint_names
    declared = '<?xml version="1.0" encoding="UTF-8"?>\n' + TREE
    assert load_robot(declared).name == "tree"


def test_example_robots_by_stem_and_by_folder() -> None:
    assert load_robot("ur5_robot").n == 6
    assert load_robot("panda_description/panda").name == load_robot("panda").name
    refuses(ModelError, "no robot 'no_such_robot'", find_robot, "no_such_robot")


def test_an_ambiguous_stem_names_the_folders() -> None:
    with pytest.raises(ModelError, match=r"anymal_b_simple_description/anymal, anymal_c") as info:
        load_robot("anymal")
    assert "ambiguous" in str(info.value)
    assert load_robot("anymal_b_simple_description/anymal").n == 12


@pytest.mark.parametrize("name", sorted(example_robots()))
def test_every_example_robot_loads_or_says_why(name: str) -> None:
    try:
        robot = load_robot(name)
    except ModelError as error:
        # Some stand on a base that floats and have no joint of their own; one has a hand whose
        # joints mimic one that is not there.
        assert "no moving joint" in str(error)  # noqa: PT017
        return
    assert robot.n >= 1
    assert robot.prior.shape == (robot.n_links, 10)
    assert len(set(robot.joint_names)) == robot.n


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("ur5", "ur5_robot"),
        ("Panda_hand", "panda"),
        ("denso", "denso_vp6242"),
        ("ur5_robt", "ur5_robot"),
        ("ur_5", "ur5_robot"),
        ("ur5.urdf", "ur5_robot"),
        ("UR5.urdf.xacro", "ur5_robot"),
    ],
)
def test_an_unknown_name_is_answered_with_near_ones(name: str, near: str) -> None:
    with pytest.raises(ModelError, match=rf"no robot '{name}'.*near it are .*{near}") as info:
        load_robot(name)
    # Of 70 names, those that help.
    assert len(str(info.value)) < 200


def test_a_name_like_no_other_shows_some_that_there_are() -> None:
    for name in ("xqz", "franka"):
        words = rf"no robot '{name}': .* are known, such as denso_vp.*; .*robot_names\(\) lists"
        refuses(ModelError, words, load_robot, name)


NEGATIVE = urdf().replace(
    '<link name="b"/>',
    '<link name="b"><inertial><mass value="-1.5"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" '
    'iyz="0" izz="1"/></inertial></link>',
)


def test_negative_masses_are_refused() -> None:
    refuses(ModelError, r"link 'b': the mass is -1\.5 kg, the least is 0", load_robot, NEGATIVE)
    model = load_robot(TREE).pin_model.copy()
    model.inertias[1] = pin.Inertia(-1.0, np.zeros(3), np.eye(3))
    refuses(ModelError, r"the mass is -1 kg, the least is 0", load_robot, model)


def test_a_robot_shows_itself_in_a_line() -> None:
    assert repr(load_robot(TREE)) == "RobotModel('tree', 6 coordinates, 6 links)"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16", "utf-16-be"])
def test_descriptions_are_read_in_the_encoding_that_they_declare(
    tmp_path: Path, encoding: str
) -> None:
    declared = {"latin-1": "ISO-8859-1", "utf-16-be": "UTF-16"}.get(encoding, encoding[:6])
    text = f'<?xml version="1.0" encoding="{declared}"?>\n' + urdf().replace('"b"', '"größe"')
    path = tmp_path / "robot.urdf"
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    path.write_bytes((mark + text).encode(encoding))
    assert load_robot(path).link_names == ("größe",)
    assert load_robot(text).link_names == ("größe",)
    if encoding != "utf-16-be":
        assert encode_xml(read_description(path).text) == path.read_bytes()


@pytest.mark.parametrize("declared", ["no-such-code", "hex"])
def test_unknown_encodings_are_refused(tmp_path: Path, declared: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(f'<?xml version="1.0" encoding="{declared}"?>' + urdf())
    refuses(ModelError, f"encoding '{declared}' is not known", load_robot, path)
    path.write_bytes(urdf().replace('"b"', '"größe"').encode("latin-1"))
    refuses(ModelError, "declare its encoding in the first line", load_robot, path)


def test_long_chains_of_fixed_links_are_read_and_endless_ones_refused() -> None:
    def chain(count: int) -> str:
        links = "".join(f'<link name="l{i}"/>' for i in range(count))
        fixed = "".join(
            f'<joint name="f{i}" type="fixed"><origin xyz="1 0 0"/><parent link="l{i}"/>'
            f'<child link="l{i + 1}"/></joint>'
            for i in range(count - 1)
        )
        joint = JOINT.format(kind="revolute", inside="").replace('"b"', '"l0"')
        return f'<robot name="r"><link name="a"/>{links}{joint}{fixed}</robot>'

    # Deeper than Python's own recursion goes.
    assert load_robot(chain(1500)).n == 1
    assert UrdfTree(chain(1500)).fixed_children("l0")[-1].placement[0, 3] == 1499
    refuses(ModelError, "30001 links, at most 2000", load_robot, chain(30_000))


def test_a_comment_makes_no_mjcf() -> None:
    assert not is_mjcf("<!-- <mujoco> --><robot/>", "it")
    assert is_mjcf("<?xml version='1.0'?><!-- <robot> --><mujoco model='x'/>", "it")
    assert not is_mjcf("<!-- a > b --><!-- <mujoco --><robot/>", "it")


def spherical() -> Any:
    model = pin.Model()
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    return model


BAD: list[tuple[Any, str]] = [
    (urdf(JOINT.format(kind="fixed", inside="")), "no moving joint"),
    (urdf(""), "no moving joint"),
    (urdf(JOINT.format(kind="planar", inside="")), "'j' is of kind 'planar'"),
    (urdf(JOINT.format(kind="floating", inside="")), "floating base: root='free_flyer'"),
    (urdf('<joint name="j"><parent link="a"/><child link="b"/></joint>'), "kind '?'"),
    ("<robot", "not well-formed"),
    ("<robot></robots>", "not well-formed"),
    ("<sdf/>", "root element is <sdf>"),
    (urdf(JOINT.format(kind="revolute", inside='<mimic joint="j"/>')), "circle at 'j'"),
    (urdf(JOINT.format(kind="revolute", inside='<mimic joint="x"/>')), "mimics 'x'"),
    (urdf(JOINT.format(kind="revolute", inside='<mimic joint="x" offset="a"/>')), "not a number"),
    (urdf(JOINT.format(kind="revolute", inside='<mimic joint="x" offset="nan"/>')), "not a n"),
    (urdf(JOINT.format(kind="revolute", inside='<mimic joint="x" offset="1e300"/>')), "at most"),
    (urdf(JOINT.format(kind="revolute", inside="").replace('"b"', '"c"')), "cannot read it"),
    (TREE_MIMIC.replace('joint="finger"', 'joint="weld"'), "mimics 'weld'"),
    ("", "no robot ''"),
    ("x" * 5000, "no robot 'xxx"),
    ("a\0b", "no robot"),
    (Path("/nowhere/robot.urdf"), "cannot read /nowhere"),
    (Path(__file__).parent, "cannot read"),
    (3, "got int"),
    (None, "got NoneType"),
    (pin.Model(), "no moving joint"),
    (spherical(), "'ball' is a JointModelSpherical, which is not supported"),
]


@pytest.mark.parametrize(("source", "says"), BAD)
def test_bad_sources_are_model_errors(source: Any, says: str) -> None:
    with pytest.raises(ModelError) as info:
        load_robot(source)
    assert says in str(info.value)


def test_bad_options_are_model_errors() -> None:
    with pytest.raises(ModelError, match="root is 'fixed'"):
        load_robot(TREE, root="fixed")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="already has its root"):
        load_robot(load_robot(TREE).pin_model, root="free_flyer")
    refuses(ModelError, "gravity", load_robot, TREE, gravity=(0.0, 0.0))
    refuses(ModelError, "offset", load_robot, TREE_MIMIC, root="free_flyer")


def test_a_floating_base_needs_no_other_joint() -> None:
    ball = urdf(JOINT.format(kind="fixed", inside=""))
    assert load_robot(ball, root="free_flyer").n == 6


def test_binary_is_not_a_urdf(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_bytes(b"\xff\xfe\x00binary")
    refuses(ModelError, "cannot read", load_robot, path)


LAUGHS = "".join(
    f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' if i else '<!ENTITY l0 "ha">' for i in range(12)
)


@pytest.mark.parametrize(
    "doctype",
    [
        f"<!DOCTYPE robot [{LAUGHS}]>",
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/hostname">]>',
        '<!DOCTYPE robot SYSTEM "http://example.invalid/robot.dtd">',
        "<!DOCTYPE robot>",
    ],
    ids=["billion laughs", "external entity", "external dtd", "plain"],
)
def test_document_types_are_refused_and_never_expanded(doctype: str) -> None:
    entity = "&l11;" if "l11" in doctype else "&x;" if "ENTITY x" in doctype else ""
    text = urdf(f"<note>{entity}</note>" + JOINT.format(kind="revolute", inside=""), before=doctype)
    # Expanded it would be terabytes.
    refuses(ModelError, r"document type|well-formed", load_robot, text)


def test_xml_of_any_size_is_not_swallowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sdpid.robot.description.xml.MAX_BYTES", 100)
    refuses(ModelError, "bytes of XML, more than the 100 allowed", parse_xml, TREE, "it")


def test_joints_of_transmissions_do_not_count() -> None:
    text = urdf(
        '<transmission name="t"><joint name="k"/></transmission>'
        + JOINT.format(kind="prismatic", inside="")
    )
    assert check_urdf(text, "it") == ("r", ())
    assert load_robot(text).n == 1


def test_inertial_element() -> None:
    body = theta_from_physical(2.0, [0.1, -0.2, 0.3], np.diag([0.1, 0.2, 0.25]))
    element = inertial_element(body)
    assert float(element.find("mass").get("value")) == 2.0
    inertia = element.find("inertia")
    assert float(inertia.get("iyy")) == pytest.approx(0.2, abs=1e-15)
    refuses(ModelError, r"mass is -2\.0 kg", inertial_element, -body)
