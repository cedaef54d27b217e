"""Robots: loading, regressors, base parameters, coordinates and geometry."""

import csv
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.robot.description.bodies import read_urdf_bodies
from sdpid.robot.description.catalog import (
    bundled_folder,
    bundled_robots,
    example_robots,
    find_robot,
)
from sdpid.robot.description.dh_table import DhJoint, DhTable
from sdpid.robot.description.urdf import check_urdf
from sdpid.robot.description.xml import encode_xml, is_mjcf, parse_xml, read_description
from sdpid.robot.friction.terms import Coupling
from sdpid.robot.model.base_parameters import BaseParameters, generic_states, structural_base
from sdpid.robot.model.coordinates import sliding
from sdpid.robot.model.geometry import collision_points, link_placements
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import friction_model, full_regressor, random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import (
    MIMIC,
    TREE,
    TREE_MIMIC,
    TREE_MIMIC_NO_OFFSET,
    pendulum,
    planar_arm,
)
from tests.helpers.small_robots import SMALL
from tests.helpers.strategies import SEEDS, dh_tables, random_states
from tests.helpers.tolerances import KINEMATICS, REGROUPING, assert_same


@pytest.fixture(scope="module")
def tree() -> RobotModel:
    return load_robot(TREE)


@pytest.fixture(scope="module")
def mimicking() -> RobotModel:
    return load_robot(TREE_MIMIC)


def check_against_pinocchio(robot: RobotModel, rng: np.random.Generator, count: int = 4) -> None:
    theta = random_links(rng, robot.n_links)
    q, v, a = random_states(rng, robot.n, count)
    model = robot.with_inertias(theta)
    # Configurations made by Pinocchio's own integrate; of a floating base the robot takes them too.
    configurations = np.array([pin.integrate(model, pin.neutral(model), each) for each in q])
    q = configurations if robot.free_flyer else q
    Y = robot.regressor(q, v, a)
    assert Y.shape == (count, robot.n, 10 * robot.n_links)
    efforts, masses = robot.inverse_dynamics(theta, q, v, a), robot.mass_matrix(theta, q)
    np.testing.assert_array_equal(robot.mass_matrix(theta, q[1]), masses[1])
    data = model.createData()
    for k, state in enumerate(zip(configurations, v, a, strict=True)):
        # With a single joint the binding returns one axis less.
        assert_same(Y[k], pin.computeJointTorqueRegressor(model, data, *state).reshape(Y[k].shape))
        assert_same(efforts[k], pin.rnea(model, data, *state))
        upper = np.triu(pin.crba(model, data, configurations[k]))
        assert_same(masses[k], upper + np.triu(upper, 1).T)


@pytest.mark.parametrize("source", [TREE, "solo12", "talos_reduced"])
def test_a_floating_base(source: str) -> None:
    robot = load_robot(source, root="free_flyer")
    model = robot.pin_model
    assert (robot.n, robot.n_base, robot.n_links) == (model.nv, 6, model.njoints - 1)
    assert robot.joint_names[:6] == tuple(
        f"root_joint/{axis}" for axis in ("vx", "vy", "vz", "wx", "wy", "wz")
    )
    check_against_pinocchio(robot, np.random.default_rng(2))


@given(SEEDS)
def test_mimic_joints_are_the_whole_robots_projection(
    tree: RobotModel, mimicking: RobotModel, seed: int
) -> None:
    """Virtual work: the efforts of the coordinates are E^T times those of all joints."""
    rng = np.random.default_rng(seed)
    assert mimicking.joint_names == tuple(n for n in tree.joint_names if n != MIMIC["joint"])
    theta = random_links(rng, tree.n_links)
    q, v, a = random_states(rng, mimicking.n, 3)
    E = np.zeros((tree.n, mimicking.n))
    for row, name in enumerate(tree.joint_names):
        source = name if name in mimicking.joint_names else MIMIC["source"]
        share = 1.0 if source == name else MIMIC["multiplier"]
        E[row, mimicking.joint_names.index(str(source))] = share
    np.testing.assert_allclose(mimicking.expansion, E)
    offset = np.array([MIMIC["offset"] if n == MIMIC["joint"] else 0.0 for n in tree.joint_names])
    whole = tree.inverse_dynamics(theta, q @ E.T + offset, v @ E.T, a @ E.T)
    assert_same(mimicking.inverse_dynamics(theta, q, v, a), whole @ E)
    masses = tree.mass_matrix(theta, q @ E.T + offset)
    assert_same(mimicking.mass_matrix(theta, q), E.T @ masses @ E)


def test_a_mimic_of_a_mimic_is_followed_to_its_source() -> None:
    chain = TREE_MIMIC.replace(
        '<limit lower="-2" upper="1.5" effort="30" velocity="3"/>',
        '<limit lower="-2" upper="1.5" effort="30" velocity="3"/>'
        '<mimic joint="thumb" multiplier="3" offset="-1"/>',
    )
    robot = load_robot(chain)
    assert robot.joint_names == ("lift", "left", "slide", "finger")
    # right = 3·thumb − 1 = 3·(−0.7·finger + 0.2) − 1
    row = list(robot.pin_model.names).index("right") - 1
    np.testing.assert_allclose(robot.expansion[row], [0, 0, 0, -2.1])
    assert robot.offset[row] == pytest.approx(-0.4)


def test_a_floating_base_takes_a_mimic_joint_without_offset() -> None:
    robot = load_robot(TREE_MIMIC_NO_OFFSET, root="free_flyer")
    assert robot.n == robot.pin_model.nv - 1


def test_a_pinocchio_model_is_copied_and_keeps_its_gravity(tree: RobotModel) -> None:
    model = tree.pin_model.copy()
    model.gravity.linear = np.array([1.0, 2.0, 3.0])
    robot = load_robot(model)
    model.gravity.linear = np.zeros(3)
    np.testing.assert_array_equal(robot.gravity, [1.0, 2.0, 3.0])
    assert robot.urdf is None
    np.testing.assert_array_equal(robot.prior, tree.prior)
    turned = load_robot(model, gravity=(0.0, 9.81, 0.0))
    np.testing.assert_array_equal(turned.gravity, [0.0, 9.81, 0.0])


def test_the_description_is_the_prior(tree: RobotModel) -> None:
    assert tree.name == "tree"
    assert tree.urdf == TREE
    assert tree.link_names == ("column", "left_arm", "left_slide", "right_arm", "finger", "thumb")
    # The welded bracket belongs to the link that carries it.
    assert tree.prior[3, 0] == pytest.approx(1.5)
    assert tree.parameter_names[10] == "m_2"
    assert len(tree.parameter_names) == len(tree.parameter_units) == 60
    with pytest.raises(ValueError, match="read-only"):
        tree.prior[0, 0] = 1.0


def test_limits_of_zero_are_none() -> None:
    limits = '<limit effort="80" velocity="3"/>'
    text = SMALL["without_limits"].urdf
    assert limits in text
    robot = load_robot(text.replace(limits, '<limit effort="0" velocity="0"/>'))
    np.testing.assert_array_equal(robot.position_limits, [[-np.inf, np.inf]] * 2)
    assert np.isinf([*robot.velocity_limits, *robot.effort_limits]).all()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"q": np.zeros((3, 5))}, "position: 5 columns"),
        ({"q": np.zeros(6)}, "position: has 1 axes"),
        ({"v": np.zeros((2, 6))}, r"velocity: shape \(2, 6\), expected \(3, 6\)"),
        ({"a": np.zeros((3, 7))}, "acceleration: shape"),
        ({"a": np.full((3, 6), np.nan)}, "acceleration: 18 of 18 values are not finite"),
        ({"q": [[1.0, 2.0], [3.0]]}, "position: not a rectangular array"),
        ({"v": np.full((3, 6), 1j)}, "velocity: .*complex"),
    ],
)
def test_bad_states_are_data_errors(denso: RobotModel, change: dict[str, Array], says: str) -> None:
    states = {"q": np.zeros((3, 6)), "v": np.zeros((3, 6)), "a": np.zeros((3, 6))} | change
    refuses(DataError, says, denso.regressor, **states)


@given(st.integers(0, 3))
@settings(max_examples=4)
def test_no_samples_give_no_rows(denso: RobotModel, count: int) -> None:
    empty = np.zeros((count, 6))
    assert denso.regressor(empty, empty, empty).shape == (count, 6, 60)


def test_friction_of_the_description() -> None:
    text = TREE.replace("</joint>", '<dynamics damping="0.5" friction="2"/></joint>', 1)
    viscous, coulomb = load_robot(text).described_friction()
    assert sorted(viscous) == [0.0] * 5 + [0.5]
    assert sorted(coulomb) == [0.0] * 5 + [2.0]
    for key in ("friction", "damping"):
        with pytest.raises(ModelError, match=rf"{key} is -\d.*, the least is 0"):
            load_robot(text.replace(f'{key}="', f'{key}="-'))
    with pytest.raises(ModelError, match="damping of <dynamics> is 'much'"):
        load_robot(text.replace('damping="0.5"', 'damping="much"'))


# Where robots come from, and what is refused.


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


def test_example_robots_by_stem_and_by_folder() -> None:
    assert load_robot("ur5_robot").n == 6
    assert load_robot("anymal_b_simple_description/anymal").n == 12
    words = "ambiguous: use one of anymal_b_simple_description/anymal, anymal_c"
    refuses(ModelError, words, load_robot, "anymal")


def test_text_path_and_string_path_are_the_same_robot(tmp_path: Path) -> None:
    path = tmp_path / "tree.urdf"
    path.write_text(TREE, encoding="utf-8")
    for source in (TREE, "\n " + TREE, path, str(path)):
        robot = load_robot(source)
        assert robot.joint_names == load_robot(TREE).joint_names
    declared = '<?xml version="1.0" encoding="UTF-8"?>\n' + TREE
    assert load_robot(declared).name == "tree"


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
        ("ur5_robt", "ur5_robot"),
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
        words = rf"no robot '{name}': .* are known, such as denso_vp.*; .*sdpid robots lists"
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


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16", "utf-16-be"])
def test_descriptions_are_read_in_the_encoding_that_they_declare(tmp_path: Path, encoding: str):
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
    assert read_urdf_bodies(chain(1500), "chain")[1][-1].placement[0, 3] == 1499
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
    (
        urdf(JOINT.format(kind="revolute", inside='<mimic joint="x" offset="a"/>')),
        "offset of <mimic> is 'a'",
    ),
    (urdf(JOINT.format(kind="revolute", inside='<mimic joint="x" offset="nan"/>')), "is 'nan'"),
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
    refuses(ModelError, "root is 'fixed'", load_robot, TREE, root="fixed")
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
    assert check_urdf(text, "it")[1] == ()
    assert load_robot(text).n == 1


# The shape of links against Pinocchio's own reading, and shapes that the hull must contain.


WELD = """<joint name="weld" type="fixed"><parent link="arm"/><child link="hand"/>
<origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/></joint><link name="hand"><collision>
<origin xyz="0 0 0.5"/><geometry><box size="0.2 0.4 0.6"/></geometry></collision></link>"""

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"


def arm(geometry: str, *, origin: str = "", more: str = "") -> sdpid.RobotModel:
    shape = f"<collision>{origin}<geometry>{geometry}</geometry></collision>" if geometry else ""
    return sdpid.load_robot(
        f"""<robot name="r"><link name="base"><collision><geometry><sphere radius="9"/></geometry>
        </collision></link><link name="arm">{shape}</link><joint name="j" type="revolute">
        <parent link="base"/><child link="arm"/><origin xyz="3 2 1" rpy="1 2 3"/>
        <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
        {more}</robot>"""
    )


def contains(corners: Array, points: Array) -> bool:
    equations = ConvexHull(corners).equations
    return bool((points @ equations[:, :3].T + equations[:, 3]).max() <= 1e-12)


def directions(count: int = 2000) -> Array:
    points = np.random.default_rng(0).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def test_what_is_fixed_to_a_link_belongs_to_it() -> None:
    points = collision_points(arm("", more=WELD), "arm")
    np.testing.assert_allclose(points.min(axis=0), [-0.2, -0.1, 1.2], atol=1e-15)
    np.testing.assert_allclose(points.max(axis=0), [0.2, 0.1, 1.8], atol=1e-15)
    assert len(collision_points(arm('<box size="1 1 1"/>', more=WELD), "arm")) == 16


def test_round_shapes_are_inside_and_not_by_much() -> None:
    ball = directions()
    points = collision_points(arm('<sphere radius="0.5"/>'), "arm")
    assert contains(points, 0.5 * ball)
    assert np.linalg.norm(points, axis=1).max() < 0.5 * 1.08

    flat = ball[:, :2] / np.linalg.norm(ball[:, :2], axis=1, keepdims=True)
    rims = np.concatenate([np.column_stack([0.5 * flat, z * np.ones(len(flat))]) for z in (-1, 1)])
    points = collision_points(arm('<cylinder radius="0.5" length="2"/>'), "arm")
    assert contains(points, rims)
    assert np.abs(points[:, 2]).max() == 1.0
    assert np.linalg.norm(points[:, :2], axis=1).max() < 0.5 * 1.02

    points = collision_points(arm('<capsule radius="0.5" length="2"/>'), "arm")
    assert contains(points, np.concatenate([0.5 * ball + [0, 0, z] for z in (-1, 1)]))
    assert points[:, 2].max() < 1.0 + 0.5 * 1.08


@pytest.mark.parametrize("link", ["panda_link3", "panda_link7"])
def test_meshes_as_pinocchio_places_them(link: str) -> None:
    path = find_robot("panda")
    robot = sdpid.load_robot("panda")
    share = next(p.parent for p in path.parents if p.name == "example-robot-data")
    geometry = pin.buildGeomFromUrdf(
        robot.pin_model, str(path), pin.GeometryType.COLLISION, package_dirs=[str(share)]
    )
    expected = [
        np.array(o.geometry.vertices()) @ o.placement.rotation.T + o.placement.translation
        for o in geometry.geometryObjects
        if o.parentJoint == robot.link_names.index(link) + 1
    ]
    assert expected
    points = collision_points(robot, link)
    np.testing.assert_allclose(points, np.concatenate(expected), atol=1e-12)


def test_a_mesh_is_found_by_package_by_folder_and_by_path(tmp_path: Path) -> None:
    mesh = tmp_path / "my_robot" / "meshes" / "arm.obj"
    mesh.parent.mkdir(parents=True)
    mesh.write_text(TETRAHEDRON, encoding="utf-8")
    urdf_folder = tmp_path / "my_robot" / "urdf"
    urdf_folder.mkdir()
    tried = {
        "package://my_robot/meshes/arm.obj": [tmp_path, tmp_path / "my_robot", urdf_folder],
        "meshes/arm.obj": [tmp_path / "my_robot"],
        "../meshes/arm.obj": [urdf_folder],
        str(mesh): [],
        f"file://{mesh}": [],
    }
    for name, folders in tried.items():
        robot = arm(f'<mesh filename="{name}" scale="1 2 -3"/>')
        for folder in folders or [None]:
            dirs = () if folder is None else (str(folder),)
            points = collision_points(robot, "arm", package_dirs=dirs)
            np.testing.assert_array_equal(points.min(axis=0), [0, 0, -3])
            np.testing.assert_array_equal(points.max(axis=0), [1, 2, 0])


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ('<mesh filename="package://nowhere/a.stl"/>', "nowhere/a.stl' is not found.*package_dirs"),
        ('<mesh filename="http://x/a.stl"/>', "package://"),
        ('<box size="1 2"/>', "size is '1 2', expected 3"),
        ('<sphere radius="wide"/>', "radius='wide'"),
        ('<sphere radius="-1"/>', r"-1\.0 m"),
        ("<cylinder/>", "radius=None"),
        ("<cone/>", "<cone> is not understood"),
        ("<box/><box/>", "2 shapes"),
    ],
)
def test_what_is_refused(geometry: str, message: str) -> None:
    # Pinocchio is not asked for the geometry, so that a model loads whatever its shapes are.
    robot = arm('<box size="1 1 1"/>')
    text = robot.urdf.replace('<box size="1 1 1"/>', geometry)
    changed = sdpid.RobotModel(**{**vars(robot), "urdf": text})
    refuses(ModelError, message, collision_points, changed, "arm")


def test_a_broken_mesh_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_text("nothing", encoding="utf-8")
    with pytest.raises(ModelError, match=r"cannot be read|no vertices"):
        collision_points(arm('<mesh filename="a.stl"/>'), "arm", package_dirs=[tmp_path])


def test_links_without_a_shape() -> None:
    refuses(ModelError, "no moving link 'base'; it has arm", collision_points, arm(""), "base")
    with pytest.raises(ModelError, match="'arm' and what is fixed to it have no collision"):
        collision_points(arm(""), "arm")
    with pytest.raises(ModelError, match="not loaded from a URDF"):
        collision_points(sdpid.load_robot(pin.buildModelFromXML(TREE)), "column")
    bare = pendulum()
    refuses(ModelError, "no collision geometry", collision_points, bare, bare.link_names[0])


def test_placements() -> None:
    robot = arm("")
    at_zero = link_placements(robot)
    np.testing.assert_allclose(at_zero[0, :3, 3], [3, 2, 1], atol=KINEMATICS)
    turned = link_placements(robot, [0.3])[0]
    np.testing.assert_allclose(
        np.linalg.solve(at_zero[0], turned)[:2, :2],
        [[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]],
        atol=KINEMATICS,
    )
    floating = link_placements(sdpid.load_robot(TREE, root="free_flyer"))
    fixed = link_placements(sdpid.load_robot(TREE))
    np.testing.assert_allclose(floating[1:], fixed, atol=KINEMATICS)
    refuses(DataError, "position", link_placements, robot, [0.1, 0.2])


# Which coordinates are lengths.


@pytest.mark.parametrize("root", [None, "free_flyer"])
def test_lengths_are_those_of_sliding_joints_and_of_a_base(
    root: Literal["free_flyer"] | None,
) -> None:
    robot = load_robot(TREE, root=root)
    found = sliding(robot.pin_model, robot.joint_names)
    lengths = {name for name, slides in zip(robot.joint_names, found, strict=True) if slides}
    base = {name for name in robot.joint_names if name.endswith(("/vx", "/vy", "/vz"))}
    assert lengths == {"lift", "slide"} | base
    assert len(base) == (3 if root == "free_flyer" else 0)


# Base parameters: the rule, the names, and the regrouping at states it was not found at.


FIELD_ORDER = ("xx", "xy", "xz", "yy", "yz", "zz", "mx", "my", "mz", "m")


def base_of(robot: RobotModel, *terms: str | Coupling) -> BaseParameters:
    return structural_base(robot, friction_model(robot, terms))


@pytest.fixture(scope="module")
def table_iv(denso: RobotModel) -> BaseParameters:
    return base_of(denso, "coulomb", "viscous")


def test_denso_has_table_ivs_names_in_its_order(table_iv: BaseParameters) -> None:
    text = (bundled_folder("denso_vp6242") / "table_iv.csv").read_text(encoding="utf-8")
    rows = [(row["parameter"], row["unit"]) for row in csv.DictReader(text.splitlines())]
    assert list(zip(table_iv.names, table_iv.units, strict=True)) == rows
    assert table_iv.count == 48
    # What no motion shows at all, beside what is regrouped.
    gone = {f"{p}_1" for p in FIELD_ORDER if p != "zz"} | {"m_2", "mz_2"}
    assert set(table_iv.eliminated) == gone


@pytest.mark.parametrize(
    ("name", "expression"),
    [
        ("xxr2", "xx_2 - yy_2 - 0.0441*m_3 - 0.0441*m_4 - 0.0441*m_5 - 0.0441*m_6"),
        ("mxr3", "mx_3 - 0.075*m_4 - 0.075*m_5 - 0.075*m_6"),
        ("zzr5", "zz_5 + 0.0049*m_6 + 0.14*mz_6 + yy_6"),
        ("Fs3", "Fs3"),
    ],
)
def test_denso_regroupings_are_khalils(table_iv: BaseParameters, name: str, expression: str):
    assert table_iv.expression(name) == expression
    refuses(KeyError, "no base parameter 'zz1'", table_iv.expression, "zz1")


def test_the_rank_decision_is_explained(table_iv: BaseParameters) -> None:
    text = table_iv.explain()
    assert text.startswith("48 base parameters of 72 standard ones.")
    singular = table_iv.singular_values
    assert len(singular) == 72
    assert singular[47] > 1e-2
    assert singular[48] < 1e-12
    assert table_iv.largest_dropped < table_iv.tolerance < table_iv.smallest_kept


def fresh_rows(robot: RobotModel, terms: tuple[str, ...], seed: int, count: int = 12) -> Array:
    """Return full regressor rows at states that the scan has not seen."""
    rows = full_regressor(robot, generic_states(robot, count, seed), terms)
    return rows.reshape(-1, rows.shape[2])


def check_rule(robot: RobotModel, base: BaseParameters, terms: tuple[str, ...], seed: int) -> None:
    W = fresh_rows(robot, terms, seed)
    theta = np.random.default_rng(seed).standard_normal(W.shape[1])
    full, reduced = W @ theta, W[:, base.kept] @ (base.matrix @ theta)
    scale = np.abs(W).max() * np.abs(theta).max()
    # What the scan drops below its tolerance (axes off by milliradians) is missing from the
    # effort in that proportion, and reported: `largest_dropped` is rounding for most robots.
    share = REGROUPING + 10.0 * base.largest_dropped
    np.testing.assert_allclose(reduced, full, rtol=0, atol=share * max(scale, 1.0))
    # The kept columns of B are the identity, exactly, and columns fold only into earlier ones.
    np.testing.assert_array_equal(base.matrix[:, base.kept], np.eye(base.count))
    order = {name: i for i, name in enumerate(scan_order(base))}
    for i, j in np.argwhere(base.matrix != 0.0):
        assert order[base.theta_names[base.kept[i]]] <= order[base.theta_names[j]]
    for name, row in zip(base.names, base.matrix, strict=True):
        assert ("r" in name.rstrip("0123456789_")[1:]) == (np.count_nonzero(row) > 1)


def scan_order(base: BaseParameters) -> list[str]:
    inertial = [n for n in base.theta_names if n.split("_")[0] in FIELD_ORDER]
    count = len(inertial) // 10
    listed = [f"{p}_{i + 1}" for i in range(count) for p in FIELD_ORDER]
    return listed + [n for n in base.theta_names if n not in set(inertial)]


@given(dh_tables(most=5, clear=True), SEEDS)
@settings(max_examples=20)
def test_regrouping_holds_at_fresh_states(table: DhTable, seed: int) -> None:
    robot = RobotModel.from_mdh(table)
    terms = ("coulomb", "viscous", "rotor_inertia")
    check_rule(robot, base_of(robot, *terms), terms, seed)


@pytest.mark.parametrize(
    ("source", "root"),
    [
        (TREE, None),
        (TREE_MIMIC, None),
        (TREE, "free_flyer"),
        (TREE_MIMIC_NO_OFFSET, "free_flyer"),
        ("solo12", None),
        ("solo12", "free_flyer"),
        ("panda", None),
        ("romeo_small", None),
    ],
)
def test_trees_floating_bases_and_humanoids(source: str, root: str | None) -> None:
    robot = load_robot(source, root=root)
    terms = ("coulomb", "rotor_inertia")
    base = base_of(robot, *terms)
    if root is None:
        check_rule(robot, base, terms, 7)
    else:
        W = fresh_rows(robot, terms, 7)
        error = np.abs(W[:, base.kept] @ base.matrix - W).max()
        assert error <= REGROUPING * np.abs(W).max()
    # The rank is the numerical one: the singular values fall off a cliff there.
    singular = base.singular_values
    assert singular[base.count - 1] > 1e-4 * singular[0]
    if len(singular) > base.count:
        assert singular[base.count] < 1e-9 * singular[0]


def test_a_floating_base_shows_all_of_its_first_link() -> None:
    robot = load_robot(TREE, root="free_flyer")
    base = base_of(robot, "coulomb")
    leading = [base.theta_names[k] for k in base.kept]
    assert {f"{p}_1" for p in FIELD_ORDER} <= set(leading)
    # Friction stands with the link that its joint moves; the base has none.
    assert base.names.index("Fs1") > max(i for i, n in enumerate(leading) if n.endswith("_2"))
    assert base.names.index("Fs1") < min(i for i, n in enumerate(leading) if n.endswith("_3"))


def test_axes_that_are_meant_to_be_parallel_are() -> None:
    """As 1.5708 − pi/2 leaves them: the rank is that of parallel axes, and the gap is shown."""
    off = 1.5708 - np.pi / 2
    rows = (DhJoint(alpha=np.pi / 2), DhJoint(d=0.4, alpha=off))
    base = base_of(RobotModel.from_mdh(rows))
    assert base.count == base_of(planar_arm()).count
    assert 1e-7 < base.largest_dropped < base.tolerance


def test_one_joint() -> None:
    base = base_of(pendulum(), "coulomb", "viscous")
    assert base.names == ("zz1", "mx1", "my1", "Fs1", "Fv1")


def test_parallel_axes() -> None:
    """Each link of a planar arm shows zz, mx, my; masses fold into the link before."""
    base = base_of(planar_arm())
    assert base.names == ("zzr1", "mxr1", "my1", "zz2", "mx2", "my2")
    assert base.expression("zzr1") == "zz_1 + 0.16*m_2"
    assert base.expression("mxr1") == "mx_1 + 0.4*m_2"


def test_tilted_gravity_shows_the_first_links_center_of_mass(denso: RobotModel) -> None:
    tilted = load_robot("denso_vp6242", gravity=(3.0, 0.0, -9.0))
    assert base_of(tilted).count == base_of(denso).count + 2
