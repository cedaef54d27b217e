"""Base parameters: the rule, the names, and the regrouping at states it was not found at."""

import csv
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings

from sdpid._common.arrays import Array
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.description.dh_table import DhJoint, DhTable
from sdpid.robot.friction.terms import Coupling
from sdpid.robot.model.base_parameters import BaseParameters, generic_states, structural_base
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import friction_model, full_regressor, random_links
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


def base_of(robot: RobotModel, *terms: str | Coupling) -> BaseParameters:
    return structural_base(robot, friction_model(robot, terms))


@pytest.fixture(scope="module")
def table_iv(denso: RobotModel) -> BaseParameters:
    return base_of(denso, "coulomb", "viscous")


def test_denso_has_table_ivs_names_in_its_order(table_iv: BaseParameters) -> None:
    with (bundled_folder("denso_vp6242") / "table_iv.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert table_iv.names == tuple(row["parameter"] for row in rows)
    assert table_iv.units == tuple(row["unit"] for row in rows)
    assert table_iv.count == 48


def test_denso_eliminates_what_the_paper_eliminates(table_iv: BaseParameters) -> None:
    """Gone are yy, mz, m of links 2 to 6 and all of link 1 but zz."""
    leading = {table_iv.theta_names[k] for k in table_iv.kept}
    gone = {n for n in table_iv.theta_names if "_" in n and n not in leading}
    expected = {f"{p}_{i}" for i in range(2, 7) for p in ("yy", "mz", "m")}
    expected |= {f"{p}_1" for p in FIELD_ORDER if p != "zz"}
    assert gone == expected
    # Of these, what no motion shows at all:
    assert set(table_iv.eliminated) == {f"{p}_1" for p in FIELD_ORDER if p != "zz"} | {
        "m_2",
        "mz_2",
    }


@pytest.mark.parametrize(
    ("name", "expression"),
    [
        (
            "zzr1",
            "zz_1 + yy_2 + 0.0441*m_3 + yy_3 + 0.049725*m_4 + 0.049725*m_5 + 0.049725*m_6",
        ),
        ("xxr2", "xx_2 - yy_2 - 0.0441*m_3 - 0.0441*m_4 - 0.0441*m_5 - 0.0441*m_6"),
        ("mxr3", "mx_3 - 0.075*m_4 - 0.075*m_5 - 0.075*m_6"),
        ("zzr5", "zz_5 + 0.0049*m_6 + 0.14*mz_6 + yy_6"),
        ("xxr6", "xx_6 - yy_6"),
        ("zz6", "zz_6"),
        ("Fs3", "Fs3"),
    ],
)
def test_denso_regroupings_are_khalils(
    table_iv: BaseParameters, name: str, expression: str
) -> None:
    assert table_iv.expression(name) == expression


def test_an_unknown_base_parameter(table_iv: BaseParameters) -> None:
    refuses(KeyError, "no base parameter 'zz1'", table_iv.expression, "zz1")


def test_the_rank_decision_is_explained(table_iv: BaseParameters) -> None:
    text = table_iv.explain()
    assert text.startswith("48 base parameters of 72 standard ones.")
    singular = table_iv.singular_values
    assert len(singular) == 72
    assert singular[47] > 1e-2
    assert singular[48] < 1e-12
    assert table_iv.largest_dropped < table_iv.tolerance < table_iv.smallest_kept


def test_a_rotor_inertia_folds_into_zzr1(denso: RobotModel) -> None:
    base = base_of(denso, "coulomb", "viscous", "rotor_inertia")
    assert "Ia1" not in base.names
    assert "Ia2" not in base.names
    assert base.names[-3:] == ("Fs6", "Fv6", "Ia6")
    assert base.expression("zzr1").endswith("+ Ia1")
    assert base.expression("zzr2").endswith("+ Ia2")
    assert base.count == 52


def test_a_coupling_is_listed_with_its_later_joint(denso: RobotModel) -> None:
    base = base_of(denso, "coulomb", Coupling("joint_5", "joint_6"))
    assert base.names[-4:] == ("Fs6", "Ia5_6", "Fv5_6", "Fs5_6")


def test_dependent_friction_terms_are_regrouped(denso: RobotModel) -> None:
    """An offset and two one-sided Coulomb frictions are two parameters, not three."""
    base = base_of(denso, "offset", "asymmetric_coulomb")
    listed = [n for n in base.names if n.startswith("F") and n.endswith("4")]
    assert listed == ["For4", "Fspr4"]
    assert base.expression("For4") == "Fo4 - Fsn4"
    assert base.expression("Fspr4") == "Fsp4 + Fsn4"


def fresh_rows(robot: RobotModel, terms: tuple[str, ...], seed: int) -> Array:
    """Return full regressor rows at states that the scan has not seen."""
    rows = full_regressor(robot, generic_states(robot, 12, seed), terms)
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
    robot = load_robot(source, root=root)  # type: ignore[arg-type]
    terms = ("coulomb", "rotor_inertia")
    base = base_of(robot, *terms)
    if root is None:
        check_rule(robot, base, terms, 7)
    else:
        q, v, a = generic_states(robot, 12, 7)
        W = np.concatenate(
            [robot.regressor(q, v, a), friction_model(robot, terms).columns(v, a)], axis=2
        ).reshape(12 * robot.n, -1)
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


@given(dh_tables(most=4, clear=True), SEEDS)
@settings(max_examples=15)
def test_rank_is_that_of_the_singular_values(table: DhTable, seed: int) -> None:
    robot = RobotModel.from_mdh(table)
    base = base_of(robot, "viscous")
    rows = full_regressor(robot, generic_states(robot, 100, seed), ("viscous",))
    W = rows.reshape(-1, rows.shape[2])
    norms = np.linalg.norm(W, axis=0)
    visible = norms > 1e-9 * norms.max()
    singular = np.linalg.svd(W / np.where(visible, norms, 1.0), compute_uv=False)
    assert base.count == np.sum(singular > 1e-6 * singular[0])


def test_right_angles_written_with_five_digits_change_no_choice(denso: RobotModel) -> None:
    rounded = denso.urdf.replace("1.5707963267948966", "1.5708")
    assert rounded != denso.urdf
    base, exact = (base_of(r, "viscous") for r in (load_robot(rounded), denso))
    np.testing.assert_array_equal(base.kept, exact.kept)
    np.testing.assert_allclose(base.matrix, exact.matrix, rtol=0, atol=1e-5)


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


def test_a_vertical_first_axis_shows_its_moment_alone() -> None:
    arm = small_arm(3)
    base = base_of(arm)
    first = [base.theta_names[k] for k in base.kept if base.theta_names[k].endswith("_1")]
    assert first == ["zz_1"]


def test_tilted_gravity_shows_the_first_links_center_of_mass(denso: RobotModel) -> None:
    tilted = load_robot("denso_vp6242", gravity=(3.0, 0.0, -9.0))
    assert base_of(tilted).count == base_of(denso).count + 2


def test_the_same_robot_gives_the_same_matrix_bit_for_bit(table_iv: BaseParameters) -> None:
    again = base_of(load_robot("denso_vp6242"), "coulomb", "viscous")
    np.testing.assert_array_equal(again.matrix, table_iv.matrix)
    np.testing.assert_array_equal(again.kept, table_iv.kept)
    with pytest.raises(ValueError, match="read-only"):
        again.matrix[0, 0] = 2.0


def test_the_random_state_of_the_process_has_no_say(table_iv: BaseParameters) -> None:
    code = (
        "import numpy as np, random; np.random.seed(5); random.seed(5);"
        "from sdpid.robot.model.load import load_robot;"
        "from sdpid.robot.model.base_parameters import structural_base;"
        "from sdpid.robot.friction.model import FrictionModel;"
        "r = load_robot('denso_vp6242');"
        "f = FrictionModel.from_terms(('coulomb', 'viscous'), r.joint_names);"
        "b = structural_base(r, f);"
        "print(*b.names)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert tuple(done.stdout.split()) == table_iv.names


def test_zeros_are_exact(table_iv: BaseParameters) -> None:
    nonzero = table_iv.matrix[table_iv.matrix != 0.0]
    # The smallest regrouping coefficient of this arm is a squared length.
    assert np.abs(nonzero).min() >= 0.0049 - 1e-9
    assert np.count_nonzero(table_iv.matrix) < 0.05 * table_iv.matrix.size


def test_invisible_changes_leave_the_effort_alone(
    denso: RobotModel, table_iv: BaseParameters
) -> None:
    rng = np.random.default_rng(8)
    theta = np.concatenate([random_links(rng, 6).ravel(), np.ones(12)])
    _, _, rows = np.linalg.svd(table_iv.matrix)
    change = rows[48:].T @ rng.standard_normal(24)
    W = fresh_rows(denso, ("coulomb", "viscous"), 9)
    np.testing.assert_allclose(W @ (theta + change), W @ theta, rtol=0, atol=1e-9)
