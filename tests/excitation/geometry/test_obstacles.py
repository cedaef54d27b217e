"""Obstacles: what lies inside, their TOML, meshes with hollows, and errors."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sdpid.errors import DataError, ModelError
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.geometry.obstacles import (
    Box,
    Mesh,
    Obstacle,
    Plane,
    named_apart,
    obstacles_from_toml,
    obstacles_to_dict,
    table,
    wall,
)
from tests.helpers.refusals import refuses
from tests.helpers.shapes import BALL, distances_and_gradients, shaped_arm


def box_file(path: Path, size: float, *, scale: float = 1.0, open_top: bool = False) -> Path:
    """Write an OBJ of a cube about the origin, optionally without its upper side."""
    corners = [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    sides = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    lines = [f"v {' '.join(str(scale * size * c) for c in corner)}" for corner in corners]
    for side in sides[: 5 if open_top else 6]:
        a, b, c, d = side.split()
        lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_table_and_walls_take_what_lies_behind_them() -> None:
    below = table(0.1)
    assert below.contains(np.array([[5.0, 5.0, 0.05], [0.0, 0.0, 0.11]])).tolist() == [True, False]
    behind = wall(0.3, "-x")
    assert behind.name == "wall -x"
    assert behind.contains(np.array([[-0.31, 9.0, 0.0], [-0.29, 0, 0]])).tolist() == [True, False]
    skew = wall(1.0, (3.0, 4.0, 0.0))
    assert skew.contains(np.array([[0.7, 0.9, 0.0], [0.5, 0.8, 0.0]])).tolist() == [True, False]


@pytest.mark.parametrize("convex", [False, True])
def test_boxes_and_meshes_of_boxes_agree(tmp_path: Path, convex: bool) -> None:
    place: dict[str, Any] = {"translation": (0.7, 0.3, 0.1), "rpy": (0.4, -0.2, 1.0)}
    box = Box(size=(0.3, 0.3, 0.3), **place)
    path = box_file(tmp_path / "cube.obj", 0.3, scale=1000.0)
    mesh = Mesh(path=path, scale=0.001, convex=convex, **place)
    assert mesh.name == "cube"
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (300, 3)) + place["translation"]
    inside = box.contains(points)
    assert 0 < inside.sum() < 300
    assert (mesh.contains(points) == inside).all()

    models = [
        CollisionModel.of(shaped_arm(BALL, BALL, BALL, BALL), [obstacle], rest=[-1.0, 0.0, 0.0])
        for obstacle in (box, mesh)
    ]
    q = np.random.default_rng(1).uniform(-2, 2, (100, 3))
    (first, one), (second, other) = (distances_and_gradients(model, q) for model in models)
    free = (first > 0.0).all(axis=1)
    np.testing.assert_allclose(second[free], first[free], atol=1e-5)
    np.testing.assert_allclose(other[free], one[free], atol=1e-2)
    np.testing.assert_allclose(models[0].reach, models[1].reach, rtol=1e-6)
    values = [model.soft_minimum(q[free], 100.0)[0] for model in models]
    np.testing.assert_allclose(*values, atol=1e-5)


def test_a_mesh_leaves_its_hollow_free_and_its_hull_does_not(tmp_path: Path) -> None:
    path = box_file(tmp_path / "crate.obj", 0.6, open_top=True)
    arm = shaped_arm("", "", BALL)
    far = CollisionModel.of(arm, [Mesh(path=path, translation=(0.5, 0, 0.0))], rest=[2.0, 0.0])
    assert far.distances([[0.0, 0.0]])[0, 0] == pytest.approx(0.2, abs=1e-5)
    hull = Mesh(path=path, translation=(0.5, 0, 0.0), convex=True)
    full = CollisionModel.of(arm, [hull], rest=[2.0, 0.0])
    assert full.distances([[0.0, 0.0]])[0, 0] == pytest.approx(-0.4, abs=1e-5)


def test_a_link_at_rest_within_a_closed_mesh_is_refused(tmp_path: Path) -> None:
    path = box_file(tmp_path / "cell.obj", 0.6)
    cell = Mesh(path=path, translation=(0.5, 0, 0))
    with pytest.raises(ModelError, match="'cell' surrounds 'l2' at the rest position"):
        CollisionModel.of(shaped_arm("", "", BALL), [cell], rest=[0.0, 0.0])


def test_toml_reads_every_kind_and_writes_what_it_reads(tmp_path: Path) -> None:
    box_file(tmp_path / "part.obj", 0.1)
    file = tmp_path / "cell.toml"
    file.write_text(
        """
        [[table]]
        height = -0.02
        [[wall]]
        distance = 0.4
        direction = "-x"
        [[plane]]
        point = [0, 0, 2]
        normal = [0, 0, -2]
        name = "ceiling"
        [[box]]
        size = [0.1, 0.2, 0.3]
        translation = [1, 0, 0]
        [[mesh]]
        path = "part.obj"
        translation = [0, 1, 0]
        """
    )
    found = obstacles_from_toml(file)
    assert [obstacle.name for obstacle in found] == ["table", "wall -x", "ceiling", "box", "part"]
    assert found[0] == Plane(point=(0, 0, -0.02), normal=(0, 0, 1), name="table")
    assert found[2] == Plane(point=(0, 0, 2), normal=(0, 0, -1), name="ceiling")
    again = obstacles_from_toml(obstacles_to_dict(found))
    assert sorted(map(str, again)) == sorted(map(str, found))


def test_equal_names_are_told_apart() -> None:
    boxes: list[Obstacle] = [Box(size=(1, 1, 1)), Box(size=(2, 1, 1)), table()]
    assert [o.name for o in named_apart(boxes, ["table"])] == ["box", "box 2", "table 2"]


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ({"ball": [{}]}, "'ball' is no obstacle; known are plane, box"),
        ({"box": 3}, r"'box' is 3; write it as \[\[box\]\]"),
        ({"box": [{}]}, r"\[\[box\]\].*size"),
        ({"box": [{"size": [1, 1, 1], "color": "red"}]}, r"\[\[box\]\].*color"),
        ({"box": [{"size": [1, 0, 1]}]}, "every edge is longer than 0 m"),
        ({"box": [{"size": [1, 1]}]}, "size: .* give 3 numbers"),
        ({"plane": [{"normal": [0, 0, 0]}]}, "the normal is zero"),
        ({"mesh": [{"path": "x.stl", "scale": 0}]}, "no factor is 0"),
        ({"wall": [{"distance": 1, "direction": "up"}]}, "direction 'up'"),
        ({"wall": [{"distance": "near"}]}, r"\[\[wall\]\].*'near'"),
        ({"table": [{"height": float("nan")}]}, "not finite"),
    ],
)
def test_bad_obstacles_are_named(content: dict[str, Any], match: str) -> None:
    refuses(DataError, match, obstacles_from_toml, content)


def test_a_mesh_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"obstacle 'none': mesh .*none\.stl cannot be read"):
        CollisionModel.of(shaped_arm(BALL, BALL, BALL), [Mesh(path=tmp_path / "none.stl")])
