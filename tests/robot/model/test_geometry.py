"""The shape of links against Pinocchio's own reading, and shapes that the hull must contain."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial import ConvexHull

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.robot.description.catalog import find_robot
from sdpid.robot.model.geometry import collision_points, link_placements
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, pendulum
from tests.helpers.tolerances import KINEMATICS

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


def test_box_in_its_origin() -> None:
    turned = '<origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/>'
    points = collision_points(arm('<box size="0.2 0.4 0.6"/>', origin=turned), "arm")
    assert points.shape == (8, 3)
    np.testing.assert_allclose(points.min(axis=0), [0.8, -0.1, -0.3], atol=1e-15)
    np.testing.assert_allclose(points.max(axis=0), [1.2, 0.1, 0.3], atol=1e-15)


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
    floating = sdpid.load_robot(TREE, root="free_flyer")
    fixed = sdpid.load_robot(TREE)
    np.testing.assert_allclose(
        link_placements(floating)[1:], link_placements(fixed), atol=KINEMATICS
    )
    refuses(DataError, "position", link_placements, robot, [0.1, 0.2])
