"""Robots: loading, regressors, coordinates and geometry."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
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
from sdpid.robot.description.urdf import check_urdf
from sdpid.robot.description.xml import encode_xml, is_mjcf, parse_xml, read_description
from sdpid.robot.model.geometry import collision_points, link_placements
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import MIMIC, TREE, TREE_MIMIC, TREE_MIMIC_NO_OFFSET, pendulum
from tests.helpers.small_robots import SMALL
from tests.helpers.strategies import SEEDS, random_states
from tests.helpers.tolerances import KINEMATICS, assert_same


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


@pytest.mark.parametrize("source", ["tree", "solo12", "talos_reduced"])
def test_a_floating_base(source: str) -> None:
    robot = load_robot(TREE if source == "tree" else source, root="free_flyer")
    model = robot.pin_model
    assert (robot.n, robot.n_base, robot.n_links) == (model.nv, 6, model.njoints - 1)
    axes = ("vx", "vy", "vz", "wx", "wy", "wz")
    assert robot.joint_names[:6] == tuple(f"root_joint/{axis}" for axis in axes)
    check_against_pinocchio(robot, np.random.default_rng(2))
    if source == "tree":
        # It takes a joint that follows another without an offset, and needs no other joint at all.
        follows = load_robot(TREE_MIMIC_NO_OFFSET, root="free_flyer")
        assert follows.n == follows.pin_model.nv - 1
        assert load_robot(urdf(joint("fixed")), root="free_flyer").n == 6


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
    states = {name: np.zeros((3, 6)) for name in "qva"}
    refuses(DataError, says, denso.regressor, **states | change)
    # No samples give no rows.
    assert denso.regressor(*np.zeros((3, 0, 6))).shape == (0, 6, 60)


def test_friction_of_the_description() -> None:
    text = TREE.replace("</joint>", '<dynamics damping="0.5" friction="2"/></joint>', 1)
    viscous, coulomb = load_robot(text).described_friction()
    assert sorted(viscous) == [0.0] * 5 + [0.5]
    assert sorted(coulomb) == [0.0] * 5 + [2.0]
    for key in ("friction", "damping"):
        negative = text.replace(f'{key}="', f'{key}="-')
        refuses(ModelError, rf"{key} is -\d.*, the least is 0", load_robot, negative)
    much = text.replace('damping="0.5"', 'damping="much"')
    refuses(ModelError, "damping of <dynamics> is 'much'", load_robot, much)


# Where robots come from, and what is refused.


def joint(kind: str = "revolute", inside: str = "") -> str:
    return f"""<joint name="j" type="{kind}"><parent link="a"/><child link="b"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>{inside}</joint>"""


def urdf(joints: str = joint(), *, before: str = "") -> str:
    return f'{before}<robot name="r"><link name="a"/><link name="b"/>{joints}</robot>'


def test_bundled_robots() -> None:
    assert "denso_vp6242" in bundled_robots()
    robot = load_robot("denso_vp6242")
    assert robot.name == "denso_vp6242"
    assert (robot.n, robot.n_links) == (6, 6)
    np.testing.assert_array_equal(robot.gravity, [0.0, 0.0, -9.81])
    assert not robot.prior.any()
    refuses(ModelError, "denso_vp6242", bundled_folder, "denso")
    # Others by their stem and by their folder.
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


def test_an_unknown_name_is_answered_with_near_ones() -> None:
    near = {"ur5": "ur5_robot", "Panda_hand": "panda", "ur5_robt": "ur5_robot"}
    for name, wanted in {**near, "UR5.urdf.xacro": "ur5_robot"}.items():
        words = rf"no robot '{name}'.*near it are .*{wanted}"
        # Of 70 names, those that help.
        assert len(str(refuses(ModelError, words, load_robot, name))) < 200
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
        first = joint().replace('"b"', '"l0"')
        return f'<robot name="r"><link name="a"/>{links}{first}{fixed}</robot>'

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
    (urdf(joint("fixed")), "no moving joint"),
    (urdf(""), "no moving joint"),
    (urdf(joint("planar")), "'j' is of kind 'planar'"),
    (urdf(joint("floating")), "floating base: root='free_flyer'"),
    (urdf('<joint name="j"><parent link="a"/><child link="b"/></joint>'), "kind '?'"),
    ("<robot", "not well-formed"),
    ("<robot></robots>", "not well-formed"),
    ("<sdf/>", "root element is <sdf>"),
    (urdf(joint(inside='<mimic joint="j"/>')), "circle at 'j'"),
    (urdf(joint(inside='<mimic joint="x"/>')), "mimics 'x'"),
    (urdf(joint(inside='<mimic joint="x" offset="a"/>')), "offset of <mimic> is 'a'"),
    (urdf(joint(inside='<mimic joint="x" offset="nan"/>')), "is 'nan'"),
    (urdf(joint(inside='<mimic joint="x" offset="1e300"/>')), "at most"),
    (urdf(joint().replace('"b"', '"c"')), "cannot read it"),
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


@pytest.mark.parametrize(("source", "says"), BAD, ids=[says for _, says in BAD])
def test_bad_sources_are_model_errors(source: Any, says: str) -> None:
    refuses(ModelError, re.escape(says), load_robot, source)


def test_bad_options_and_files_are_model_errors(tmp_path: Path) -> None:
    refuses(ModelError, "root is 'fixed'", load_robot, TREE, root="fixed")
    model = load_robot(TREE).pin_model
    refuses(ModelError, "already has its root", load_robot, model, root="free_flyer")
    refuses(ModelError, "gravity", load_robot, TREE, gravity=(0.0, 0.0))
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
    text = urdf(f"<note>{entity}</note>" + joint(), before=doctype)
    # Expanded it would be terabytes.
    refuses(ModelError, r"document type|well-formed", load_robot, text)


def test_xml_of_any_size_is_not_swallowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sdpid.robot.description.xml.MAX_BYTES", 100)
    refuses(ModelError, "bytes of XML, more than the 100 allowed", parse_xml, TREE, "it")


def test_joints_of_transmissions_do_not_count() -> None:
    text = urdf('<transmission name="t"><joint name="k"/></transmission>' + joint("prismatic"))
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
        ('<sphere radius="wide"/>', "radius is 'wide'"),
        ('<sphere radius="-1"/>', r"-1\.0 m"),
        ("<cylinder/>", "radius is ''"),
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


def test_links_without_a_shape(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_text("nothing", encoding="utf-8")
    broken, bare = arm('<mesh filename="a.stl"/>'), pendulum()
    for words, robot, link in (
        ("no moving link 'base'; it has arm", arm(""), "base"),
        ("'arm' and what is fixed to it have no collision", arm(""), "arm"),
        ("not loaded from a URDF", sdpid.load_robot(pin.buildModelFromXML(TREE)), "column"),
        ("no collision geometry", bare, bare.link_names[0]),
        (r"cannot be read|no vertices", broken, "arm"),
    ):
        refuses(ModelError, words, collision_points, robot, link, package_dirs=[tmp_path])


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
