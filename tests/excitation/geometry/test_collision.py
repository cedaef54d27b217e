"""Distances against closed forms and Pinocchio's own; bounds of their rates; what is left out."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.geometry.measure import Measure
from sdpid.excitation.geometry.obstacles import Box, Obstacle, table
from sdpid.excitation.geometry.pairs import Pair
from sdpid.robot.description.catalog import find_robot
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC
from tests.helpers.shapes import BALL, ROD, distances_and_gradients, shaped_arm
from tests.helpers.strategies import SEEDS

# Coal's distances between convex shapes, m.
ACCURACY = 1e-5

CHAIN = shaped_arm(BALL, ROD, "", BALL, '<box size="0.1 0.2 0.1"/>', spacing=0.3, kinds="rrprr")
BOX = Box(size=(0.2, 0.3, 0.4), translation=(0.4, 0.6, 0.2), rpy=(0.3, 0.2, -0.5))
ROBOTS = {
    "shapes": CollisionModel.of(CHAIN, [table(-0.6), BOX]),
    "tree": CollisionModel.of(sdpid.load_robot(TREE), [table(-3.0)], radius=0.05),
    "mimic": CollisionModel.of(sdpid.load_robot(TREE_MIMIC), [table(-3.0)], radius=0.05),
    "panda": CollisionModel.of(sdpid.load_robot("panda_description/panda"), [table(), BOX]),
}


def positions(robot: sdpid.RobotModel, seed: int, count: int) -> Array:
    lower, upper = np.clip(robot.position_limits, -3.0, 3.0).T
    return np.random.default_rng(seed).uniform(lower, upper, (count, robot.n))


def column(model: CollisionModel, first: str, second: str) -> int:
    (p,) = [p for p, pair in enumerate(model.pairs) if {pair.first, pair.second} == {first, second}]
    return p


def test_balls_and_a_table_in_closed_form() -> None:
    model = CollisionModel.of(shaped_arm(BALL, BALL, BALL, BALL, spacing=0.3), [table(-0.35)])
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
    model = ROBOTS["panda"]
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
    model = ROBOTS[name]
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
    model = ROBOTS[name]
    rng = np.random.default_rng(seed)
    lower, upper = np.clip(model.robot.position_limits, -3.0, 3.0).T
    q = rng.uniform(lower, upper, (10, model.robot.n))
    other = np.clip(q + size * rng.uniform(-1, 1, q.shape), lower, upper)
    change = np.abs(model.distances(q) - model.distances(other))
    assert (change <= np.abs(q - other) @ model.reach.T + ACCURACY).all()


@pytest.mark.parametrize("name", ROBOTS)
def test_the_reach_is_attained_within_a_factor(name: str) -> None:
    model = ROBOTS[name]
    _, gradients = distances_and_gradients(model, positions(model.robot, 3, 300))
    steepest = np.abs(gradients).max(axis=0)
    assert (steepest <= model.reach + 1e-9).all()
    moving = model.reach > 0
    assert np.median(steepest[moving] / model.reach[moving]) > 0.3
    # Joints that are not between the bodies do not matter at all.
    assert not steepest[~moving].any()


def test_joints_that_are_not_between_two_bodies_have_no_reach() -> None:
    model = ROBOTS["panda"]
    p = column(model, "panda_link2", "panda_link5")
    assert np.flatnonzero(model.reach[p]).tolist() == [2, 3, 4]
    assert np.flatnonzero(model.reach[column(model, "panda_link4", "table")]).tolist() == [
        0,
        1,
        2,
        3,
    ]


@pytest.mark.parametrize("name", ROBOTS)
def test_the_soft_minimum_is_below_the_least_slack_by_what_it_says(name: str) -> None:
    model, sharpness = ROBOTS[name], 200.0
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
    model = ROBOTS[name]
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
    model = ROBOTS[name]
    proven = [(a, b, reason) for a, b, reason in model.left_out if "proven" in reason]
    assert proven
    measure = Measure(model.robot, model.solids, [(a, b) for a, b, _ in proven])
    distances = measure.distances(positions(model.robot, 7, 2000))
    for p, (_, _, reason) in enumerate(proven):
        asked = 1e-3 * float(reason.split(" mm")[0].split()[-1])
        assert distances[:, p].min() >= asked - 5e-4


def test_a_clearance_beyond_what_was_proven_is_refused() -> None:
    with pytest.raises(DataError, match=r"at most 0\.05 m; make the model with clearance=0\.2"):
        ROBOTS["panda"].clearances(0.2)


def test_links_that_turn_on_the_spot_above_a_table_are_left_out() -> None:
    model = CollisionModel.of(shaped_arm(BALL, BALL, BALL, BALL), [table(-0.1)])
    reasons = {pair[:2]: pair[2] for pair in model.left_out}
    assert reasons["l0", "table"] == "the base stands still"
    assert "no motion changes it" in reasons["l1", "table"]
    assert ("l3", "table") in {(pair.first, pair.second) for pair in model.pairs}


def test_the_rest_position_is_moved_out_of_a_table_in_few_joints() -> None:
    model = CollisionModel.of(shaped_arm(BALL, BALL, BALL, BALL), [table(-0.05)])
    assert model.rest[1] < 0.0
    assert model.rest[0] == model.rest[2] == 0.0
    assert (model.distances(model.rest[None]) >= model.clearances(0.02)).all()
    assert any("j2" in sentence and "table" in sentence for sentence in model.assumed)


def test_a_given_rest_position_that_is_not_free_is_refused_with_depth() -> None:
    arm = shaped_arm(BALL, BALL, BALL, BALL)
    with pytest.raises(ModelError, match=r"l3 and table overlap by 50\.0"):
        CollisionModel.of(arm, [table(-0.05)], rest=np.zeros(3))
    refuses(ModelError, "l0 and l3 overlap by", CollisionModel.of, arm, rest=[0.0, 2.9, 0.0])
    CollisionModel.of(arm, [table(-0.15)], rest=np.zeros(3))
    with pytest.raises(ModelError, match=r"l3 and table are 50\.0 apart \(80\.0\)"):
        CollisionModel.of(arm, [table(-0.15)], rest=np.zeros(3), clearance=0.08)


def test_a_motion_that_is_there_already_need_not_begin_free() -> None:
    arm = shaped_arm(BALL, BALL, BALL, BALL)
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


def test_narrow_limits_do_not_make_a_collision_look_like_coarse_shapes() -> None:
    arm = shaped_arm(BALL, BALL, BALL, BALL, spacing=0.17)
    # With the second joint turned by two the third ball overlaps the first.
    bent = np.array([0.0, 2.0, 0.0])
    with pytest.raises(ModelError, match="no position was found"):
        CollisionModel.of(arm, lower=bent - 0.01, upper=bent + 0.01)
    post = Box(size=(0.1, 0.1, 2.0), translation=(0.4, 0.0, 0.0), name="post")
    with pytest.raises(ModelError, match="and post"):
        CollisionModel.of(arm, [post], lower=[-1e-6] * 3, upper=[1e-6] * 3)


def test_two_arms_find_a_rest_position_joint_by_joint() -> None:
    model = CollisionModel.of(sdpid.load_robot("baxter_description/baxter"))
    assert (model.distances(model.rest[None]) >= model.clearances(0.02)[None]).all()
    (sentence,) = [sentence for sentence in model.assumed if "moved" in sentence]
    assert sentence.count(" to ") <= 4


def test_pairs_are_left_out_on_demand() -> None:
    arm = shaped_arm(BALL, BALL, BALL, BALL)
    model = CollisionModel.of(arm, [table(-0.05)], rest=np.zeros(3), ignore=[("l3", "table")])
    assert ("l3", "table", "left out as asked for") in model.left_out
    refuses(ModelError, "'l9' is no body", CollisionModel.of, arm, ignore=[("l3", "l9")])


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
    model = ROBOTS["panda"]
    p = column(model, "panda_link5", "panda_link7")
    assert 0.0 < model.clearances(0.05)[p] < 0.02
    assert any("panda_link5 and panda_link7" in sentence for sentence in model.closer(0.05))
    assert model.clearances(0.05)[column(model, "panda_link4", "table")] == 0.05


@pytest.mark.parametrize(
    ("obstacle", "match"),
    [
        (Box(size=(2, 2, 2)), "contains the base 'l0'"),
        (table(0.2), "contains the base 'l0'"),
        (Box(size=(0.1, 3.0, 3.0), translation=(0.5, 0, 0)), "no position was found"),
    ],
)
def test_obstacles_that_leave_no_room_are_refused(obstacle: Obstacle, match: str) -> None:
    arm = shaped_arm(BALL, BALL, BALL, BALL)
    with pytest.raises(ModelError, match=match):
        CollisionModel.of(arm, [obstacle], lower=[-0.1] * 3, upper=[0.1] * 3)


def test_bad_arguments_are_named() -> None:
    arm = shaped_arm(BALL, BALL, BALL)
    refuses(DataError, "rest: 5 numbers, 'chain' has 2", CollisionModel.of, arm, rest=np.zeros(5))
    refuses(DataError, "limits of positions", CollisionModel.of, arm, lower=[0.0])
    with pytest.raises(DataError, match="is no Plane, Box or Mesh"):
        CollisionModel.of(arm, ["table"])  # type: ignore[list-item]
    with pytest.raises(ModelError, match="fixed base"):
        CollisionModel.of(sdpid.load_robot("a1_description/a1", root="free_flyer"))


def test_a_subset_and_a_pickled_copy_measure_the_same() -> None:
    model = ROBOTS["shapes"]
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
