"""Base parameters: the rule, the rank and the names, at states that they were not found at."""

import csv

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.description.dh_table import DhJoint, DhTable
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    SigmoidFriction,
    Stribeck,
)
from sdpid.robot.model.base_parameters import BaseParameters, generic_states
from tests.helpers.data import base_of, friction_model, full_regressor, random_bodies
from tests.helpers.refusals import refuses
from tests.helpers.robots import (
    TREE,
    TREE_MIMIC,
    TREE_MIMIC_NO_OFFSET,
    pendulum,
    planar_arm,
    small_arm,
)
from tests.helpers.strategies import SEEDS, dh_tables
from tests.helpers.tolerances import REGROUPING

FIELD_ORDER = ("xx", "xy", "xz", "yy", "yz", "zz", "mx", "my", "mz", "m")
Term = str | FrictionTerm

# At most one of a line: two would define the same parameters.
CHOICES: tuple[tuple[Term | None, ...], ...] = (
    (None, "coulomb", Coulomb(width=0.02), Coulomb(width=0.5)),
    (None, "viscous"),
    (None, "offset"),
    (None, "rotor_inertia"),
    (None, "asymmetric_coulomb", AsymmetricCoulomb(width=0.02)),
    (None, Stribeck(0.3), Stribeck(0.01), Stribeck(0.05, width=0.01)),
    (None, SigmoidFriction(0.02), SigmoidFriction(0.3)),
    (None, "square_root"),
)
TREES = {"tree": TREE, "mimic": TREE_MIMIC, "follower": TREE_MIMIC_NO_OFFSET}
ROBOTS = {
    "vertical slide": sdpid.RobotModel.from_mdh(
        (DhJoint(kind="prismatic"), DhJoint(alpha=np.pi / 2), DhJoint(d=0.3))
    ),
    "planar": planar_arm(),
    "two": small_arm(2),
    "arm": small_arm(4),
    "tree": sdpid.load_robot(TREE),
    "mimic": sdpid.load_robot(TREE_MIMIC),
    "floating": sdpid.load_robot(TREE, root="free_flyer"),
    "denso": sdpid.load_robot("denso_vp6242"),
}


def scan_order(base: BaseParameters) -> list[str]:
    inertial = [n for n in base.theta_names if n.split("_")[0] in FIELD_ORDER]
    listed = [f"{p}_{i + 1}" for i in range(len(inertial) // 10) for p in FIELD_ORDER]
    return listed + [n for n in base.theta_names if n not in set(inertial)]


def check(robot: sdpid.RobotModel, terms: tuple[Term, ...], seed: int, count: int = 400) -> Array:
    """Check the rule at states fast and slow; return the rows of what is kept."""
    base = base_of(robot, *terms)
    q, v, a = generic_states(robot, count, seed)
    speeds = 10.0 ** np.random.default_rng(seed).uniform(-3.0, 1.0, (count, 1))
    v = np.where(np.arange(count)[:, None] < count // 2, 1.0, speeds) * v
    W = full_regressor(robot, (q, v, a), terms)
    W = W.reshape(-1, W.shape[2])
    # What the scan drops below its tolerance (axes off by milliradians) is missing from the
    # effort in that proportion, and reported: `largest_dropped` is rounding for most robots.
    share = REGROUPING + 10.0 * base.largest_dropped
    error = np.abs(W[:, base.kept] @ base.matrix - W).max()
    assert error <= share * max(np.abs(W).max(), 1.0)
    # The kept columns of B are the identity, exactly, and columns fold only into earlier ones.
    np.testing.assert_array_equal(base.matrix[:, base.kept], np.eye(base.count))
    order = {name: i for i, name in enumerate(scan_order(base))}
    for i, j in np.argwhere(base.matrix != 0.0):
        assert order[base.theta_names[base.kept[i]]] <= order[base.theta_names[j]]
    for name, row in zip(base.names, base.matrix, strict=True):
        assert ("r" in name.rstrip("0123456789_")[1:]) == (np.count_nonzero(row) > 1)
    assert len(set(base.names)) == base.count
    return W[:, base.kept]


@given(
    st.tuples(*(st.sampled_from(c) for c in CHOICES)),
    st.booleans(),
    st.sampled_from(sorted(ROBOTS.keys() - {"denso"})),
)
@settings(max_examples=50, deadline=None)
def test_every_combination(chosen: tuple[Term | None, ...], coupled: bool, place: str) -> None:
    robot = ROBOTS[place]
    terms = tuple(term for term in chosen if term is not None)
    if coupled:
        terms += (Coupling(robot.joint_names[-2], robot.joint_names[-1], width=0.02),)
    kept = check(robot, terms, 3)
    # What is kept is independent at these states, which the scan has not seen.
    singular = np.linalg.svd(kept / np.linalg.norm(kept, axis=0), compute_uv=False)
    assert singular[-1] > 1e-5


@given(dh_tables(most=5, clear=True), SEEDS)
@settings(max_examples=20)
def test_regrouping_holds_at_fresh_states(table: DhTable, seed: int) -> None:
    check(sdpid.RobotModel.from_mdh(table), ("coulomb", "viscous", "rotor_inertia"), seed, 24)


@pytest.mark.parametrize(
    ("source", "root"),
    [
        ("tree", None),
        ("mimic", None),
        ("tree", "free_flyer"),
        ("follower", "free_flyer"),
        ("solo12", None),
        ("solo12", "free_flyer"),
        ("panda", None),
        ("romeo_small", None),
    ],
)
def test_trees_floating_bases_and_humanoids(source: str, root: str | None) -> None:
    robot = sdpid.load_robot(TREES.get(source, source), root=root)
    check(robot, ("coulomb", "rotor_inertia"), 7, 24)
    base = base_of(robot, "coulomb", "rotor_inertia")
    # The rank is the numerical one: the singular values fall off a cliff there.
    singular = base.singular_values
    assert singular[base.count - 1] > 1e-4 * singular[0]
    assert (singular[base.count :] < 1e-9 * singular[0]).all()


def test_denso_has_table_ivs_names_in_its_order() -> None:
    base = base_of(ROBOTS["denso"], "coulomb", "viscous")
    text = (bundled_folder("denso_vp6242") / "table_iv.csv").read_text(encoding="utf-8")
    rows = [(row["parameter"], row["unit"]) for row in csv.DictReader(text.splitlines())]
    assert list(zip(base.names, base.units, strict=True)) == rows
    assert base.count == 48
    # What no motion shows at all, beside what is regrouped.
    gone = {f"{p}_1" for p in FIELD_ORDER if p != "zz"} | {"m_2", "mz_2"}
    assert set(base.eliminated) == gone
    assert base.explain().startswith("48 base parameters of 72 standard ones.")
    assert len(base.singular_values) == 72
    assert base.singular_values[47] > 1e-2
    assert base.singular_values[48] < 1e-12
    assert base.largest_dropped < base.tolerance < base.smallest_kept
    refuses(KeyError, "no base parameter 'zz1'", base.expression, "zz1")
    # Tilted gravity shows the first link's center of mass.
    tilted = sdpid.load_robot("denso_vp6242", gravity=(3.0, 0.0, -9.0))
    assert base_of(tilted).count == base_of(ROBOTS["denso"]).count + 2


BOTH_SIDES = (Coulomb(width=0.1), AsymmetricCoulomb(width=0.1))


@pytest.mark.parametrize(
    ("name", "expression", "robot", "terms"),
    [
        ("xxr2", "xx_2 - yy_2 - 0.0441*m_3 - 0.0441*m_4 - 0.0441*m_5 - 0.0441*m_6", "denso", ()),
        ("mxr3", "mx_3 - 0.075*m_4 - 0.075*m_5 - 0.075*m_6", "denso", ()),
        ("zzr5", "zz_5 + 0.0049*m_6 + 0.14*mz_6 + yy_6", "denso", ()),
        ("Fs3", "Fs3", "denso", ("coulomb",)),
        # Each link of a planar arm shows zz, mx, my; masses fold into the link before.
        ("zzr1", "zz_1 + 0.16*m_2", "planar", ()),
        ("mxr1", "mx_1 + 0.4*m_2", "planar", ()),
        # Duplicates fold.
        ("Fsr2", "Fs2 + Fsn2", "two", BOTH_SIDES),
        ("Fspr2", "Fsp2 - Fsn2", "two", BOTH_SIDES),
        ("Fsr1", "Fs1 + Fsg1", "two", (Coulomb(width=0.1), SigmoidFriction(0.1))),
        # A slide's mass shows as a + g, its rotor as a, its offset as 1: two for three.
        ("mr1", "m_1 + m_2 + m_3 + Ia1", "vertical slide", ("offset", "rotor_inertia")),
        ("For1", "Fo1 - 9.81*Ia1", "vertical slide", ("offset", "rotor_inertia")),
    ],
)
def test_regroupings_are_khalils(name: str, expression: str, robot: str, terms: tuple[Term, ...]):
    assert base_of(ROBOTS[robot], *terms).expression(name) == expression


class Stribeck2(Stribeck):
    """A second peak."""

    symbol = "Fsu"


def test_names_of_small_robots() -> None:
    assert base_of(pendulum(), "coulomb", "viscous").names == ("zz1", "mx1", "my1", "Fs1", "Fv1")
    assert base_of(planar_arm()).names == ("zzr1", "mxr1", "my1", "zz2", "mx2", "my2")
    slide, two = ROBOTS["vertical slide"], ROBOTS["two"]
    assert "Ia1" not in base_of(slide, "offset", "rotor_inertia").names
    assert {"mr1", "Fo1"} <= set(base_of(slide, "offset").names)
    same = base_of(two, Coulomb(width=0.1), SigmoidFriction(0.1))
    assert not any(n.startswith("Fsg") for n in same.names)
    # What bends at low speed is no duplicate, though at generic speeds all of these are signs.
    for speed in (1e-3, 0.02, 0.5):
        names = base_of(
            two, "coulomb", SigmoidFriction(speed), Stribeck(speed), Stribeck2(speed / 2)
        ).names
        assert {f"{symbol}{j}" for symbol in ("Fs", "Fsg", "Fst", "Fsu") for j in (1, 2)} <= {
            *names
        }
    # As 1.5708 − pi/2 leaves axes, the rank is that of parallel ones, and the gap is shown.
    rows = (DhJoint(alpha=np.pi / 2), DhJoint(d=0.4, alpha=1.5708 - np.pi / 2))
    base = base_of(sdpid.RobotModel.from_mdh(rows))
    assert base.count == base_of(planar_arm()).count
    assert 1e-7 < base.largest_dropped < base.tolerance


def test_a_floating_base_shows_all_of_its_first_link() -> None:
    base = base_of(ROBOTS["floating"], "coulomb")
    leading = [base.theta_names[k] for k in base.kept]
    assert {f"{p}_1" for p in FIELD_ORDER} <= set(leading)
    # Friction stands with the link that its joint moves; the base has none.
    assert base.names.index("Fs1") > max(i for i, n in enumerate(leading) if n.endswith("_2"))
    assert base.names.index("Fs1") < min(i for i, n in enumerate(leading) if n.endswith("_3"))


def test_they_hold_tilt_and_friction_of_the_load() -> None:
    arm = ROBOTS["arm"]
    bodies = random_bodies(arm, 4)
    terms = ("coulomb", "viscous", Tilt(bodies), LoadFriction(bodies))
    base = base_of(arm, *terms)
    assert {"Gx", "Gy", "Fl1", "Fl4"} <= set(base.names)
    units = dict(zip(base.names, base.units, strict=True))
    assert (units["Gx"], units["Fl1"]) == ("rad", "1")
    # At an instant without a position they have no columns.
    plain = friction_model(arm, terms).columns(np.ones((1, 4)), np.zeros((1, 4)))
    assert not plain[:, :, 8:].any()
