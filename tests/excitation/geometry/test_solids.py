"""Solids of links: hulls of meshes, shapes of fixed links, and what is assumed."""

from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.excitation.geometry.solids import Solid, robot_solids
from sdpid.robot.model.shapes import Shape
from tests.helpers.robots import TREE
from tests.helpers.shapes import BALL, shaped_arm
from tests.robot.model.test_geometry import TETRAHEDRON


def mesh(name: str) -> str:
    return f'<mesh filename="{name}"/>'


def test_meshes_become_their_hulls_and_are_told(tmp_path: Path) -> None:
    inner = TETRAHEDRON.replace("f 1 2 3", "v 0.1 0.1 0.1\nf 1 2 5\nf 1 2 3", 1)
    (tmp_path / "part.obj").write_text(inner)
    solids, assumed = robot_solids(shaped_arm("", mesh("part.obj")), package_dirs=[tmp_path])
    (solid,) = solids
    assert len(solid.shape.points()) == 4  # type: ignore[union-attr]
    assert assumed == (
        "Meshes are taken as their convex hulls: l1.",
        "Without any shape in the description, not checked: l0.",
    )


def test_a_flat_mesh_becomes_a_thin_box(tmp_path: Path) -> None:
    (tmp_path / "sheet.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (solid,), _ = robot_solids(shaped_arm("", mesh("sheet.obj")), package_dirs=[tmp_path])
    assert isinstance(solid.shape, Shape)
    assert solid.shape.kind == "box"
    np.testing.assert_allclose(solid.shape.sizes, [1.0, 1.0, 1e-3])


def test_visual_shapes_stand_for_missing_collision_shapes() -> None:
    robot = sdpid.load_robot(
        """<robot name="r"><link name="base"/><link name="arm"><visual><geometry>
        <sphere radius="0.2"/></geometry></visual></link><joint name="j" type="revolute">
        <parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    )
    (solid,), assumed = robot_solids(robot)
    assert solid.core[1] == 0.2
    assert "Visual shapes stand for missing collision shapes: arm." in assumed


def test_capsules_stand_for_missing_meshes_and_the_file_is_named() -> None:
    solids, assumed = robot_solids(shaped_arm(BALL, mesh("lost.stl"), BALL), radius=0.04)
    assert [solid.body for solid in solids] == ["l0", "l1", "l2"]
    assert solids[1].core[1] == 0.04
    (sentence,) = assumed
    assert "'l1', collision geometry: mesh 'lost.stl' is not found" in sentence
    assert "package_dirs" in sentence


def test_a_robot_without_shapes_has_capsules_from_joint_to_joint() -> None:
    robot = sdpid.load_robot(TREE)
    solids, (sentence,) = robot_solids(robot, radius=0.03)
    assert "no shapes" in sentence
    assert "30 mm" in sentence
    ends = {
        (solid.joint, *np.round(end, 9)): solid.core[1] for solid in solids for end in solid.core[0]
    }
    assert set(ends.values()) == {0.03}
    model = robot.pin_model
    for joint in range(1, model.njoints):
        at = np.round(model.jointPlacements[joint].translation, 9)
        assert (model.parents[joint], *at) in ends
    assert {solid.joint for solid in solids} == set(range(model.njoints))


def test_a_robot_that_is_no_urdf_is_told_apart_from_one_without_shapes() -> None:
    robot = sdpid.RobotModel.from_pinocchio(sdpid.load_robot(TREE).pin_model)
    _, (sentence,) = robot_solids(robot)
    assert "is no URDF, so its shapes are not read" in sentence


@pytest.mark.parametrize(
    ("shape", "radius"),
    [
        (Shape.of("box", [0.2, 0.3, 0.4]), 0.0),
        (Shape.of("sphere", [0.2]), 0.2),
        (Shape.of("capsule", [0.1, 0.5]), 0.1),
        (Shape.of("cylinder", [0.1, 0.5]), 0.0),
    ],
)
def test_the_core_is_the_shape_less_its_radius(shape: Shape, radius: float) -> None:
    points, found = Solid(body="x", joint=1, shape=shape).core
    assert found == radius
    outer = np.abs(shape.points()).max(axis=0)
    assert (np.abs(points).max(axis=0) + radius <= outer + 1e-12).all()


def test_a_hull_with_hundreds_of_corners_on_a_face_is_taken(tmp_path: Path) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    lines = [f"v {np.cos(a)} {np.sin(a)} {z}" for z in (0, 1) for a in angles]
    lines += [f"f {i} {i + 1} {i + 401}" for i in range(1, 399)]
    (tmp_path / "disc.obj").write_text("\n".join(lines) + "\n")
    (solid,), _ = robot_solids(shaped_arm("", mesh("disc.obj")), package_dirs=[tmp_path])
    geometry, _ = solid.geometry
    assert geometry.num_points > 790


def test_capsules_stand_for_shapes_that_are_not_understood() -> None:
    _, (sentence,) = robot_solids(shaped_arm(BALL, "<cone/>", BALL))
    assert "a <cone> is not understood" in sentence
