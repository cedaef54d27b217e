"""Certificates as files: what they say is proven, and what was changed is found out."""

import copy
import hashlib
import json
import math
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid import Prior, build_problem, certify, solve_sdp, solve_slsqp, solve_wls, verify
from sdpid.assurance.certificate.certificate import GAP
from sdpid.assurance.certificate.rounding import downward, feasible_theta, semidefinite
from sdpid.assurance.certificate.rows_digest import rows_digest
from sdpid.constraints import CenterOfMassInBox, CenterOfMassInEllipsoid, Condition, Fixed
from sdpid.errors import CertificateError, DataError
from sdpid.estimation.compression.covariance import WEIGHTINGS
from sdpid.estimation.duality.bound import evaluate
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.friction import Coulomb, Coupling
from sdpid.verifier import certificate as checker
from sdpid.verifier import exact, reading
from sdpid.verifier.bodies import has_margin
from sdpid.verifier.manifest import sealed
from sdpid.workflow.formulate import formulate
from sdpid.workflow.verify import Verification
from tests.helpers.arm import ARM, BODIES, BOTH, FIRST, LAST, LIGHT, arm_problem
from tests.helpers.commands import alone
from tests.helpers.data import make_samples, random_covariance, random_theta
from tests.helpers.forged import at, change, paths, with_row, written
from tests.helpers.refusals import refuses

Data = dict[str, Any]
KINDS = ("pseudo", "spatial", "prior", "entropic")


def problem_of(kind: str, *others: Condition) -> Problem:
    """Return the problem of a kind of consistency or prior."""
    priors = {"entropic": Prior(kind="entropic", bodies=BODIES), "prior": Prior(bodies=BODIES)}
    return arm_problem(
        *others,
        margin=0.0 if kind == "entropic" else 1e-3,
        consistency="spatial_inertia" if kind == "spatial" else "pseudo_inertia",
        prior=priors.get(kind),
    )


@cache
def stated(kind: str) -> Data:
    """Return a certificate with rows of every sort and a cone, or with a log-det prior."""
    problem = problem_of(
        kind,
        LIGHT,
        CenterOfMassInBox(FIRST, (-0.3, -0.3, -np.inf), (0.3, np.inf, 0.3)),
        CenterOfMassInEllipsoid(LAST, (0, 0.01, 0), (0.02, 0.05, 0.03)),
        Fixed({"Fv1": 0.5}),
    )
    return certify(solve_sdp(problem)).to_dict()


def made(kind: str) -> Data:
    """Return a certificate that may be changed."""
    return copy.deepcopy(stated(kind))


def checked(data: Data, folder: Path) -> Verification:
    """Verify through a file."""
    return verify(written(data, folder))


def holds(text: str) -> bool:
    """Whether what a file says is proven."""
    try:
        return not checker.check(checker.load(text.encode())).problems
    except reading.REFUSED:
        return False


def rejected(data: Data, folder: Path) -> bool:
    """Whether a certificate is refused, or found not to hold."""
    try:
        return not checked(data, folder).passed
    except CertificateError:
        return True


@pytest.mark.parametrize("kind", KINDS)
def test_it_holds_from_the_file_alone_and_by_a_bare_python(kind: str, tmp_path: Path) -> None:
    data = stated(kind)
    found = checked(data, tmp_path)
    assert found.passed, found.problems
    assert found.problems == ()
    assert found.gap <= GAP
    assert found.cost == data["claims"]["cost"]
    assert found.lower_bound == data["claims"]["lower_bound"]
    assert found.margin is not None
    assert found.sha256 == hashlib.sha256((tmp_path / "c.json").read_bytes()).hexdigest()
    done = alone(tmp_path / "c.json")
    assert done.returncode == 0, done.stderr
    claims = data["claims"]
    for said in (
        f"No feasible parameters cost less than {claims['lower_bound']!r}.",
        f"the least margin {min(claims['margins'])!r} kg.m2",
        f"They cost at most {claims['cost']!r}.",
        f"a gap of at most {claims['gap']!r}",
        "\nPROVEN, but for what was not checked.",
    ):
        assert said in done.stdout
    # Every new part is in use, or tampering below would mean nothing.
    problem, multipliers = data["problem"], data["multipliers"]
    assert len(problem["rows"]) == len(multipliers["rows"]) == 6
    assert len(problem["cones"]) == 1
    assert np.abs(multipliers["rows"]).max() > 0.1
    assert np.trace(np.array(multipliers["Z"][-1])) > 0.1
    entropic = kind == "entropic"
    assert (problem["entropic_prior"] is not None) == (multipliers["W"] is not None) == entropic
    assert bool(problem["prior_matrix"]) == (kind in ("prior", "entropic"))
    assert "2 links" in found.statements[1]
    assert "6 rows and 1 cones" in found.statements[2]


@pytest.mark.parametrize("kind", KINDS)
def test_the_numbers_are_those_of_floating_point(kind: str) -> None:
    problem = problem_of(kind, LIGHT)
    estimate = solve_sdp(problem)
    found = certify(estimate)
    assert found.cost == pytest.approx(estimate.cost, rel=1e-13)
    assert found.lower_bound == pytest.approx(evaluate(problem, found.bound.multipliers), rel=1e-12)
    assert found.margins == pytest.approx(tuple(estimate.margins), rel=1e-9)
    assert found.gap == pytest.approx((found.cost - found.lower_bound) / found.cost, abs=1e-15)


# ---- Tampering ----------------------------------------------------------------------------------


@cache
def leaves_of(kind: str) -> list[tuple[Any, ...]]:
    """Return where numbers, words and what is empty stand in a certificate, but descriptions."""
    data = {k: each for k, each in stated(kind).items() if k not in ("metadata", "sha256")}
    return [
        each for each in paths(data) if not (isinstance(v := at(data, each), (dict, list)) and v)
    ]


@given(st.data())
def test_a_changed_digit_anywhere_that_matters_is_rejected(data: st.DataObject) -> None:
    """Without a new digest, every change of anything but descriptions is seen."""
    kind = data.draw(st.sampled_from(KINDS))
    path = data.draw(st.sampled_from(leaves_of(kind)))
    forged = made(kind)
    where, value = at(forged, path[:-1]), at(forged, path)
    other = [True, "a half", None, 10**400, [], {}, float("nan"), float("inf"), -float("inf")]
    if type(value) in (int, float):
        other += [value + 1, math.nextafter(value, math.inf), math.nextafter(value, -math.inf)]
        other += [-value] if value else []
    if data.draw(st.booleans()):
        del where[path[-1]]
    else:
        different = [item for item in other if repr(item) != repr(value)]
        where[path[-1]] = data.draw(st.sampled_from(different))
    assert not holds(json.dumps(forged))


@given(st.data())
def test_so_is_any_character_of_the_file(data: st.DataObject) -> None:
    """One character of the text is another: it is refused, or means the same."""
    kind = data.draw(st.sampled_from(KINDS))
    text = json.dumps(stated(kind))
    k = data.draw(st.integers(0, len(text) - 1))
    forged = text[:k] + data.draw(st.sampled_from('0123456789-+.eE,[]{}" tx')) + text[k + 1 :]
    if not holds(forged):
        return
    same, found = made(kind), checker.load(forged.encode())
    assert {**found, "metadata": None} == {**same, "metadata": None}


@given(st.data())
def test_whatever_else_is_sealed_makes_sense_or_is_refused(data: st.DataObject) -> None:
    """Anything may stand anywhere: the check ends with an answer or says what is wrong."""
    kind = data.draw(st.sampled_from(KINDS))
    path = data.draw(st.sampled_from(leaves_of(kind)))
    depth = data.draw(st.integers(1, len(path)))
    forged = made(kind)
    where, key = at(forged, path[: depth - 1]), path[depth - 1]
    odd = [None, True, -1, 10**400, 1e300, -1e300, 5e-324, "x", [], {}, [[]], [None], {"x": 1}]
    where[key] = data.draw(st.sampled_from(odd))
    try:
        result = checker.check(sealed(forged))
    except reading.MalformedError:
        return
    if not result.problems and path[0] != "problem":
        # Other parameters or multipliers may do as well, but prove no more than there is.
        claims = stated(kind)["claims"]
        assert forged["claims"]["lower_bound"] <= claims["cost"]


@pytest.mark.parametrize(
    "floor",
    ["NaN", "Infinity", "-Infinity", "1e999", "1" + "0" * 5000, '0.0, "floor": 0.0'],
)
def test_literals_are_numbers_and_a_key_occurs_once(floor: str) -> None:
    text = json.dumps(stated("pseudo"))
    assert holds(text)
    # Descriptions may be others.
    told = {**stated("pseudo")["metadata"], "message": "something else"}
    assert holds(json.dumps({**stated("pseudo"), "metadata": told}))
    assert not holds(text[:-1] + ', "theta": null}')
    own = json.dumps(stated("pseudo")["problem"]["floor"])
    forged = text.replace(f'"floor": {own}', f'"floor": {floor}', 1)
    assert forged != text
    assert not holds(forged)


def scaled(factor: float) -> Callable[[Any], Any]:
    """Return what scales all numbers of a value."""
    return lambda value: (factor * np.array(value)).tolist()


def lopsided(matrices: Any) -> Any:
    """Return matrices of which one triangle alone would not show that the first is ⪰ 0."""
    matrices[0][0][1] += 1e-3 * max(map(max, matrices[0]))
    return matrices


# Of the total mass, a known friction, and a wall that nothing leans on: each is said otherwise.
TAMPERED: dict[str, Callable[[Data], None]] = {
    "another total mass": change(lambda value: value - 0.01, "problem", "rows", 0, "upper"),
    "no total mass": change(lambda value: None, "problem", "rows", 0, "upper"),
    "other coefficients": change(scaled(1.01), "problem", "rows", 0, "coefficients"),
    "another friction": change(lambda value: value + 1e-3, "problem", "rows", -1, "lower"),
    "another friction above": change(lambda value: value - 1e-3, "problem", "rows", -1, "upper"),
    "a row less": lambda data: data["problem"]["rows"].pop(),
    "a multiplier less": lambda data: data["multipliers"]["rows"].pop(),
    "a row and its multiplier less": lambda data: (
        data["problem"]["rows"].pop(0),
        data["multipliers"]["rows"].pop(0),
    ),
    "larger multipliers of rows": change(scaled(1.01), "multipliers", "rows"),
    "no multipliers of rows": change(scaled(0.0), "multipliers", "rows"),
    "reversed multipliers of rows": change(scaled(-1.0), "multipliers", "rows"),
    "another axis": change(scaled(0.99), "problem", "cones", 0, "axis"),
    "other vectors": change(scaled(1.01), "problem", "cones", 0, "vectors"),
    "another link": change(lambda link: 1 - link, "problem", "cones", 0, "link"),
    "no cone": change(lambda cones: [], "problem", "cones"),
    "no multiplier of the cone": lambda data: data["multipliers"]["Z"].pop(),
    "a larger multiplier of the cone": change(scaled(1.1), "multipliers", "Z", -1),
    "an asymmetric multiplier": change(lopsided, "multipliers", "Z"),
    "a negative multiplier of the cone": change(scaled(-1.0), "multipliers", "Z", -1),
    "a smaller floor": change(lambda floor: 0.9 * floor, "problem", "floor"),
    "a smaller margin": change(lambda value: value + 1e-2, "problem", "margin"),
    "version 1": change(lambda version: 1, "version"),
    # No claim can be better by a digit.
    "another cost": change(lambda cost: math.nextafter(cost, -math.inf), "claims", "cost"),
    "another bound": change(lambda x: math.nextafter(x, math.inf), "claims", "lower_bound"),
    "another gap": change(lambda gap: math.nextafter(gap, -math.inf), "claims", "gap"),
    "another margin": change(lambda margin: margin + 1e-12, "claims", "margins", 0),
    "the other's margin": change(lambda margin: margin + 1e-12, "claims", "margins", 1),
}
ENTROPIC: dict[str, Callable[[Data], None]] = {
    "another strength": change(scaled(1.01), "problem", "entropic_prior", "strength"),
    "a strength below zero": change(scaled(-1.0), "problem", "entropic_prior", "strength"),
    "other beliefs": change(scaled(1.01), "problem", "entropic_prior", "inverses"),
    "beliefs that no body has": change(scaled(-1.0), "problem", "entropic_prior", "inverses"),
    "another order": change(lambda links: links[::-1], "problem", "entropic_prior", "links"),
    "a link less": lambda data: data["problem"]["entropic_prior"]["links"].pop(),
    "no belief": change(lambda value: None, "problem", "entropic_prior"),
    "no tangent": change(lambda value: None, "multipliers", "W"),
    "another tangent": change(scaled(1.1), "multipliers", "W"),
    "a tangent that touches nowhere": change(scaled(-1.0), "multipliers", "W"),
    "an asymmetric tangent": change(lopsided, "multipliers", "W"),
    "one tangent less": lambda data: data["multipliers"]["W"].pop(),
}


@pytest.mark.parametrize(
    ("name", "kind"), [*product(TAMPERED, KINDS), *product(ENTROPIC, ["entropic"])]
)
def test_what_was_changed_is_found_out(name: str, kind: str, tmp_path: Path) -> None:
    data = made(kind)
    {**TAMPERED, **ENTROPIC}[name](data)
    assert rejected(sealed(data), tmp_path)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": "sdpid-certificate"}', "nonsense"])
def test_what_is_no_certificate(text: str, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_text(text, encoding="utf-8")
    refuses(CertificateError, ".", verify, path)
    refuses(CertificateError, "cannot read", verify, tmp_path / "none.json")


# ---- Rows, cones and names ----------------------------------------------------------------------


def test_the_bound_is_of_the_set_that_the_parameters_lie_in(tmp_path: Path) -> None:
    """A violation of 1e-10 is allowed for, so a multiplier of 1e30 buys nothing."""
    mass = stated("pseudo")["theta"][0]
    data = with_row(stated("pseudo"), mass * (1.0 + 1e-10), 1e30, m_1=1.0)
    data["claims"]["violation"] = 2e-10
    proof = checker.Proof(data)
    # What is left is what any numbers cost.
    assert proof.lower_bound == proof.floor
    data["multipliers"]["rows"][-1] = 0.0
    assert checked(sealed(data), tmp_path).passed


def test_the_mass_of_another_link_makes_no_violation_small(tmp_path: Path) -> None:
    data = made("pseudo")
    data["problem"]["upper"][0], data["theta"][0] = 1e12, 1e12
    data["problem"]["rows"], data["multipliers"]["rows"] = [], []
    data = with_row(data, 5000.0, 0.0, m_2=1.0)
    assert any("'light' is violated" in each for each in checked(sealed(data), tmp_path).problems)


def test_a_cost_below_the_bound_is_refused(tmp_path: Path) -> None:
    data = made("pseudo")
    data["theta"][0] *= 100.0
    found = checker.Proof(data)
    data["claims"]["cost"] = math.nextafter(float(found.cost), math.inf)
    data["claims"]["gap"] = 1.0
    assert not checked(sealed(data), tmp_path).passed


# ---- Other estimates ----------------------------------------------------------------------------


def test_a_local_result_is_certified_by_the_bound_of_another(tmp_path: Path) -> None:
    problem = arm_problem(LIGHT)
    best = solve_sdp(problem)
    early = solve_slsqp(problem, max_iterations=4)
    assert early.cost > 1.001 * best.cost
    found = certify(early, bound=best)
    assert not found.passed
    assert found.gap == pytest.approx(1.0 - best.cost / early.cost, rel=1e-3)
    assert certify(early, bound=certify(best).bound).gap == found.gap
    again = checked(found.to_dict(), tmp_path)
    # It does not claim to be optimal, and what it claims is true.
    assert again.passed == found.feasible
    assert again.gap == found.gap


def test_without_standard_parameters_only_the_bound_is_proven(tmp_path: Path) -> None:
    problem = arm_problem(LIGHT)
    found = certify(solve_wls(problem), bound=solve_sdp(problem))
    assert not found.feasible
    assert not found.passed
    assert found.margins is None
    assert found.gap < 0.0
    assert "not feasible" in found.summary()
    again = checked(found.to_dict(), tmp_path)
    assert not again.passed
    assert again.cost is None
    assert again.statements[-1] == f"No feasible parameters cost less than {found.lower_bound!r}."
    assert not any("at most" in each for each in again.statements[3:])


def test_what_is_not_feasible_is_not_certified() -> None:
    problem = arm_problem(LIGHT)
    best = solve_sdp(problem)
    assert best.theta is not None
    for k, less in ((0, 100.0), (4, 0.1), (20, 100.0)):
        theta = np.array(best.theta)
        theta[k] -= less
        found = certify(Estimate.of_theta(problem, theta, method="", status=""), bound=best)
        assert not found.feasible
        assert not found.passed


def test_without_a_consistency(tmp_path: Path) -> None:
    problem = arm_problem(consistency="none")
    found = certify(solve_sdp(problem))
    assert found.margins is None
    again = checked(found.to_dict(), tmp_path)
    assert again.passed
    assert again.margin is None


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_the_rows_are_named(weighting: Any) -> None:
    rng = np.random.default_rng(5)
    fields = {"covariance": random_covariance(rng, 2, 60)} if "gls" in weighting else {}
    samples = make_samples(ARM, random_theta(ARM, rng), rng, noise=0.1, **fields)
    problem = build_problem(ARM, samples, weighting=weighting)
    found = certify(solve_sdp(problem)).to_dict()
    assert found["origin"]["rows_sha256"] == rows_digest(problem)
    proof = checker.Proof(found)
    assert proof.cost - proof.lower_bound < GAP * max(proof.cost, proof.scale)
    again = build_problem(ARM, samples)
    assert rows_digest(problem) == rows_digest(again)
    moved = make_samples(ARM, random_theta(ARM, rng), rng, noise=0.1)
    assert rows_digest(problem) != rows_digest(build_problem(ARM, moved))


# ---- Rounding -----------------------------------------------------------------------------------


def test_rounding_goes_the_safe_way() -> None:
    third = Fraction(1, 3)
    assert Fraction(downward(third)) < third < Fraction(exact.above(third))
    assert math.nextafter(downward(third), math.inf) == exact.above(third)
    assert exact.above(Fraction(0.1)) == downward(Fraction(0.1)) == 0.1


@pytest.mark.parametrize("size", [4, 6])
def test_multipliers_on_the_edge_are_moved_inside(size: int) -> None:
    rng = np.random.default_rng(6)
    units = 10.0 ** rng.uniform(-4, 4, (40, size))
    V = units[:, :, None] * rng.standard_normal((40, size, 2))
    Z = V @ np.swapaxes(V, 1, 2)
    assert not all(exact.positive_semidefinite(z.tolist()) for z in Z)
    moved = semidefinite(Z)
    assert all(exact.positive_semidefinite(z.tolist()) for z in moved)
    # Small entries beside large ones stay what they are.
    scale = np.sqrt(np.einsum("nii->ni", Z))
    assert np.max(np.abs(moved - Z) / (scale[:, :, None] * scale[:, None, :])) < 1e-12
    # What is not near the cone is not passed off as if it were.
    wrong = -np.eye(size)[None]
    assert np.array_equal(semidefinite(wrong), wrong)


@pytest.mark.parametrize("consistency", ["pseudo_inertia", "spatial_inertia"])
def test_parameters_on_the_edge_are_moved_inside(consistency: Any) -> None:
    feasible = arm_problem(consistency=consistency, margin=1e-3).feasible
    theta = np.concatenate([BODIES.ravel(), np.zeros(4)])
    lowest = feasible.margins(theta)
    moments = 2.0 if consistency == "pseudo_inertia" else 1.0
    for short in (1e-16, 1e-12):
        bodies = BODIES.copy()
        bodies[:, [4, 6, 9]] += moments * (1e-3 - lowest - short)[:, None]
        theta[:20] = bodies.ravel()
        theta[20] = -1e-13
        moved = feasible_theta(feasible, theta)
        assert np.max(np.abs(moved - theta)) < 3e-12
        assert np.all(moved >= feasible.lower)
        for body in feasible.bodies(moved):
            assert has_margin(body.tolist(), 1e-3, consistency)


def test_a_problem_sent_without_its_rows_says_nothing_of_them() -> None:
    problem = arm_problem()
    sent = problem.without_rows()
    whole, without = (sdpid.certify(sdpid.solve_sdp(each)).to_dict() for each in (problem, sent))
    assert without["origin"]["samples"] == problem.samples.n_samples
    assert without["origin"]["rows"] == problem.n_rows
    assert without["origin"]["rows_sha256"] is None
    assert without["claims"] == whole["claims"]
    assert without["theta"] == whole["theta"]
    with pytest.raises(DataError, match="not kept"):
        _ = sdpid.solve_wls(sent).standard_errors


# ---- Certificates of the shared data sets, proven by a bare Python.


# Robot and record of each set, and one friction model.
SMOOTH, WRIST = Coulomb(width=0.05), Coupling("joint_5", "joint_6")
SETS: dict[str, tuple[str, str, tuple[Any, ...]]] = {
    "ur10_unisa": ("ur10.urdf", "ur10_exciting", ("coulomb",)),
    "panda_unisa": ("panda.urdf", "panda_exciting", ("coulomb",)),
    "kuka_lwr4plus": ("kuka_lwr4.urdf", "measurements_1", ("coulomb",)),
    "staubli_tx40": ("tx40.urdf", "tx40_rows_0_24750", (SMOOTH, "rotor_inertia", WRIST)),
    "kinova_gen3_dynamapp": ("gen3.urdf", "opti_traj_testing1", (Coulomb(width=0.02),)),
}


@pytest.mark.parametrize("name", list(SETS))
def test_real_recordings(name: str, data_folder: Path, tmp_path: Path) -> None:
    urdf, record, terms = SETS[name]
    robot = sdpid.load_robot(data_folder / name / urdf)
    log = sdpid.read_recording(data_folder / name / f"{record}.npz")
    for prior in (False, None, sdpid.Prior(kind="entropic")):
        problem = formulate(robot, log, friction=(*terms, "viscous", "offset"), prior=prior)
        for consistency in BOTH:
            estimate = sdpid.solve_sdp(problem.constrained(consistency=consistency))
            certificate = sdpid.certify(estimate)
            assert certificate.passed, certificate.summary()
            certificate.to_json(tmp_path / "c.json")
            done = alone(tmp_path / "c.json")
            assert done.returncode == 0, done.stdout + done.stderr
            assert done.stdout.splitlines()[-1] == "PROVEN, but for what was not checked."
            assert f"cost less than {certificate.lower_bound!r}." in done.stdout
