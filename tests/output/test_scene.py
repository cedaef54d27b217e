"""The robot of a report: its motion, its ellipsoids, and what is told of those it lacks."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import sdpid
from sdpid._common.arrays import Array
from sdpid.experiment.processing.samples import Samples
from sdpid.output.charts.page import policy
from sdpid.output.scene.scene import (
    Scene,
    Surface,
    described_surfaces,
    hull,
    identified_scene,
    inertia_ellipsoid,
    recorded_motion,
    thinned,
)
from sdpid.robot.inertia import from_pseudo_inertia, pseudo_inertia, theta_from_physical
from sdpid.robot.model.geometry import link_placements
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.browser import Tab, look
from tests.helpers.robots import TREE, TREE_MIMIC, small_arm
from tests.helpers.scenes import unpacked

# Steps of 16 bits over some meters, and over 2 in quaternions, of which products make a rotation.
QUANTIZED = 5e-4


def moved(robot: RobotModel, seconds: float = 2.0, rate: float = 100.0, **fields: Any) -> Samples:
    """Return samples of a slow motion."""
    pytest.importorskip("jinja2")
    time = np.arange(round(seconds * rate)) / rate
    position = 0.5 * np.sin(time)[:, None] * np.ones(robot.n)
    if robot.free_flyer:
        start = pin.neutral(robot.pin_model)
        position = np.stack([pin.integrate(robot.pin_model, start, each) for each in position])
    rest = np.zeros((len(time), robot.n))
    fields = {"time": time, **fields}
    return Samples(position=position, velocity=rest, acceleration=rest, effort=rest, **fields)


def data_of(scene: Scene) -> dict[str, Any]:
    """Return what the page holds for the player."""
    found = re.search(r'id="scene-data">(.*?)</script>', scene.markup, re.S)
    assert found
    content: dict[str, Any] = json.loads(found[1])
    return content


def shown(robot: RobotModel, theta: Array | None = None) -> Scene:
    """Return the scene of a robot on a slow motion."""
    return identified_scene(robot, moved(robot), theta)


@pytest.mark.parametrize(
    ("text", "root"),
    [
        pytest.param(TREE, None, id="prismatic joints and branches"),
        pytest.param(TREE_MIMIC, None, id="mimic joint"),
        pytest.param(TREE, "free_flyer", id="floating base"),
    ],
)
def test_links_are_where_they_were(text: str, root: Any) -> None:
    robot = sdpid.load_robot(text, root=root)
    samples = moved(robot)
    data = data_of(identified_scene(robot, samples, 1.1 * robot.prior.ravel()))
    frames = data["frames"]
    assert (frames["rate"], frames["count"]) == (25.0, 50)
    assert data["follow"] == robot.free_flyer
    poses = unpacked(frames["poses"]).reshape(50, robot.n_links, 7)
    for k in (0, 30):
        own = link_placements(robot, samples.position[4 * k])
        assert np.allclose(poses[k, :, :3], own[:, :3, 3], atol=QUANTIZED)
        i, j, m, w = poses[k, :, 3:].T
        turned = [1 - 2 * (j * j + m * m), 2 * (i * j + m * w), 2 * (i * m - j * w)]
        assert np.allclose(np.stack(turned, axis=-1), own[:, :3, 0], atol=QUANTIZED)
    groups = [each["group"] for each in data["ellipsoids"]]
    bodies = np.count_nonzero(robot.prior[:, 0])
    assert groups == ["identified"] * bodies + ["described"] * bodies
    # Ten percent more of all moments is ten percent more mass, and the same ellipsoid.
    half = data["ellipsoids"][bodies:]
    for one, other in zip(data["ellipsoids"], half, strict=False):
        assert np.allclose(one["lengths"], other["lengths"])


def test_impossible_and_missing_bodies_are_told() -> None:
    robot = sdpid.load_robot(TREE)
    theta = robot.prior.copy()
    theta[0, 4] = -1.0
    theta[1] = 0.0
    theta[2, 4:] *= 1e6
    scene = shown(robot, theta.ravel())
    groups = [each["group"] for each in data_of(scene)["ellipsoids"]]
    assert groups.count("identified") == robot.n_links - 3
    first, second, third = robot.link_names[:3]
    assert f"no body can have of {first}:" in scene.markup
    assert f"no inertia of {second}." in scene.markup
    assert re.search(rf"are not\s+drawn: {third}\.", scene.markup)
    assert "identified" not in {each["group"] for each in data_of(shown(robot))["ellipsoids"]}


@pytest.mark.parametrize("name", ["tree", "column"])
def test_names_are_no_markup_and_bytes_are_the_same(name: str) -> None:
    robot = sdpid.load_robot(TREE.replace(f'"{name}"', '"&lt;/script>&lt;b>"'))
    theta = np.zeros(robot.prior.size)
    scene = shown(robot, theta)
    assert scene == shown(robot, theta)
    assert scene.markup.count("</script>") == 1
    assert "<b>" not in scene.markup
    assert "&lt;b&gt;" in scene.markup


def test_recordings_play_their_first_minute() -> None:
    robot = sdpid.load_robot(TREE)
    long = recorded_motion(moved(robot, seconds=90.0))
    assert len(long.position) == 1500
    assert "first 60 s of 90 s" in long.note
    assert np.allclose(long.position[100], 0.5 * np.sin(4.0))
    slow = recorded_motion(moved(robot, seconds=4.0, rate=10.0))
    assert (slow.rate_hz, len(slow.position)) == (pytest.approx(10.0), 40)
    bare = recorded_motion(moved(robot, time=None))
    assert "no stamps" in bare.note
    # Two pieces an hour apart are played one after the other.
    samples = moved(robot)
    broken = moved(robot, time=samples.time + 3600.0 * (samples.time >= 1.0), starts=(0, 100))
    assert np.allclose(recorded_motion(broken).position, recorded_motion(samples).position)
    assert len(recorded_motion(moved(robot, seconds=0.01)).position) == 1


def test_it_plays_in_a_browser(tmp_path: Path) -> None:
    """From a file: without a network, without errors; and a picture stands where it does not."""
    robot = sdpid.load_robot(TREE)
    scene = shown(robot, 1.1 * robot.prior.ravel())
    head = '<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{}">'
    head = head.format(policy([scene.script]))
    page = f"<!DOCTYPE html>{head}<style>{scene.style}</style>{scene.markup}<script>{scene.script}"
    (tmp_path / "page.html").write_text(f"{page}</script>", encoding="utf-8")
    colors = """(() => { const c = document.createElement("canvas"), v = get("scene-view");
      [c.width, c.height] = [v.width, v.height]; const p = c.getContext("2d"); p.drawImage(v, 0, 0);
      const d = p.getImageData(0, 0, c.width, c.height).data; let blue = 0, gray = 0;
      for (let k = 0; k < d.length; k += 4) if (d[k + 3] > 60) {
        if (d[k + 2] > d[k] + 40) blue++; else gray++; }
      return [blue, gray]; })()""".replace("get(", "document.getElementById(")

    async def visit(tab: Tab) -> None:
        live = await tab.value("document.getElementById('scene').classList.contains('live')")
        assert live
        await tab.until("document.getElementById('scene-told').textContent !== ''")
        blue, gray = await tab.value(colors)
        assert min(blue, gray) > 1000
        box = "document.querySelector('[data-group=identified]')"
        await tab.value(f"{box}.click()")
        await tab.value("document.getElementById('scene-play').click()")
        await tab.until(f"({colors})[0] === 0")
        tab.heard_nothing()
        await tab.call("Emulation.setEmulatedMedia", media="print")
        seen = "getComputedStyle(document.querySelector('.scene %s')).display"
        assert [await tab.value(seen % each) for each in ("img", ".stage")] == ["block", "none"]

    look(tmp_path / "page.html", tmp_path / "profile", visit)


# ---- Inertia ellipsoids: those of uniform ellipsoids are themselves; impossible bodies have none.


# Lengths of axes come from square roots of second moments about the center, which cancel against
# the shift of the center of mass: of lengths a thousandth of it some seven digits are left.
AXES = 1e-5

lengths = st.lists(st.floats(0.01, 1.0), min_size=3, max_size=3)
vectors = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3)


def uniform(mass: float, center: Array, axes: Array) -> Array:
    """Return the parameters of a uniform solid ellipsoid, integrated over its ball."""
    moments = 0.2 * mass * axes @ axes.T
    return theta_from_physical(mass, center, np.trace(moments) * np.eye(3) - moments)


@given(st.floats(0.01, 100.0), vectors, lengths, vectors, st.integers(0, 2))
def test_a_uniform_ellipsoid_gives_itself(
    mass: float, center: list[float], sizes: list[float], turn: list[float], flat: int
) -> None:
    """Plates and rods too."""
    sizes[:flat] = [0.0] * flat
    rotation = Rotation.from_rotvec(turn).as_matrix()
    found = inertia_ellipsoid(uniform(mass, np.array(center), rotation * sizes))
    assert np.allclose(found.center, center, atol=1e-12)
    # Of a square root, zero is known to half the digits.
    assert np.allclose(found.lengths, np.sort(sizes), rtol=AXES, atol=1e-6 * flat)
    assert np.allclose(found.axes @ found.axes.T, rotation * np.square(sizes) @ rotation.T)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_its_moments_are_those_of_a_ball_of_points() -> None:
    """Against an integral that knows no formula: points drawn evenly in the ellipsoid."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (400_000, 3))
    points = points[np.linalg.norm(points, axis=1) < 1.0] * [0.1, 0.2, 0.4]
    inertia = np.mean(np.sum(points**2, axis=1)) * np.eye(3) - points.T @ points / len(points)
    found = inertia_ellipsoid(theta_from_physical(1.0, np.zeros(3), inertia))
    assert np.allclose(found.lengths, [0.1, 0.2, 0.4], rtol=0.01)  # of 200,000 points


@pytest.mark.parametrize(
    "body",
    [
        pytest.param(np.zeros(10), id="nothing"),
        pytest.param([0, 0, 0, 0, 1, 0, 1, 0, 0, 1], id="no mass"),
        pytest.param([-1, 0, 0, 0, 1, 0, 1, 0, 0, 1], id="negative mass"),
        pytest.param([1, 0, 0, 0, -1, 0, 1, 0, 0, 1], id="negative inertia"),
        pytest.param([1, 0, 0, 0, 1, 0, 1, 0, 0, 3], id="triangle inequality"),
        pytest.param([1, 1, 0, 0, 1, 0, 0.5, 0, 0, 1], id="center too far out"),
        pytest.param([1e-300, 1, 1, 1, 1, 0, 1, 0, 0, 1], id="overflow"),
        pytest.param([1, np.nan, 0, 0, 1, 0, 1, 0, 0, 1], id="no number"),
        pytest.param([1e300] * 10, id="huge"),
    ],
)
def test_impossible_bodies_have_none(body: Array) -> None:
    assert inertia_ellipsoid(body) is None


@given(st.lists(st.floats(-1.0, 1.0), min_size=16, max_size=16))
def test_exactly_consistent_bodies_have_one(entries: list[float]) -> None:
    root = np.reshape(entries, (4, 4))
    body = from_pseudo_inertia(root @ root.T + 1e-3 * np.eye(4))
    assert inertia_ellipsoid(body) is not None
    values, vectors = np.linalg.eigh(pseudo_inertia(body))
    values[0] = -0.1
    assert inertia_ellipsoid(from_pseudo_inertia(vectors * values @ vectors.T)) is None


# ---- Surfaces of links: what the description has, else what is assumed; thinned and still there.


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


def test_robots_without_shapes_are_capsules_and_shapes_that_make_no_picture_are_told() -> None:
    found, notes = described_surfaces(small_arm(2))
    assert {each.link for each in found} == {-1, 0, 1}
    assert "capsules" in notes[0]
    for size in ("0 0 0", "1e200 1e200 1e200"):
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
