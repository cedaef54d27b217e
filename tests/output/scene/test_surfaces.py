"""Surfaces of links: what the description has, else what is assumed; thinned and still there."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from sdpid.output.scene.surfaces import Surface, described_surfaces, hull, thinned
from sdpid.robot.model.load import load_robot
from tests.helpers.robots import small_arm

ROBOT = """<robot name="a"><link name="base">{base}</link>
<link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
iyz="0"/></inertial>{arm}</link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 1"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
BOX = '<{kind}><origin xyz="0 0 0.5"/><geometry><box size="0.2 0.4 {z}"/></geometry></{kind}>'
MESH = '<visual><geometry><mesh filename="{name}" scale="0.1 0.1 0.1"/></geometry></visual>'
TRIANGLES = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"


def ball(rows: int) -> Surface:
    """Return a ball of many triangles."""
    k = np.arange(rows) + 0.5
    height, turn = 1.0 - 2.0 * k / rows, np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - height**2)
    return Surface(3, *hull(np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=-1)))


def test_visual_shapes_come_before_collision_shapes() -> None:
    collision, visual = BOX.format(kind="collision", z="1"), BOX.format(kind="visual", z="0.6")
    (found,), notes = described_surfaces(load_robot(ROBOT.format(base="", arm=collision + visual)))
    assert (found.link, notes) == (0, ())
    assert np.allclose(np.ptp(found.points, axis=0), [0.2, 0.4, 0.6])
    assert found.points[:, 2].max() == pytest.approx(0.8)
    (other,), _ = described_surfaces(load_robot(ROBOT.format(base=collision, arm="")))
    assert (other.link, np.ptp(other.points[:, 2])) == (-1, pytest.approx(1.0))


def test_meshes_lie_beside_the_description(tmp_path: Path) -> None:
    """Triangles as in the file, also open ones; without the file a capsule, told."""
    path = tmp_path / "robot.urdf"
    path.write_text(ROBOT.format(base="", arm=MESH.format(name="a.obj")))
    (capsule,), notes = described_surfaces(load_robot(path))
    assert len(capsule.faces) > 20
    assert "arm" in notes[0]
    (tmp_path / "a.obj").write_text(TRIANGLES)
    (mesh,), notes = described_surfaces(load_robot(path))
    assert notes == ()
    areas = np.cross(*np.moveaxis(np.diff(mesh.points[mesh.faces], axis=1), 1, 0))
    assert np.allclose(np.linalg.norm(areas, axis=1), 0.01)


def test_robots_without_shapes_are_capsules() -> None:
    found, notes = described_surfaces(small_arm(2))
    assert {each.link for each in found} == {-1, 0, 1}
    assert "capsules" in notes[0]


@pytest.mark.parametrize("size", ["0 0 0", "1e200 1e200 1e200"])
def test_shapes_that_make_no_picture_are_told(size: str) -> None:
    shape = f'<visual><geometry><box size="{size}"/></geometry></visual>'
    found, notes = described_surfaces(load_robot(ROBOT.format(base="", arm=shape)))
    assert all(np.abs(each.points).max() < 10.0 for each in found)
    assert "arm" in notes[0]


def test_thinned_surfaces_keep_their_shape() -> None:
    whole = ball(4000)
    (few,) = thinned([whole], 1000)
    assert len(few.faces) <= 1000
    assert few.link == 3
    assert ConvexHull(few.points).volume > 0.9 * ConvexHull(whole.points).volume
    assert np.linalg.norm(few.points, axis=1).max() <= 1.0 + 1e-12
    (same,) = thinned([whole], 10_000)
    assert len(same.faces) == len(whole.faces)


def test_hulls_face_outwards() -> None:
    points = np.random.default_rng(0).standard_normal((400, 3))
    corners, faces = hull(points)
    assert ConvexHull(corners).volume == pytest.approx(ConvexHull(points).volume)
    a, b, c = np.moveaxis(corners[faces], 1, 0)
    outward = np.einsum("mi,mi->m", np.cross(b - a, c - a), a - corners.mean(axis=0))
    assert np.all(outward > 0.0)
    plate = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    assert len(hull(plate)[1]) >= 2
    assert len(hull(np.zeros((4, 3)))[1]) == 0
