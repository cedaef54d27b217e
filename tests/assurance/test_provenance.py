"""Which constraints and which sources parameters come from."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid import Constraints, DhTable, Prior, load_robot, solve_sdp, solve_slsqp, solve_wls
from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.active_constraints import ConstraintState, constraint_states
from sdpid.assurance.diagnostics.provenance import Provenance, _active_normals, provenance
from sdpid.constraints import (
    CenterOfMassInBox,
    CenterOfMassInEllipsoid,
    Condition,
    Cone,
    Layout,
    MassInEllipsoid,
    Row,
)
from sdpid.errors import DataError
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.scaling import Scaling
from sdpid.output.tables.parameter_tables import theta_table
from sdpid.robot.inertia import Consistency, from_pseudo_inertia, point_masses
from tests.helpers.arm import (
    ARM,
    BOTH,
    CONDITIONS,
    FIRST,
    LAST,
    LIGHT,
    TURNED,
    arm_problem,
    body_of,
    limited,
)
from tests.helpers.data import flat_links, make_samples, random_links, random_theta
from tests.helpers.refusals import refuses
from tests.helpers.strategies import SEEDS

# Central differences of optimal costs, which are known to some 1e-9 of the cost.
SLOPE = 1e-3


@dataclass(frozen=True, eq=False)
class Shifted(Condition):
    """Another condition, one of its rows' limits moved."""

    other: Condition
    name: str
    by: float

    def compile(self, layout: Layout) -> Iterator[Row | Cone]:
        """Return what the other says."""
        for part in self.other.compile(layout):
            if isinstance(part, Row) and part.name == self.name:
                yield replace(part, lower=part.lower + self.by, upper=part.upper + self.by)
            else:
                yield part


@dataclass(frozen=True)
class Between(Condition):
    """One standard parameter is within limits."""

    name: str
    lower: float
    upper: float

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return one row."""
        row = np.zeros(layout.count)
        row[layout.parameter(self.name)] = 1.0
        yield Row(self.name, row, self.lower, self.upper)


def slope(cost: Callable[[float], float], step: float) -> float:
    """Return the derivative at zero, by central differences of fourth order."""
    near = (cost(step) - cost(-step)) / (2.0 * step)
    far = (cost(2.0 * step) - cost(-2.0 * step)) / (4.0 * step)
    return (4.0 * near - far) / 3.0


def total(states: Iterable[ConstraintState], *words: str) -> float:
    """Return the sum of the multipliers of all that says some words."""
    chosen = [state for state in states if all(word in state.name for word in words)]
    assert chosen
    return sum(state.multiplier for state in chosen if state.multiplier is not None)


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize(
    ("field", "words", "value", "numbers"),
    [
        ("margin", ("consistency",), 5e-3, {}),
        ("mass_max", ("mass of", "most 0.2 kg"), 0.2, {}),
        ("mass_min", ("mass of", "least 4 kg"), 4.0, {"mass_max": 10.0}),
        ("friction_max", (), 0.25, {"mass_max": 0.2}),
    ],
)
def test_multipliers_of_the_numbers(
    field: str,
    words: tuple[str, ...],
    value: float,
    numbers: dict[str, Any],
    consistency: Consistency,
) -> None:
    others = ()
    if field == "mass_min":
        # Heavy links cost something only where their center of mass may not follow.
        boxes = {FIRST: ((0.1,) * 3, (0.2,) * 3), LAST: ((-0.01,) * 3, (0.01,) * 3)}
        others = tuple(CenterOfMassInBox(link, *ends) for link, ends in boxes.items())
    problem = arm_problem(*others, consistency=consistency, **{**numbers, field: value})
    limits = problem.constraints

    def cost(step: float) -> float:
        moved = limits.replace(**{field: value + step})
        return solve_sdp(problem.constrained(constraints=moved)).cost

    states = constraint_states(solve_sdp(problem))
    if field == "friction_max":
        ends = [s for s in states if s.name.endswith(("least -0.25", "most 0.25"))]
        assert ends
        # Raising it raises upper limits and lowers the others.
        found = sum((s.multiplier or 0.0) * (1.0 if "most" in s.name else -1.0) for s in ends)
    else:
        found = total(states, *words)
    assert abs(found) > 1.0
    assert slope(cost, 0.02 * value) == pytest.approx(found, rel=SLOPE)


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize(
    "name", ["total", "group", "box", "hull", "fixed", "fixed link", "equal", "symmetric"]
)
def test_multipliers_of_rows(name: str, consistency: Consistency) -> None:
    """Each limit of each row that matters, moved by itself."""
    *first, condition = CONDITIONS[name]
    problem = arm_problem(*first, condition, consistency=consistency)
    estimate = solve_sdp(problem)
    feasible = problem.feasible
    pressing = [
        (row, multiplier)
        for row, multiplier in zip(feasible.row_names, estimate.multipliers.rows, strict=True)
        if abs(multiplier) > 1e-2 and not (first and row == "total mass")
    ]
    assert pressing
    # The three that press most, in units of their own.
    for row, multiplier in sorted(pressing, key=lambda pair: -abs(pair[1]))[:3]:
        states = [s for s in constraint_states(estimate) if s.name.startswith(row)]
        assert any(s.active for s in states)
        assert sum(s.multiplier or 0.0 for s in states) == pytest.approx(multiplier, rel=1e-6)

        def cost(step: float, row: str = row) -> float:
            return solve_sdp(limited(problem, *first, Shifted(condition, row, step))).cost

        # Small beside a centimeter of a kilogram.
        step = 2e-4
        # Optimal costs are convex in the limits.
        rounding = SLOPE * step * abs(multiplier) + 1e-7 * estimate.cost
        for by in (-step, step):
            assert cost(by) >= estimate.cost + by * multiplier - rounding
        if name not in ("symmetric", "equal"):
            # There the cost has a kink (a thin link in the plane gets thin across it), and any
            # multiplier between the slopes on either side will do.
            assert slope(cost, step) == pytest.approx(multiplier, rel=10.0 * SLOPE, abs=0.05)


@pytest.mark.parametrize(
    ("kind", "consistency", "place", "semi_axes", "masses"),
    [
        (CenterOfMassInEllipsoid, BOTH[0], (0, 0.01, 0), (0.02, 0.05, 0.03), 1.0),
        (CenterOfMassInEllipsoid, BOTH[1], (0, 0.01, 0), (0.02, 0.05, 0.03), 1.0),
        (MassInEllipsoid, BOTH[0], (0, 0.1, 0), (0.1, 0.2, 0.3), 2.0),
    ],
)
def test_the_multiplier_of_an_ellipsoid(
    kind: Any, consistency: Consistency, place: Any, semi_axes: Any, masses: float
) -> None:
    """Larger by a share s of its size it has ``‖v‖ ≤ a·(1 + s)`` of the center of mass.

    Of all mass it has ``∫ (1 − ‖y‖²/(1 + s)²) dm ≥ 0``, twice the mass per unit of s.
    """

    def problem(size: float) -> Problem:
        condition = kind(LAST, place, size * np.array(semi_axes), rotation=TURNED)
        return arm_problem(LIGHT, condition, consistency=consistency)

    estimate = solve_sdp(problem(1.0))
    state = constraint_states(estimate)[-1]
    assert state.active
    found = slope(lambda step: solve_sdp(problem(1.0 + step)).cost, 0.02 / masses)
    mass = body_of(estimate, LAST)[0]
    assert found == pytest.approx(-masses * state.multiplier * mass, rel=SLOPE)


def test_the_multiplier_of_a_sign() -> None:
    rng = np.random.default_rng(10)
    theta = random_theta(ARM, rng)
    theta[20:] = -1.0
    problem = build_problem(ARM, make_samples(ARM, theta, rng, noise=0.3))
    names = list(problem.base.theta_names)[20:]
    states = {s.name: s for s in constraint_states(solve_sdp(problem))}
    free = problem.constraints.replace(friction_nonnegative=False)

    for name in names:

        def cost(step: float, name: str = name) -> float:
            others = [Between(each, step if each == name else 0.0, np.inf) for each in names]
            limits = free.replace(others=others)
            return solve_sdp(problem.constrained(constraints=limits)).cost

        state = states[f"{name} at least 0"]
        assert state.active
        assert state.unit == problem.base.theta_units[problem.base.theta_names.index(name)]
        assert slope(cost, 1e-2) == pytest.approx(state.multiplier, rel=SLOPE)


def test_states_of_everything_in_turn() -> None:
    problem = arm_problem(LIGHT, CONDITIONS["fixed"][-1], CONDITIONS["ellipsoid"][-1], mass_max=0.5)
    estimate = solve_sdp(problem)
    states = constraint_states(estimate)
    ends = ("least 0.001", "most 0.5")
    assert [state.name for state in states] == [
        *(f"consistency of {link}" for link in (FIRST, LAST)),
        *(f"mass of {link} at {end} kg" for link in (FIRST, LAST) for end in ends),
        *(f"{name} at least 0" for name in ("Fs1", "Fs2", "Fv1", "Fv2")),
        "total mass, at least 0.5",
        "total mass, at most 0.7",
        "m_2 fixed",
        "Fv1 fixed",
        f"center of mass of {LAST} in an ellipsoid",
    ]
    by_name = {state.name: state for state in states}
    assert by_name[f"consistency of {LAST}"].slack == pytest.approx(estimate.margins[1] - 1e-3)
    assert by_name[f"consistency of {LAST}"].unit == "kg.m2"
    assert by_name[f"mass of {LAST} at most 0.5 kg"].slack == pytest.approx(0.1)
    assert by_name["m_2 fixed"].active
    assert by_name["m_2 fixed"].slack == pytest.approx(0.0, abs=FEASIBLE)
    values = {state.slack is None or state.slack >= -FEASIBLE for state in states}
    assert values == {True}
    for state in states:
        keys = {"name", "kind", "side", "slack", "multiplier", "active", "unit"}
        assert set(state.to_dict()) == keys
        if state.multiplier is not None and not state.name.endswith("fixed"):
            lower = "most" not in state.name
            assert state.multiplier * (1.0 if lower else -1.0) >= -1e-9


def test_states_without_multipliers_or_parameters() -> None:
    problem = arm_problem(LIGHT)
    assert constraint_states(solve_wls(problem)) == ()
    local = solve_slsqp(problem, seed=0, max_iterations=300)
    states = constraint_states(local)
    assert len(states) == len(constraint_states(solve_sdp(problem)))
    assert {state.multiplier for state in states} == {None}
    nothing = solve_sdp(arm_problem(LIGHT, consistency="none"))
    assert [state.name for state in constraint_states(nothing)] == [
        "total mass, at least 0.5",
        "total mass, at most 0.7",
    ]
    # A link without a mass has no margin.
    broken = Estimate.of_theta(problem, np.zeros(problem.n_theta), method="sdp", status="bad")
    assert constraint_states(broken)[0].slack is None


def test_wide_bounds_show_only_where_they_hold() -> None:
    problem = arm_problem(mass_max=0.2, friction_max=0.25)
    states = constraint_states(solve_sdp(problem))
    ends = [state for state in states if state.name.endswith(("-0.25", " 0.25"))]
    assert ends
    assert all(state.active for state in ends)
    wide = solve_sdp(arm_problem())
    assert not any(state.name.endswith(("-20", " 20")) for state in constraint_states(wide))


# ---- Where parameters come from: laws, limits, and a brute-force division of variances.


KINDS = ("euclidean", "scaled_euclidean", "pullback", "entropic")

# Shares are ratios of variances, from factorizations that lose a few hundred roundings.
SHARE = 1e-6


def described_arm(rng: np.random.Generator, joints: int = 3):
    rows = tuple({"alpha": 0.5 * np.pi * (i % 2), "d": 0.3 * i} for i in range(joints))
    table = DhTable.from_mapping({"joint": rows, "name": "arm"})
    return load_robot(table.to_urdf(random_links(rng, joints)))


def problem_of(seed: int, prior: Prior | None, *, noise: float = 0.3, **options) -> Problem:
    rng = np.random.default_rng(seed)
    robot = described_arm(rng)
    samples = make_samples(robot, random_theta(robot, rng), rng, noise=noise)
    return build_problem(robot, samples, prior=prior, **options)


def of(problem: Problem, theta: Array) -> Provenance:
    return provenance(Estimate.of_theta(problem, theta, method="sdp", status="optimal"))


def interior(problem: Problem, seed: int = 0) -> Array:
    return random_theta(problem.robot, np.random.default_rng(seed + 1))


@given(SEEDS, st.sampled_from((None, *KINDS)), st.floats(1e-3, 1e3), st.booleans())
def test_shares_sum_to_one(seed: int, kind: str | None, strength: float, flat: bool):
    prior = None if kind is None else Prior(kind=kind, strength=strength)
    problem = problem_of(seed, prior)
    theta = interior(problem, seed)
    rng = np.random.default_rng(seed)
    if flat and kind != "entropic":
        theta[:30] = flat_links(rng, 3).ravel()
    theta[30:] *= rng.integers(0, 2, len(theta) - 30)
    found = of(problem, theta)
    for share in (found.data, found.physics, found.prior):
        assert share.min() >= 0.0
        assert share.max() <= 1.0
    assert np.allclose(found.data + found.physics + found.prior, 1.0, atol=1e-12)
    # Friction at its sign constraint is physics, and nothing else in friction is.
    assert np.allclose(found.physics[30:], theta[30:] == 0.0, atol=SHARE)
    assert (found.physics[:30].max() > 0.5) == (flat and kind != "entropic")


@pytest.mark.parametrize("kind", [None, *KINDS])
def test_what_the_effort_does_not_show_is_not_data(kind):
    problem = problem_of(0, None if kind is None else Prior(kind=kind))
    found = of(problem, interior(problem))
    invisible = ~problem.base.matrix.any(axis=0)
    assert invisible.any()
    assert np.abs(found.data[invisible]).max() < SHARE
    assert found.prior[invisible] == pytest.approx(1.0)


@pytest.mark.parametrize("kind", [None, *KINDS])
def test_what_strong_data_determine_alone_is_data(kind):
    prior = None if kind is None else Prior(kind=kind, strength=1e-6, friction=False)
    problem = problem_of(0, prior)
    found = of(problem, interior(problem))
    # Parameters that the base parameters determine by themselves.
    B = problem.base.matrix
    alone = np.linalg.norm(np.eye(len(found.data)) - np.linalg.pinv(B) @ B, axis=0) < 1e-9
    assert alone.sum() > 6
    assert found.data[alone] == pytest.approx(1.0, abs=1e-3)


@given(SEEDS)
def test_without_a_prior_the_visible_share_is_data(seed: int):
    problem = problem_of(seed, None)
    scaled = problem.base.matrix * np.linalg.norm(Scaling.of(problem).basis(), axis=1)
    expected = np.diag(np.linalg.pinv(scaled) @ scaled)
    assert of(problem, interior(problem, seed)).data == pytest.approx(expected, abs=SHARE)
    # It does not matter how well the data show it, and so it is the limit of a weak prior.
    loud = problem_of(seed, None, noise=100.0)
    assert of(loud, interior(problem, seed)).data == pytest.approx(expected, abs=SHARE)
    faint = problem_of(seed, Prior(strength=1e-9, friction=False, kind="pullback"))
    assert of(faint, interior(problem, seed)).data[30:] == pytest.approx(1.0, abs=1e-3)


@given(SEEDS, st.sampled_from(KINDS), st.floats(1e-2, 1e2))
def test_it_divides_variances(seed: int, kind: str, strength: float):
    problem = problem_of(seed, Prior(kind=kind, strength=strength))
    theta = interior(problem, seed)
    theta[0] = problem.constraints.mass_min
    theta[:10] = from_pseudo_inertia(1e-3 * np.diag([0.04, 0.05, 0.06, 1.0]))
    R = np.vstack([term.curvature_rows(theta) for term in problem.prior.terms])
    G = problem.A @ problem.base.matrix
    before = np.diag(np.linalg.inv(R.T @ R))
    # The first mass is held: the rest of the parameters, on their own.
    rest = np.arange(1, len(theta))
    both = np.diag(1.0 / before[rest]) + (G.T @ G)[np.ix_(rest, rest)]
    after = np.append(0.0, np.diag(np.linalg.inv(both))) / before
    held = np.append(1.0, np.zeros(len(rest)))
    found = of(problem, theta)
    assert found.physics == pytest.approx(held, abs=SHARE)
    assert found.prior == pytest.approx(after, abs=SHARE)
    assert found.data == pytest.approx(1.0 - held - after, abs=SHARE)


def test_an_active_mass_bound_is_physics():
    problem = problem_of(1, Prior())
    theta = interior(problem)
    free = of(problem, theta)
    theta[10:20] *= problem.constraints.mass_min / theta[10]
    held = of(problem, theta)
    assert free.physics[10] == pytest.approx(0.0, abs=SHARE)
    assert held.physics[10] == pytest.approx(1.0)
    assert np.delete(held.physics, 10) == pytest.approx(0.0, abs=SHARE)
    # The unconstrained fit does not look at bounds.
    unconstrained = Estimate.of_theta(problem, theta, method="wls", status="optimal")
    assert provenance(unconstrained).physics.max() < SHARE


def test_an_equation_is_physics():
    rng = np.random.default_rng(2)
    name = described_arm(rng).parameter_names[20]
    problem = problem_of(2, Prior(), constraints=Constraints(others=(Between(name, 0.7, 0.7),)))
    theta = interior(problem)
    theta[20:30] *= 0.7 / theta[20]
    found = of(problem, theta)
    assert found.names[20] == name
    assert found.physics[20] == pytest.approx(1.0)
    assert found.physics[10] == pytest.approx(0.0, abs=SHARE)


@pytest.mark.parametrize("consistency", ["pseudo_inertia", "spatial_inertia"])
def test_a_flat_body_stays_free_to_be_another_flat_one(consistency):
    problem = problem_of(3, Prior(), consistency=consistency)
    theta = interior(problem)
    rng = np.random.default_rng(3)
    masses, points = rng.uniform(0.2, 1.0, 2), rng.uniform(-0.2, 0.2, (2, 3))
    # Two points: of rank two (4×4), and a rod that has no inertia about its own line (6×6).
    theta[20:30] = point_masses(masses, points)
    found = of(problem, theta)
    lost = 3 if consistency == "pseudo_inertia" else 1
    assert found.physics[:20].max() < SHARE
    assert found.physics[20:30].max() > 0.1
    normals = _active_normals(problem, theta)
    assert np.linalg.matrix_rank(normals / np.linalg.norm(normals, axis=1)[:, None]) == lost
    for k in range(2):
        for step in 1e-6 * np.eye(3):
            moved = points.copy()
            moved[k] += step
            change = np.zeros_like(theta)
            change[20:30] = point_masses(masses, moved) - theta[20:30]
            seen = normals @ change
            size = np.linalg.norm(normals, axis=1) * np.linalg.norm(change)
            assert np.all(np.abs(seen) <= 1e-4 * size)


@pytest.mark.parametrize("kind", KINDS)
def test_a_strong_prior_is_prior_and_shares_follow_its_strength(kind):
    shares = []
    for strength in (1e-3, 1.0, 1e3, 1e12):
        problem = problem_of(4, Prior(kind=kind, strength=strength))
        shares.append(of(problem, interior(problem)).prior[:30])
    assert shares[-1] == pytest.approx(1.0, abs=1e-3)
    assert np.all(np.diff(shares, axis=0) >= -SHARE)


def test_more_data_are_more_data():
    quiet, loud = (problem_of(5, Prior(), noise=1.0, weighting="gls") for _ in range(2))
    object.__setattr__(loud, "A", 10.0 * loud.A)
    theta = interior(quiet)
    assert np.all(of(loud, theta).data >= of(quiet, theta).data - SHARE)


def test_at_the_belief_the_entropic_and_its_quadratic_agree():
    pullback, entropic = (problem_of(6, Prior(kind=kind)) for kind in ("pullback", "entropic"))
    theta = interior(pullback)
    theta[:30] = pullback.robot.prior.ravel()
    # The believed bodies are above the least size, so that nothing was repaired.
    assert np.allclose(pullback.prior.terms[0].residual(theta)[:30], 0.0, atol=1e-9)
    for a, b in zip(
        of(pullback, theta).to_dict().values(), of(entropic, theta).to_dict().values(), strict=True
    ):
        assert a == pytest.approx(b, abs=SHARE)


def test_a_link_that_nothing_is_believed_of():
    rng = np.random.default_rng(7)
    bodies = random_links(rng, 3)
    bodies[1] = 0.0
    problem = problem_of(7, Prior(bodies=bodies))
    found = of(problem, interior(problem))
    assert np.all(np.isfinite(found.data))
    # Whatever the data show of it is data.
    assert found.data[10:20].max() > 0.9
    assert np.allclose(found.data + found.physics + found.prior, 1.0)


def test_of_a_solution_on_the_boundary():
    rng = np.random.default_rng(9)
    robot = described_arm(rng)
    theta = random_theta(robot, rng)
    # A link that is a point: noise presses its estimate against what can exist.
    theta[20:30] = flat_links(rng, 1)
    samples = make_samples(robot, theta, rng, noise=0.3)
    found = provenance(solve_sdp(build_problem(robot, samples)))
    assert found.physics[20:30].max() > 0.1
    problem = build_problem(robot, samples, prior=Prior(kind="entropic"))
    believed = provenance(solve_sdp(problem))
    # A barrier keeps the estimate away from the boundary: nothing of a link is held.
    assert believed.physics[:30].max() < SHARE


def test_estimates_have_it_and_tables_show_it():
    problem = problem_of(8, Prior())
    estimate = solve_wls(problem)
    found = provenance(estimate)
    named = found.to_dict()
    assert tuple(named) == problem.base.theta_names
    name = found.names[3]
    assert named[name]["data"] == found.data[3]
    assert name in found.table()
    assert len(found.table().splitlines()) == 1 + problem.n_theta
    table = theta_table(estimate)
    assert table.header == ("parameter", "unit", "value", "data", "physics", "prior")
    assert table.rows[3][3:] == (found.data[3], found.physics[3], found.prior[3])
    bare = solve_wls(problem_of(8, None))
    assert theta_table(bare).rows[3][2:] == (None, None, None, None)
    refuses(DataError, "no standard parameters", provenance, bare)
