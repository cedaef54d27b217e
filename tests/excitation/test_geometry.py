"""Distances against closed forms and Pinocchio's own; bounds of their rates; what is left out."""

import pickle
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.excitation.geometry.collision import CollisionModel, proven_apart
from sdpid.excitation.geometry.measure import Measure
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
from sdpid.excitation.geometry.pairs import Pair
from sdpid.excitation.geometry.solids import Solid, robot_solids
from sdpid.robot.description.catalog import find_robot
from sdpid.robot.model.shapes import Shape
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC
from tests.helpers.shapes import BALL, ROD, distances_and_gradients, shaped_arm
from tests.helpers.strategies import SEEDS
from tests.robot.test_model import TETRAHEDRON

# Coal's distances between convex shapes, m.
ACCURACY = 1e-5

CHAIN = shaped_arm(BALL, ROD, "", BALL, '<box size="0.1 0.2 0.1"/>', spacing=0.3, kinds="rrprr")
BOX = Box(size=(0.2, 0.3, 0.4), translation=(0.4, 0.6, 0.2), rpy=(0.3, 0.2, -0.5))
ROBOTS = ("shapes", "tree", "mimic", "panda")


@cache
def chain(spacing: float = 0.5) -> sdpid.RobotModel:
    """Return four balls in a row."""
    return shaped_arm(*[BALL] * 4, spacing=spacing)


@cache
def model_of(name: str) -> CollisionModel:
    """Return the collision model of one of the robots, made once."""
    match name:
        case "shapes":
            return CollisionModel.of(CHAIN, [table(-0.6), BOX])
        case "panda":
            return CollisionModel.of(sdpid.load_robot("panda_description/panda"), [table(), BOX])
    tree = sdpid.load_robot({"tree": TREE, "mimic": TREE_MIMIC}[name])
    return CollisionModel.of(tree, [table(-3.0)], radius=0.05)


def positions(robot: sdpid.RobotModel, seed: int, count: int) -> Array:
    lower, upper = np.clip(robot.position_limits, -3.0, 3.0).T
    return np.random.default_rng(seed).uniform(lower, upper, (count, robot.n))


def column(model: CollisionModel, first: str, second: str) -> int:
    (p,) = [p for p, pair in enumerate(model.pairs) if {pair.first, pair.second} == {first, second}]
    return p


def test_balls_and_a_table_in_closed_form() -> None:
    model = CollisionModel.of(chain(0.3), [table(-0.35)])
    q = positions(model.robot, 0, 20)
    measure = Measure(model.robot, model.solids, [("l0", "l3"), ("l3", "table")])
    # The third ball sits at the third joint, whose angle does not matter.
    x = 0.3 * np.column_stack([1 + np.cos(q[:, 1]), np.zeros(20), -np.sin(q[:, 1])])
    expected = np.column_stack([np.linalg.norm(x, axis=1) - 0.2, x[:, 2] + 0.35 - 0.1])
    np.testing.assert_allclose(measure.distances(q), expected, atol=1e-9)


def test_a_box_and_a_ball_in_closed_form_also_where_they_overlap() -> None:
    cube = Box(size=(0.4, 0.4, 0.4), translation=(0.5, 0.0, 0.0), name="cube")
    rest = [np.pi / 2, 0.0]
    model = CollisionModel.of(shaped_arm("", "", BALL), [cube], rest=rest)
    angles = np.linspace(0.0, 1.5, 30)
    distances = model.distances(np.column_stack([angles, np.zeros(30)]))
    centers = 0.5 * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    q = np.abs(centers - np.array([0.5, 0, 0])) - 0.2
    outside = np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)
    expected = outside - 0.1
    assert (expected < 0).any()
    np.testing.assert_allclose(distances[:, 0], expected, atol=ACCURACY)


def test_distances_are_those_of_pinocchios_own_reading() -> None:
    """Its raw meshes are inside of their hulls: the same where the meshes are convex."""
    model = model_of("panda")
    robot, path = model.robot, find_robot("panda_description/panda")
    folder = str(path.parents[4])
    full = pin.buildModelFromUrdf(str(path))
    geometry = pin.buildGeomFromUrdf(full, str(path), pin.COLLISION, package_dirs=folder)
    data, q = full.createData(), positions(robot, 1, 20)
    found = model.distances(q)
    names = {i + 1: name for i, name in enumerate(full.names[1:])}
    joint_of = dict(zip(robot.link_names, names, strict=False))
    for p, pair in enumerate(model.pairs):
        if pair.obstacle or pair.first == "panda_link0":
            continue
        i, j = (full.getFrameId(name) for name in (pair.first, pair.second))
        ends = [full.frames[k].parentJoint for k in (i, j)]
        chosen = geometry.copy()
        chosen.removeAllCollisionPairs()
        for a, one in enumerate(chosen.geometryObjects):
            for b, other in enumerate(chosen.geometryObjects):
                if [one.parentJoint, other.parentJoint] == ends:
                    chosen.addCollisionPair(pin.CollisionPair(min(a, b), max(a, b)))
        results = chosen.createData()
        for k, configuration in enumerate(robot.configuration(q)):
            pin.computeDistances(full, data, chosen, results, configuration)
            least = min(result.min_distance for result in results.distanceResults)
            assert found[k, p] <= max(least, 0.0) + ACCURACY, (pair, joint_of)
            # These meshes are convex hulls already, to a tenth of a millimeter.
            if least > 1e-3:
                assert found[k, p] >= least - 2e-4, pair


@pytest.mark.parametrize("name", ROBOTS)
def test_gradients_are_those_of_differences(name: str) -> None:
    model = model_of(name)
    robot, step = model.robot, 1e-3
    q = positions(robot, 2, 20)
    distances, gradients = distances_and_gradients(model, q)
    np.testing.assert_allclose(distances, model.distances(q), atol=ACCURACY)
    differences = np.stack(
        [
            (model.distances(q + step * unit) - model.distances(q - step * unit)) / (2 * step)
            for unit in np.eye(robot.n)
        ],
        axis=2,
    )
    # Kinks aside, where another corner or shape becomes the nearest.
    wrong = np.abs(differences - gradients).max(axis=2) > 2e-2
    assert wrong.mean() < 0.05


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, size=st.sampled_from([1e-2, 0.3, 3.0]))
def test_distances_change_no_faster_than_the_reach_allows(
    name: str, seed: int, size: float
) -> None:
    model = model_of(name)
    rng = np.random.default_rng(seed)
    lower, upper = np.clip(model.robot.position_limits, -3.0, 3.0).T
    q = rng.uniform(lower, upper, (10, model.robot.n))
    other = np.clip(q + size * rng.uniform(-1, 1, q.shape), lower, upper)
    change = np.abs(model.distances(q) - model.distances(other))
    assert (change <= np.abs(q - other) @ model.reach.T + ACCURACY).all()


@pytest.mark.parametrize("name", ROBOTS)
def test_the_reach_is_attained_within_a_factor(name: str) -> None:
    model = model_of(name)
    _, gradients = distances_and_gradients(model, positions(model.robot, 3, 300))
    steepest = np.abs(gradients).max(axis=0)
    assert (steepest <= model.reach + 1e-9).all()
    moving = model.reach > 0
    assert np.median(steepest[moving] / model.reach[moving]) > 0.3
    # Joints that are not between the bodies do not matter at all.
    assert not steepest[~moving].any()


def test_joints_that_are_not_between_two_bodies_have_no_reach() -> None:
    model = model_of("panda")
    for (first, second), joints in {
        ("panda_link2", "panda_link5"): [2, 3, 4],
        ("panda_link4", "table"): list(range(4)),
    }.items():
        assert np.flatnonzero(model.reach[column(model, first, second)]).tolist() == joints


@pytest.mark.parametrize("name", ROBOTS)
def test_the_soft_minimum_is_below_the_least_slack_by_what_it_says(name: str) -> None:
    model, sharpness = model_of(name), 200.0
    q = positions(model.robot, 4, 30)
    slack = (model.distances(q) - model.clearances(0.03)).min(axis=1)
    solids = [solid.body for solid in model.solids]
    count = sum(solids.count(pair.first) * solids.count(pair.second) for pair in model.pairs)
    for horizon in (0.05, 0.2, 100.0):
        values, gradients = model.soft_minimum(q, sharpness, clearance=0.03, horizon=horizon)
        least = np.minimum(slack, horizon)
        assert (values <= least + ACCURACY).all()
        assert (values >= least - np.log(1 + count) / sharpness - ACCURACY).all()
    step = 1e-4
    for j, unit in enumerate(np.eye(model.robot.n)):
        ahead, _ = model.soft_minimum(q + step * unit, sharpness, clearance=0.03, horizon=horizon)
        behind, _ = model.soft_minimum(q - step * unit, sharpness, clearance=0.03, horizon=horizon)
        wrong = np.abs((ahead - behind) / (2 * step) - gradients[:, j]) > 0.05
        assert wrong.mean() < 0.15


@pytest.mark.parametrize("name", ROBOTS)
def test_capsules_around_the_solids_bound_the_distances_of_bodies(name: str) -> None:
    model = model_of(name)
    q = positions(model.robot, 6, 50)
    measure = Measure(model.robot, model.solids, [(p.first, p.second) for p in model.pairs])
    below = measure.capsules.below(q)
    for k, configuration in enumerate(model.robot.configuration(q)):
        measure.place(configuration)
        found = [measure.part(part).min_distance for part in range(len(measure.parts))]
        assert (below[k] <= np.array(found) + ACCURACY).all()


def test_neighbors_and_pairs_that_always_overlap_are_left_out_with_reasons() -> None:
    large = '<sphere radius="0.6"/>'
    model = CollisionModel.of(shaped_arm(BALL, large, "", BALL, BALL, spacing=0.2))
    reasons = {frozenset(pair[:2]): pair[2] for pair in model.left_out}
    assert reasons[frozenset({"l0", "l1"})].startswith("neighbors")
    # Across a link without a shape.
    assert reasons[frozenset({"l1", "l3"})].startswith("neighbors")
    assert "overlap at 500 of 500" in reasons[frozenset({"l1", "l4"})]
    checked = {frozenset({pair.first, pair.second}) for pair in model.pairs}
    assert checked.isdisjoint(reasons)
    assert len(checked) + len(reasons) == 6


@pytest.mark.parametrize("name", ROBOTS)
def test_pairs_that_are_proven_apart_stay_apart(name: str) -> None:
    model = model_of(name)
    proven = [(a, b, reason) for a, b, reason in model.left_out if "proven" in reason]
    assert proven
    measure = Measure(model.robot, model.solids, [(a, b) for a, b, _ in proven])
    distances = measure.distances(positions(model.robot, 7, 2000))
    for p, (_, _, reason) in enumerate(proven):
        asked = 1e-3 * float(reason.split(" mm")[0].split()[-1])
        assert distances[:, p].min() >= asked - 5e-4


def test_a_clearance_beyond_what_was_proven_is_refused() -> None:
    words = r"at most 0\.05 m; make the model with clearance=0\.2"
    refuses(DataError, words, model_of("panda").clearances, 0.2)


def test_links_that_turn_on_the_spot_above_a_table_are_left_out() -> None:
    model = CollisionModel.of(chain(), [table(-0.1)])
    reasons = {pair[:2]: pair[2] for pair in model.left_out}
    assert reasons["l0", "table"] == "the base stands still"
    assert "no motion changes it" in reasons["l1", "table"]
    assert ("l3", "table") in {(pair.first, pair.second) for pair in model.pairs}


def test_the_rest_position_is_moved_out_of_a_table_in_few_joints() -> None:
    model = CollisionModel.of(chain(), [table(-0.05)])
    assert model.rest[1] < 0.0
    assert model.rest[0] == model.rest[2] == 0.0
    assert (model.distances(model.rest[None]) >= model.clearances(0.02)).all()
    assert any("j2" in sentence and "table" in sentence for sentence in model.assumed)


def test_a_motion_that_is_there_already_need_not_begin_free() -> None:
    arm = chain()
    model = CollisionModel.of(arm, [table(-0.05)], near=np.zeros(3), free_rest=False)
    assert not model.rest.any()
    assert model.distances(model.rest[None])[0, column(model, "l3", "table")] < 0.0
    assert not any("moved" in sentence for sentence in model.assumed)


def test_a_single_joint_is_enough() -> None:
    wall = Box(size=(0.1, 2.0, 2.0), translation=(0.0, 1.2, 0.0))
    arm = shaped_arm("", '<box size="2.0 0.1 0.1"/>')
    model = CollisionModel.of(arm, [wall])
    distances, gradients = distances_and_gradients(model, np.array([[0.5], [2.0]]))
    assert gradients.shape == (2, 1, 1)
    assert (np.abs(gradients[:, 0]) <= model.reach[0]).all()
    assert (distances[:, 0] < 1.2).all()


def test_two_arms_find_a_rest_position_joint_by_joint() -> None:
    model = CollisionModel.of(sdpid.load_robot("baxter_description/baxter"))
    assert (model.distances(model.rest[None]) >= model.clearances(0.02)[None]).all()
    (sentence,) = [sentence for sentence in model.assumed if "moved" in sentence]
    assert sentence.count(" to ") <= 4


def test_pairs_are_left_out_on_demand() -> None:
    model = CollisionModel.of(chain(), [table(-0.05)], rest=np.zeros(3), ignore=[("l3", "table")])
    assert ("l3", "table", "left out as asked for") in model.left_out


def test_links_without_shapes_are_assumed_and_told() -> None:
    model = CollisionModel.of(sdpid.load_robot("denso_vp6242"), [table()])
    assert "no shapes" in model.assumed[0]
    assert "70 mm" in model.assumed[0]
    assert ("link_5", "table") in {(pair.first, pair.second) for pair in model.pairs}


def test_a_clearance_that_can_be_kept_is_asked_for_in_full() -> None:
    assert Pair(first="a", second="b", usual=0.2, farthest=0.5).clearance(0.3) == 0.3
    assert (
        Pair(first="a", second="b", usual=0.2, farthest=0.25, obstacle=True).clearance(0.2) == 0.2
    )
    assert Pair(first="a", second="b", usual=0.030, farthest=0.032).clearance(0.03) == 0.015


def test_links_built_close_to_each_other_are_asked_for_less() -> None:
    model = model_of("panda")
    p = column(model, "panda_link5", "panda_link7")
    assert 0.0 < model.clearances(0.05)[p] < 0.02
    assert any("panda_link5 and panda_link7" in sentence for sentence in model.closer(0.05))
    assert model.clearances(0.05)[column(model, "panda_link4", "table")] == 0.05


BENT = np.array([0.0, 2.0, 0.0])
NARROW = {"lower": [-0.1] * 3, "upper": [0.1] * 3}
SHELF = Box(size=(0.1, 3.0, 3.0), translation=(0.5, 0, 0))
POST = Box(size=(0.1, 0.1, 2.0), translation=(0.4, 0.0, 0.0), name="post")


@pytest.mark.parametrize(
    ("obstacles", "given", "words"),
    [
        (
            [],
            {"rest": np.zeros(5)},
            r"rest: has shape \(5,\), expected \(3,\): one number",
        ),
        ([], {"lower": [0.0]}, "limits of positions"),
        (["table"], {}, "is no Plane, Box or Mesh"),
        ([], {"ignore": [("l3", "l9")]}, "'l9' is no body"),
        ([Mesh(path="none.stl")], {}, r"obstacle 'none': mesh none\.stl cannot be read"),
        ([Box(size=(2, 2, 2))], NARROW, "contains the base 'l0'"),
        ([table(0.2)], NARROW, "contains the base 'l0'"),
        ([SHELF], NARROW, "no position was found"),
        ([table(-0.05)], {"rest": np.zeros(3)}, r"l3 and table overlap by 50\.0"),
        ([], {"rest": [0.0, 2.9, 0.0]}, "l0 and l3 overlap by"),
        ([table(-0.15)], {"rest": np.zeros(3), "clearance": 0.08}, r"table are 50\.0 apart \(80"),
        # With the second joint turned by two the third ball overlaps the first: it would be wrong
        # to take that for coarse shapes.
        ([], {"spacing": 0.17, "lower": BENT - 0.01, "upper": BENT + 0.01}, "no position was"),
        ([POST], {"spacing": 0.17, "lower": [-1e-6] * 3, "upper": [1e-6] * 3}, "and post"),
    ],
)
def test_what_cannot_be_checked_is_refused(
    obstacles: list[Any], given: dict[str, Any], words: str
) -> None:
    given = dict(given)
    arm = chain(given.pop("spacing", 0.5))
    refuses((DataError, ModelError), words, CollisionModel.of, arm, obstacles, **given)


def test_a_base_that_floats_is_refused() -> None:
    floating = sdpid.load_robot("a1_description/a1", root="free_flyer")
    refuses(ModelError, "fixed base", CollisionModel.of, floating)


def test_a_subset_and_a_pickled_copy_measure_the_same() -> None:
    model = model_of("shapes")
    q = positions(model.robot, 5, 3)
    part = model.only([2, 0])
    np.testing.assert_array_equal(part.distances(q), model.distances(q)[:, [2, 0]])
    np.testing.assert_array_equal(part.reach, model.reach[[2, 0]])
    assert len(model.searched.pairs) == sum(pair.searched for pair in model.pairs)
    copy = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(copy.distances(q), model.distances(q))
    nothing = model.only([])
    assert nothing.distances(q).shape == (3, 0)
    assert (nothing.soft_minimum(q, 1.0, horizon=0.3)[0] == 0.3).all()


# Obstacles: what lies inside, their TOML, meshes with hollows, and errors.


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
        CollisionModel.of(chain(), [obstacle], rest=[-1.0, 0.0, 0.0]) for obstacle in (box, mesh)
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


# Proofs that a distance is never small, on functions whose least value is known.


LOWER, UPPER = np.full(3, -1.0), np.array([1.0, 2.0, 3.0])
REACH = np.array([1.0, 0.5, 0.0])


def wave(q: Array) -> Array:
    """Return a function of the first two joints whose least value within the limits is 0.5."""
    return np.asarray(1.25 - 0.5 * np.sin(q[:, 0] + 0.6) - 0.25 * np.cos(2.0 * q[:, 1]))


def prove(wanted: float, *, most: int = 20_000) -> int | None:
    return proven_apart(wave, REACH, LOWER, UPPER, wanted, most=most)


def test_what_is_true_is_proven_and_what_is_not_is_not() -> None:
    assert prove(0.49) is not None
    assert prove(0.51) is None


def test_more_room_takes_fewer_distances() -> None:
    counts = [prove(wanted) for wanted in (-5.0, 0.0, 0.4, 0.49)]
    assert None not in counts
    assert counts[0] == 1
    assert counts == sorted(counts, key=lambda count: count or 0)


def test_it_gives_up() -> None:
    assert prove(0.4999, most=100) is None


@pytest.mark.parametrize("reach", [np.array([np.inf, 0.5, 0.0]), np.array([1.0, np.inf, 0.0])])
def test_no_bound_no_proof(reach: Array) -> None:
    assert proven_apart(wave, reach, LOWER, UPPER, 0.0, most=1000) is None


def test_joints_without_limits_and_joints_that_do_not_move() -> None:
    endless = np.array([1.0, np.inf, 3.0])
    assert proven_apart(wave, REACH, LOWER, endless, 0.0, most=1000) is None
    # The third joint does not matter; the second stands where the function is largest.
    half = 0.5 * np.pi
    lower, upper = np.array([-1.0, half, -np.inf]), np.array([1.0, half, np.inf])
    assert proven_apart(wave, REACH, lower, upper, 0.99, most=1000) is not None
    assert proven_apart(wave, REACH, lower, upper, 1.01, most=1000) is None


# Solids of links: hulls of meshes, shapes of fixed links, and what is assumed.


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
        (Shape("box", [0.2, 0.3, 0.4]), 0.0),
        (Shape("sphere", [0.2]), 0.2),
        (Shape("capsule", [0.1, 0.5]), 0.1),
        (Shape("cylinder", [0.1, 0.5]), 0.0),
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
