"""Audits of base parameters: bodies that exist pass, others are refuted, tampering shows."""

import copy
import json
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid import RobotModel, Samples, load_robot
from sdpid._common.arrays import Array
from sdpid.assurance.tables.answers import StoredRefutation, exact
from sdpid.assurance.tables.audit import BaseAudit
from sdpid.assurance.tables.csv_table import half_unit, read_base_table
from sdpid.assurance.tables.search import ScaledQuestion
from sdpid.cli.judge import write_proof
from sdpid.errors import CertificateError, DataError, ExportError
from sdpid.output.tables.parameter_tables import base_table
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.term import SampledMotion
from sdpid.robot.friction.terms import Coulomb, Coupling, SigmoidFriction, Viscous
from sdpid.robot.inertia import Consistency, margin, matrix_of, physical_parameters, point_masses
from sdpid.robot.model.base_parameters import BaseParameters, characteristic_length, structural_base
from sdpid.verifier import realizable
from sdpid.verifier.decimals import decimal_text, rounded
from sdpid.verifier.manifest import sealed
from sdpid.verifier.reading import MalformedError
from sdpid.verifier.realizable import coefficient_matrices
from sdpid.verifier.tables import answer_of, check, inequality, load, require_form
from tests.helpers import world
from tests.helpers.arm import BOTH
from tests.helpers.commands import alone, ran, refused, run
from tests.helpers.forged import at, change, paths, set_to, written
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, pendulum, small_arm
from tests.helpers.strategies import SEEDS, bodies, links, random_states

TERMS = ("coulomb", "viscous")
TABLE_IV = bundled_folder("denso_vp6242") / "table_iv.csv"


@cache
def arm(name: str) -> tuple[RobotModel, BaseParameters]:
    robots: dict[str, Callable[[], RobotModel]] = {
        "arm": lambda: small_arm(3),
        "tree": lambda: load_robot(TREE),
        "denso": lambda: load_robot("denso_vp6242"),
    }
    robot = robots[name]()
    model = FrictionModel.from_terms(TERMS, robot.joint_names, first=robot.n_base)
    return robot, structural_base(robot, model)


def audited(values: Any, halfwidths: Any, **options: Any) -> BaseAudit:
    """Audit a table of the Denso arm."""
    robot, base = arm("denso")
    options = {"base": base, **options}
    return sdpid.audit_base_parameters(robot, values, halfwidths, **options)


def audit(name: str, theta: Array, half: float, kind: Consistency, **more: Any) -> BaseAudit:
    robot, base = arm(name)
    values = dict(zip(base.names, (base.matrix @ theta).tolist(), strict=True))
    found = sdpid.audit_base_parameters(robot, values, half, consistency=kind, base=base, **more)
    if found.verdict != "undecided":
        assert found.holds()
    assert (found.witness is not None) == (found.verdict == "realisable")
    assert (found.refutation is not None) == (found.verdict == "not realisable")
    assert (found.certificate is None) == (found.verdict == "undecided")
    if found.certificate is not None:
        # A proof that needs no bound on masses is about the masses that were asked for, too.
        assert found.certificate.question is found.question
        checked = check(require_form(json.loads(json.dumps(found.certificate.to_dict()))))
        assert checked.passed, checked.problems
    if found.margin is not None and found.margin_bound is not None:
        assert found.margin <= found.margin_bound + 1e-9 * max(1.0, abs(found.margin))
    return found


def whole_theta(name: str, of_links: Array, friction: float = 0.5) -> Array:
    robot, _ = arm(name)
    return np.concatenate([of_links.ravel(), np.full(2 * robot.n, friction)])


def all_alike(name: str, body: Any) -> Array:
    """Return parameters of a robot whose links are all one body."""
    return whole_theta(name, np.tile(body, (arm(name)[0].n_links, 1)))


TETRAHEDRON = point_masses(np.ones(4), np.eye(4, 3))


# -------------------------------------------------------------------- bodies that exist


@pytest.mark.parametrize("kind", BOTH)
@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_point_masses_are_realisable(kind: Consistency, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["arm", "denso", "tree"]))
    robot, base = arm(name)
    theta = whole_theta(name, data.draw(links(robot.n_links)))
    half = data.draw(st.sampled_from([0.0, 1e-4, 0.005, 0.1]))
    found = audit(name, theta, half, kind)
    assert found.verdict == "realisable"
    # No less interior than the bodies that the table was made of.
    least = margin(theta[: 10 * robot.n_links].reshape(-1, 10), kind).min()
    assert found.margin >= least - 1e-6
    assert np.abs(base.matrix @ found.witness - base.matrix @ theta).max() <= half + 1e-9


def test_bodies_without_thickness_are_on_the_boundary() -> None:
    # Exactly known numbers of point masses: no room at all, and nothing to refute.
    point = point_masses(np.ones(1), np.array([[0.1, 0.2, 0.3]]))
    found = audit("arm", all_alike("arm", point), 0.0, BOTH[0])
    assert found.verdict in ("realisable", "undecided")
    assert abs(found.margin) < 1e-4


def test_undecided_is_near_the_boundary() -> None:
    """Along a line of tables the verdict changes once, and is open at most next to there."""
    start, base = all_alike("arm", TETRAHEDRON), arm("arm")[1]
    row = base.matrix[base.names.index("zz3")]
    edge = 0.0
    for k in range(30):
        found = audit("arm", start - 2.0**-k * row, 1e-3, BOTH[0])
        if found.verdict == "realisable":
            edge = max(edge, 2.0**-k)
        else:
            assert found.verdict == "not realisable" or abs(found.margin) < 1e-6
    assert edge > 0.0


# -------------------------------------------------------------------- bodies that do not


@pytest.mark.parametrize("kind", BOTH)
@settings(max_examples=6, deadline=None)
@given(data=st.data())
def test_impossible_bodies_are_refuted(kind: Consistency, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["arm", "denso", "tree"]))
    robot, _ = arm(name)
    theta = whole_theta(name, data.draw(links(robot.n_links)))
    # The last link with the sign turned, and more of it than all the others could hide.
    theta[10 * (robot.n_links - 1) : 10 * robot.n_links] = -100.0 * data.draw(bodies())
    found = audit(name, theta, 0.005, kind)
    assert found.verdict == "not realisable"
    proof = found.refutation
    assert found.margin_bound is None or found.margin_bound < 0.0
    assert found.blamed
    # The inequality is true of bodies that exist, whatever they are.
    weights = np.array([float(proof.weights.get(n, 0)) for n in proof.question.names])
    good = whole_theta(name, data.draw(links(robot.n_links)))
    value = float(weights @ arm(name)[1].matrix @ good)
    assert value >= float(proof.least) - 1e-9 * float(np.abs(weights).max()) * 100
    # As much change as was proven to be needed, and no more.
    assert 0.0 < found.change_bound <= found.change * (1.0 + 1e-9)
    assert found.change <= 1.05 * found.change_bound + 0.05


@settings(max_examples=8, deadline=None)
@given(seed=SEEDS)
def test_triangle_inequality_separates_the_two(seed: int) -> None:
    """A plate heavier about its normal than physics has it: an I_g, but no mass distribution."""
    rng = np.random.default_rng(seed)
    theta = all_alike("arm", point_masses(np.ones(4), 0.01 * rng.uniform(-1, 1, (4, 3))))
    theta[20:30] = [1.0, 0, 0, 0, 0.1, 0, 0.5, 0, 0, 0.1]
    assert audit("arm", theta, 1e-3, "spatial_inertia").verdict == "realisable"
    assert audit("arm", theta, 1e-3, "pseudo_inertia").verdict == "not realisable"


def test_negative_friction_is_refuted_by_itself() -> None:
    theta = all_alike("arm", TETRAHEDRON)
    theta[-1] = -1.0
    found = audit("arm", theta, 0.5, BOTH[0])
    assert found.verdict == "not realisable"
    assert list(found.refutation.weights) == ["Fv3"]
    assert audit("arm", theta, 0.5, BOTH[0], friction_nonnegative=False).verdict == "realisable"


def test_a_mass_bound_is_used_only_where_it_must_be() -> None:
    # A first moment that gravity shows can be had with any inertia if the link is heavy enough.
    values: dict[str, float | str] = {"mxr2": "10", "my2": "0", "zzr2": "0.5", "zz6": "0.001"}
    found = audited(values, 0.01, mass_max=20)
    assert found.verdict == "not realisable"
    assert found.needs_mass_bound
    assert found.refutation.holds
    # The proof does not hold without the multipliers of the masses.
    bare = StoredRefutation(question=found.question, weights=found.refutation.weights)
    assert not bare.holds
    assert audited(values, 0.01, mass_max=1000).verdict == "realisable"


# -------------------------------------------------------------------- the paper


@pytest.mark.parametrize(
    ("column", "kind"), [("cwls", BOTH[0]), ("wls", BOTH[0]), ("wls", BOTH[1])]
)
def test_the_paper_is_refuted_without_a_bound_on_masses(column: str, kind: Consistency) -> None:
    table = read_base_table(TABLE_IV, value=column)
    found = audited(table.values, table.halfwidths, consistency=kind)
    assert found.verdict == "not realisable"
    assert found.refutation.holds
    assert found.needs_mass_bound is False
    # The unconstrained column breaks one number by itself; nothing needs to be rounded there.
    assert column == "cwls" or (list(found.refutation.weights), found.needs_theta_max) == (
        ["zzr4"],
        False,
    )


def test_the_constrained_column_has_links_but_not_with_the_stated_margin() -> None:
    table = read_base_table(TABLE_IV, value="cwls")
    options = {"consistency": "spatial_inertia"}
    verdicts = [
        audited(table.values, table.halfwidths, margin=least, **options).verdict
        for least in ("0", "0.003", "0.005", "0.01")
    ]
    assert verdicts == ["realisable", "realisable", "not realisable", "not realisable"]


# -------------------------------------------------------------------- what a proof says


@settings(max_examples=50, deadline=None)
@given(body=bodies(), seed=SEEDS)
def test_what_a_link_adds(body: Array, seed: int) -> None:
    """c·theta = <C, I_g> + m·q(r), and = <Q, J>; both matrices as the proofs have them."""
    c = [Fraction(int(x)) for x in np.random.default_rng(seed).integers(-9, 10, 10)]
    C, Q = (np.array(m, dtype=float) for m in coefficient_matrices(c))
    expected = float(np.array(c, dtype=float) @ body)
    assert np.isclose(np.sum(Q * matrix_of(body, "pseudo_inertia")), expected)
    r = np.append(body[1:4] / body[0], 1.0)
    about = physical_parameters(body)[2]
    assert np.isclose(np.sum(C * about) + body[0] * r @ Q @ r, expected)


# -------------------------------------------------------------------- numbers and tables


def test_numbers_are_read_as_printed() -> None:
    assert exact(7.1) == exact(np.float64(7.1)) == exact("7.10") == Fraction(71, 10)
    assert exact(Decimal("0.013")) == Fraction(13, 1000)
    assert exact("2/3") == exact(Fraction(2, 3)) == Fraction(2, 3)
    for wrong in ("x", "1/x", "1/2/3", float("nan"), float("inf"), "Infinity", None):
        refuses(DataError, "finite number", exact, wrong)
    refuses(DataError, "division by zero", exact, "1/0")
    long = ("1e400", "1e-999999999", 1e300, "9" * 500, "1/1e400", Fraction(1, 10**600))
    for wrong in long:
        refuses(DataError, "digits", exact, wrong)
    assert decimal_text(Fraction(10) ** 400) == "1e+400"
    for text, half in (("7.10", "0.005"), ("-1", "0.5"), ("1.2e-3", "0.00005"), ("20", "0.5")):
        assert half_unit(text) == Fraction(half)
    refuses(DataError, ".", half_unit, "1..2")


@given(value=st.fractions(max_denominator=10**6), digits=st.integers(1, 12))
def test_rounding_keeps_claims_true(value: Fraction, digits: int) -> None:
    below, above = rounded(value, digits, up=False), rounded(value, digits, up=True)
    assert below <= value <= above
    assert above - below <= abs(value) * Fraction(10) ** (1 - digits)


def test_tables(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("\ufeffparameter, value, halfwidth\nzz6, 0.05,\nmx6, 0.1, 0.2\nmy6,,\n")
    table = read_base_table(path)
    assert table.values == {"zz6": Fraction("0.05"), "mx6": Fraction("0.1")}
    assert table.halfwidths == {"zz6": Fraction("0.005"), "mx6": Fraction("0.2")}
    assert set(read_base_table(path, halfwidth=0.5).halfwidths.values()) == {Fraction(1, 2)}
    for text, word in (
        ("a,b\n", "name"),
        ("name,b\nzz6,1\n", "value"),
        ("name,value\nzz6,x\n", "not a finite number"),
        ("name,value\nzz6,1\nzz6,1\n", "twice"),
        ("name,value\n", "no values"),
    ):
        path.write_text(text)
        refuses(DataError, word, read_base_table, path)
    refuses(DataError, "halfwidths", read_base_table, TABLE_IV, value="wls", halfwidth="other")


@pytest.mark.parametrize(
    ("values", "halfwidths", "more", "word"),
    [
        ({}, 0.1, {}, "no values"),
        ({"zz9": 1.0}, 0.1, {}, "zz9"),
        ({"zz6": 1.0}, {}, {}, "no halfwidth"),
        ({"zz6": 1.0}, {"zz6": 0.1, "mx6": 0.1}, {}, "without a value"),
        ({"zz6": 1.0}, -0.1, {}, "least is 0"),
        ({"zz6": float("nan")}, 0.1, {}, "finite"),
        ({"zz6": 1.0}, 0.1, {"consistency": "none"}, "consistency"),
        ({"zz6": 1.0}, 0.1, {"margin": -1.0}, "margin"),
        ({"zz6": 1.0}, 0.1, {"mass_min": 0.0}, "mass_min"),
        ({"zz6": 1.0}, 0.1, {"mass_max": 1e9}, "theta_max"),
    ],
)
def test_bad_input(values: Any, halfwidths: Any, more: Any, word: str) -> None:
    refuses(DataError, word, audited, values, halfwidths, **more)


@pytest.mark.parametrize("kind", BOTH)
def test_tables_of_ones_own_estimates_are_realisable(kind: Consistency, tmp_path: Path) -> None:
    """The file that `identify` writes names its friction by itself, whatever the terms are."""
    robot, terms = small_arm(2), ("coulomb", "viscous", "offset", "rotor_inertia")
    friction = (*terms, SigmoidFriction(0.1), Coupling(*robot.joint_names))
    samples, _ = world.samples(robot, friction=friction, noise=0.05)
    problem = sdpid.build_problem(robot, samples, friction=friction, consistency=kind)
    table = tmp_path / "base_parameters.csv"
    base_table(sdpid.solve_sdp(problem)).write(table)
    (tmp_path / "arm.urdf").write_text(robot.urdf or "", encoding="utf-8")
    how = ("--robot", tmp_path / "arm.urdf", "--consistency", kind)
    assert ": realisable" in ran("audit", table, *how).output


def test_a_table_with_effects_is_audited_by_the_description(tmp_path: Path) -> None:
    """Tilt and friction of the load were taken at links that a table does not hold."""
    rng = np.random.default_rng(0)
    robot = load_robot("ur5_robot")
    links_ = 1.1 * robot.prior
    bodies = tuple(tuple(map(float, body)) for body in links_)
    posed = (Coulomb(), Viscous(), LoadFriction(bodies), Tilt(bodies))
    model = FrictionModel.from_terms(posed, robot.joint_names)
    q, v, a = random_states(rng, robot.n, 150)
    motion = SampledMotion(position=q, velocity=v, acceleration=a, robot=robot)
    values = np.repeat([2.0, 1.0, 0.1, 0.02], [6, 6, 6, 2])
    effort = robot.inverse_dynamics(links_, q, v, a) + model.columns_in(motion) @ values
    effort += 0.05 * rng.standard_normal(effort.shape)
    samples = Samples(position=q, velocity=v, acceleration=a, effort=effort)
    estimate = sdpid.solve_sdp(sdpid.build_problem(robot, samples, friction=posed))
    table = tmp_path / "base_parameters.csv"
    base_table(estimate).write(table)
    assert {"Gx", "Gy", "Fl1", "Fl6"} <= set(read_base_table(table).values)
    assert ": realisable" in ran("audit", table, "--robot", "ur5_robot").output


def test_a_tilt_that_folds_into_a_link_needs_that_link() -> None:
    """Gravity turned about the only joint's axis is the link's mass elsewhere."""
    robot = replace(pendulum(), prior=np.array([[2.0, 0.3, 0.1, 0.0, 0.1, 0, 0.1, 0, 0, 0.1]]))
    with pytest.raises(DataError, match=r"depends on the links.*Tilt\(bodies"):
        sdpid.audit_base_parameters(robot, {"Gx": 0, "mxr1": 1}, 0.1)


def test_command(tmp_path: Path) -> None:
    how = ("--robot", "denso_vp6242", "--value", "cwls", "--consistency")
    path = tmp_path / "proof.json"
    done = run("audit", TABLE_IV, *how, "pseudo_inertia", "--proof", path)
    assert done.exit_code == 3
    assert "not realisable" in done.stdout
    assert "for links that can exist, but at most" in done.stdout
    done = ran("audit", TABLE_IV, *how, "spatial_inertia", "--json", "--proof", path)
    assert json.loads(done.stdout)["verdict"] == "realisable"
    found = check(load(path.read_bytes()))
    assert found.passed
    assert any("table_iv.csv" in line for line in found.statements)
    for wrong in (
        (TABLE_IV,),
        (TABLE_IV, "--robot", "denso_vp6242"),
        (tmp_path / "missing.csv", "--robot", "denso_vp6242"),
        (TABLE_IV, *how, "none"),
        (TABLE_IV, "--robot", "denso_vp6242", "--repair", tmp_path / "out.urdf"),
    ):
        refused(run("audit", *wrong), 2)


def test_a_table_to_fill_in(tmp_path: Path) -> None:
    """It has the names of the robot, is never written over a file, and is read once filled in."""
    table = tmp_path / "mine.csv"
    arguments = ("audit", table, "--robot", "denso_vp6242")
    assert "48 base parameters" in ran(*arguments, "--template").output
    lines = table.read_text().splitlines()
    assert lines[0] == "name,unit,value,halfwidth,regrouping"
    assert [line.split(",")[0] for line in lines[1:]] == list(arm("denso")[1].names)
    refused(run(*arguments), 2, "column 'value' has no values")
    refused(run(*arguments, "--template"), 2, "is there already")
    filled = table.read_text().replace("zz6,kg.m2,,", "zz6,kg.m2,0.00,")
    table.write_text(filled.replace("xxr6,kg.m2,,", "xxr6,kg.m2,-0.07,"))
    done = run(*arguments)
    assert (done.exit_code, "zz6 + xxr6 >= 0" in done.output) == (3, True)


# ---- Proofs of tables as files: what is changed is refused, named, or still true.


# Few numbers, so that a proof is made in a moment: link 6 of the Denso arm, with friction.
IMPOSSIBLE = {"zz6": "0.00", "xxr6": "-0.07", "Fs1": "1"}
POSSIBLE = {"zz6": "0.05", "xxr6": "0.01", "mx6": "0.2", "Fs1": "1"}


@cache
def stored(kind: str) -> str:
    """Return the text of a proof file."""
    if kind == "paper":
        table = read_base_table(TABLE_IV, value="cwls")
        options = {"consistency": "spatial_inertia", "margin": "0.005", "table": table.file}
        found = audited(table.values, table.halfwidths, **options)
    else:
        found = audited(IMPOSSIBLE if kind == "refutation" else POSSIBLE, "0.005")
    return json.dumps(found.certificate.to_dict())


def proof(kind: str) -> dict[str, Any]:
    return dict(json.loads(stored(kind)))


def holds(data: dict[str, Any]) -> bool:
    """Return whether everything in a changed proof holds, its digest made anew."""
    return check(require_form(sealed(data))).passed


@pytest.mark.parametrize("kind", ["refutation", "realization", "paper"])
def test_proofs_are_checked_by_the_folder_alone(kind: str, tmp_path: Path) -> None:
    done = alone(written(proof(kind), tmp_path))
    assert done.returncode == 0, done.stderr
    said = done.stdout
    assert "robot 'denso_vp6242' (6 links" in said
    assert said.splitlines()[-1].startswith("PROVEN")
    assert "not checked: that the coefficients are those of robot 'denso_vp6242'" in said
    if kind == "paper":
        assert "'table_iv.csv'" in said
        assert "48 parameters" in said
        assert "a margin of at least 0.005 kg.m2" in said
        assert "needs the links' consistency and the bound on all parameters, the margin" in said
    changed = proof(kind)
    changed["parameters"][0]["value"] = "17"
    done = alone(written(changed, tmp_path))
    assert done.returncode == 1
    assert "NOT PROVEN: the digest is another" in done.stdout
    done = alone(written({}, tmp_path))
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    # With the robot at hand the coefficients are checked too.
    found = verified(tmp_path, proof(kind))
    assert found.passed
    assert "are those of robot 'denso_vp6242', computed anew" in found.statements[-1]
    assert not any("coefficients" in each for each in found.unchecked)
    ran("verify", tmp_path / "c.json", "--robot", "denso_vp6242")


def given_of(data: dict[str, Any], name: str) -> dict[str, Any]:
    """Return what a proof says of one parameter."""
    return next(one for one in data["parameters"] if one["name"] == name)


def weighted(name: str, factor: int) -> Callable[[dict[str, Any]], Any]:
    """Return what multiplies a weight."""
    return change(lambda weight: str(factor * Fraction(weight)), "refutation", "weights", name)


# The weights are positive: what is said of both parameters must be as low as it is.
FORGED: list[tuple[str, Callable[[dict[str, Any]], Any], str]] = [
    *(
        ("refutation", weighted(name, factor), "")
        for name, factor in product(("zz6", "xxr6"), (-1, 0))
    ),
    *(
        ("refutation", lambda p, n=name, c=changed: given_of(p, n).update(c), "")
        for name, changed in product(("zz6", "xxr6"), ({"value": "1"}, {"halfwidth": "1"}))
    ),
    ("refutation", lambda p: [weighted(name, -1)(p) for name in ("zz6", "xxr6")], "not follow"),
    ("refutation", set_to({}, "refutation", "weights"), "does not contradict"),
    ("paper", set_to("0", "constraints", "margin"), "does not contradict"),
    ("paper", set_to({"0": "-1"}, "refutation", "masses"), "not follow"),
    ("paper", set_to({"0": "-1"}, "refutation", "slack"), "not follow"),
    *(
        ("realization", change(lambda _, value=value: value, "realization", "theta", j), "")
        for j, value in ((50, "0"), (50, "100.1"), (59, "10000.1"), (59, "-1"), (60, "-1"))
    ),
    ("realization", change(lambda _: "1000", "realization", "margins", 0), "claimed"),
    ("realization", set_to("1", "constraints", "margin"), "asked for"),
]


@pytest.mark.parametrize(("kind", "apply", "word"), FORGED)
def test_what_does_not_hold_is_named(
    kind: str, apply: Callable[[dict[str, Any]], Any], word: str
) -> None:
    changed = proof(kind)
    apply(changed)
    problems = check(require_form(sealed(changed))).problems
    assert problems
    assert word in problems[0]


NO_NUMBERS = ("-1", 0, "1/0", "1e400", "1e999999999", "Infinity", "nan", "9" * 5000, "١")
NONE: dict[tuple[Any, ...], tuple[Any, ...]] = {
    ("schema",): ("other", ["sdpid-refutation"]),
    ("version",): (1, 2.0, True),
    ("extra",): (1,),
    ("robot",): ({"name": "arm"},),
    ("robot", "links"): ([], ["a"] * 6, list("abcdefgh")),
    ("robot", "name"): (1,),
    ("table", "file"): (3,),
    ("constraints", "consistency"): ("none", []),
    ("constraints", "margin"): NO_NUMBERS,
    ("constraints", "mass_max"): ("0",),
    ("constraints", "theta_max"): ("1",),
    ("constraints", "mass_min"): ("0",),
    ("constraints", "nonnegative"): ([0], [999], [60.0]),
    ("parameters",): ([],),
    ("parameters", 0, "halfwidth"): ("-1", float("inf")),
    **{("parameters", 0, "coefficients", key): ("1",) for key in ("-1", "007", "9999")},
}
HOSTILE: list[Callable[[dict[str, Any]], Any]] = [
    *(set_to(value, *path) for path, values in NONE.items() for value in values),
    change(lambda names: names[:59], "theta_names"),
    change(lambda names: [*names[:-1], "m_1"], "theta_names"),
    lambda p: p["parameters"][0].pop("value"),
    lambda p: p["parameters"].append(p["parameters"][0]),
    lambda p: (
        [one.update(value=f"1/{7**400 + 2 * k}") for k, one in enumerate(p["parameters"])] * 30
        and p["parameters"][0]["coefficients"].update(
            {str(k): f"1/{7**400 + 2 * k + 1}" for k in range(60)}
        )
    ),
]


@pytest.mark.parametrize(
    ("kind", "apply"),
    [
        *product(("refutation", "realization"), HOSTILE),
        ("refutation", set_to({"zz5": "1"}, "refutation", "weights")),
        ("refutation", set_to([], "refutation", "weights")),
        ("refutation", set_to({"6": "1"}, "refutation", "masses")),
        ("refutation", lambda p: p["refutation"].pop("slack")),
        ("realization", lambda p: p["realization"]["theta"].pop()),
        ("realization", lambda p: p["realization"]["margins"].append("0")),
        ("realization", set_to("0", "realization", "theta")),
        ("realization", set_to("sdpid-refutation", "schema")),
    ],
)
def test_what_is_no_proof_or_answer_is_refused(
    kind: str, apply: Callable[[dict[str, Any]], Any]
) -> None:
    changed = proof(kind)
    apply(changed)
    with pytest.raises(MalformedError):
        answer_of(require_form(changed))


def test_what_is_printed_is_escaped_in_quotes_exact_or_marked_and_cut() -> None:
    text = stored("refutation").replace("denso_vp6242", r"\u001b[2J")
    text = text.replace("xxr6", r"x\u202e\nPROVEN.").replace("zz6", "m_1 >= 9 for links. No links")
    said = check(require_form(sealed(json.loads(text)))).lines
    assert said[-1].startswith("PROVEN")
    assert all(line.isprintable() for line in said)
    assert any("'m_1 >= 9 for links. No links' + " in line for line in said)
    assert decimal_text(Fraction("100.0000001")) == "100.0000001"
    assert decimal_text(Fraction(2, 3)) == "~0.666667"
    changed = proof("realization")
    changed["realization"]["theta"] = ["-1"] * len(changed["theta_names"])
    problems = check(require_form(sealed(changed))).problems
    assert len(problems) < 20
    assert problems[-1].endswith("more")
    weights, zeros = {f"p{k}": Fraction(1) for k in range(300)}, (Fraction(0),) * 300
    given_ = {"names": tuple(weights), "rows": ({},) * 300, "values": zeros, "halfwidths": zeros}
    question = replace(answer_of(proof("refutation")).question, **given_)
    cut = inequality(realizable.Refutation(question=question, weights=weights))
    assert "p11 and 288 more terms >= 0" in cut
    assert "p12" not in cut


# -------------------------------------------------------------------- the robot


def verified(tmp_path: Path, data: dict[str, Any], robot: str = "denso_vp6242") -> Any:
    return sdpid.verify(written(sealed(data), tmp_path), robot=robot)


def test_other_coefficients_are_named(tmp_path: Path) -> None:
    data = proof("paper")
    row = data["parameters"][4]["coefficients"]
    last = list(row)[-1]
    row[last] = str(Fraction(row[last]) + Fraction(1, 10**9))
    assert holds(data)
    found = verified(tmp_path, data)
    assert found.problems == (
        f"the coefficients of {data['parameters'][4]['name']} are other ones",
    )
    data = proof("realization")
    data["parameters"][0]["name"] = "zz99"
    assert "has no parameter 'zz99'" in verified(tmp_path, data).problems[0]
    data = proof("realization")
    data["theta_names"][0] = "m_9"
    assert "theta is not that" in verified(tmp_path, data).problems[0]
    assert "the links are not those" in verified(tmp_path, proof("paper"), "ur5_robot").problems[0]
    # Nor are signs those that physics gives.
    made = audited({"zz6": "0.05", "Fo1": "1"}, "0.005", base=None)
    data = made.certificate.to_dict()
    assert data["constraints"]["nonnegative"] == []
    data["constraints"]["nonnegative"] = [data["theta_names"].index("Fo1")]
    assert verified(tmp_path, data).problems == ("Fo1 may be negative",)


# -------------------------------------------------------------------- mutations


NUMBERS = st.sampled_from(
    ["0", "1", "-1", "0.005", "-0.07", "1000", "1/3", "-2/7", "0.000001", "100", "1e3", "1/0", ""]
)
ODD = st.one_of(
    NUMBERS, st.none(), st.integers(-3, 99), st.just([]), st.just({}), st.text(max_size=4)
)


def mutated(data: dict[str, Any], choose: st.DataObject) -> dict[str, Any]:
    """Return a proof with one to three values changed, taken away or doubled."""
    for _ in range(choose.draw(st.integers(1, 3))):
        *path, key = choose.draw(st.sampled_from(list(paths(data))))
        where, how = at(data, tuple(path)), choose.draw(st.sampled_from("rrrnsd"))
        old = where[key]
        if how == "d":
            del where[key]
        elif how == "s" and isinstance(old, str):
            where[key] = old[1:] if old.startswith("-") else f"-{old}"
        else:
            plain = how == "n" or not isinstance(old, str)
            where[key] = choose.draw(ODD if plain else NUMBERS)
    return data


def really_realized(answer: realizable.Realization) -> bool:
    """Judge bodies in floating point, by other code."""
    q, theta = answer.question, np.array([float(x) for x in answer.theta])
    for row, value, half in zip(q.rows, q.values, q.halfwidths, strict=True):
        had = sum(float(x) * theta[j] for j, x in row.items())
        if abs(had - float(value)) > float(half) + 1e-9 * (1 + abs(had)):
            return False
    bodies_ = theta[: 10 * q.n_links].reshape(-1, 10)
    least = np.maximum(float(q.margin), np.array(answer.margins, dtype=float))
    if not np.all(margin(bodies_, q.consistency) >= least - 1e-9 * (1 + np.abs(theta).max())):
        return False
    masses = bodies_[:, 0]
    if masses.min() < float(q.mass_min) - 1e-12 or masses.max() > float(q.mass_max) + 1e-9:
        return False
    low = [0 if j in q.nonnegative else -float(q.theta_max) for j in range(len(theta))]
    return bool(np.all(theta >= low) and np.all(theta <= float(q.theta_max)))


def really_refuted(answer: realizable.Refutation) -> bool:
    """Return whether a cone program finds no bodies that have the table."""
    question = answer.question
    search = ScaledQuestion(question, characteristic_length(load_robot("denso_vp6242")))
    found = search.solve()
    return found is None or not question.is_witness(search.made_exact(found.theta))


@pytest.mark.parametrize("kind", ["refutation", "realization"])
@settings(max_examples=300, deadline=None)
@given(choose=st.data())
def test_mutations_are_refused_or_still_true(kind: str, choose: st.DataObject) -> None:
    before = proof(kind)
    data = mutated(copy.deepcopy(before), choose)
    try:
        result = check(require_form(data))
    except (MalformedError, KeyError):
        return
    if {**data, "metadata": 0} != {**before, "metadata": 0}:
        assert any("digest" in problem for problem in result.problems)
    if not holds(data):
        return
    answer = answer_of(data)
    judge = really_realized if isinstance(answer, realizable.Realization) else really_refuted
    assert judge(answer)  # type: ignore[operator]


# -------------------------------------------------------------------- writing


def test_undecided_writes_nothing_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = audited({"zz6": "0.05"}, "0.005")
    refuses(ExportError, ".", found.certificate.to_json, tmp_path / "missing" / "proof.json")
    write_proof(tmp_path / "proof.json", replace(found, verdict="undecided", certificate=None))
    assert "not written: undecided, so there is no proof" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_numbers_too_long_for_the_checker_are_not_written(tmp_path: Path) -> None:
    names = [name for name in arm("denso")[1].names if name != "zz6"]
    odd = {name: Fraction(1, 10**380 + 2 * k + 1) for k, name in enumerate(names)}
    found = audited({**odd, "zz6": -1}, "0.005")
    proof_ = found.certificate
    assert proof_.holds
    refuses(CertificateError, "fewer digits", proof_.to_json, tmp_path / "proof.json")
    assert not list(tmp_path.iterdir())
