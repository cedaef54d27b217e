"""Room, multipliers and activity: multipliers are derivatives of the optimal cost."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from sdpid.assurance.diagnostics.active_constraints import ConstraintState, constraint_states
from sdpid.constraints import CenterOfMassInBox, CenterOfMassInEllipsoid, MassInEllipsoid
from sdpid.estimation.constraints.condition import Condition, Cone, Layout, Row
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.local.slsqp import solve_slsqp
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.robot.inertia import Consistency
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
from tests.helpers.data import make_samples, random_theta

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
    others = (CenterOfMassInBox(LAST, (-0.01,) * 3, (0.01,) * 3),)
    problem = arm_problem(consistency=consistency, **{**numbers, field: value})
    if field == "mass_min":
        # Heavy links cost something only where their center of mass may not follow.
        problem = arm_problem(
            CenterOfMassInBox(FIRST, (0.1, 0.1, 0.1), (0.2, 0.2, 0.2)),
            *others,
            consistency=consistency,
            **{**numbers, field: value},
        )
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
    assert estimate.multipliers is not None
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


@pytest.mark.parametrize("consistency", BOTH)
def test_the_multiplier_of_a_cone(consistency: Consistency) -> None:
    """An ellipsoid larger by a share s of its size has ``‖v‖ ≤ a·(1 + s)``."""

    def problem(size: float) -> Problem:
        semi_axes = size * np.array([0.02, 0.05, 0.03])
        condition = CenterOfMassInEllipsoid(LAST, (0, 0.01, 0), semi_axes, rotation=TURNED)
        return arm_problem(LIGHT, condition, consistency=consistency)

    estimate = solve_sdp(problem(1.0))
    state = constraint_states(estimate)[-1]
    assert state.active
    assert state.multiplier is not None
    found = slope(lambda step: solve_sdp(problem(1.0 + step)).cost, 0.02)
    mass = body_of(estimate, LAST)[0]
    assert found == pytest.approx(-state.multiplier * mass, rel=SLOPE)


def test_the_multiplier_of_an_ellipsoid_of_all_mass() -> None:
    """Larger by a share s it has ``∫ (1 − ‖y‖²/(1 + s)²) dm ≥ 0``, twice the mass per unit of s."""

    def problem(size: float) -> Problem:
        condition = MassInEllipsoid(
            LAST, (0, 0.1, 0), size * np.array([0.1, 0.2, 0.3]), rotation=TURNED
        )
        return arm_problem(LIGHT, condition)

    estimate = solve_sdp(problem(1.0))
    state = constraint_states(estimate)[-1]
    assert state.active
    assert state.multiplier is not None
    found = slope(lambda step: solve_sdp(problem(1.0 + step)).cost, 0.01)
    assert found == pytest.approx(-2.0 * state.multiplier * body_of(estimate, LAST)[0], rel=SLOPE)


def test_the_multiplier_of_a_sign() -> None:
    rng = np.random.default_rng(10)
    theta = random_theta(ARM, rng)
    theta[20:] = -1.0
    problem = build_problem(ARM, make_samples(ARM, theta, rng, noise=0.3))
    names = list(problem.base.theta_names)[20:]
    states = {s.name: s for s in constraint_states(solve_sdp(problem))}
    free = problem.constraints.replace(friction_nonnegative=False)

    @dataclass(frozen=True)
    class AtLeast(Condition):
        moved: str
        by: float

        def compile(self, layout: Layout) -> Iterator[Row]:
            for name in names:
                row = np.zeros(layout.count)
                row[layout.parameter(name)] = 1.0
                yield Row(name, row, self.by if name == self.moved else 0.0, np.inf)

    for name in names:

        def cost(step: float, name: str = name) -> float:
            limits = free.replace(others=(AtLeast(name, step),))
            return solve_sdp(problem.constrained(constraints=limits)).cost

        state = states[f"{name} at least 0"]
        assert state.active
        assert state.unit == problem.base.theta_units[problem.base.theta_names.index(name)]
        assert slope(cost, 1e-2) == pytest.approx(state.multiplier, rel=SLOPE)


def test_states_of_everything_in_turn() -> None:
    problem = arm_problem(
        LIGHT,
        CONDITIONS["fixed"][-1],
        CONDITIONS["ellipsoid"][-1],
        mass_max=0.5,
    )
    estimate = solve_sdp(problem)
    states = constraint_states(estimate)
    assert [state.name for state in states] == [
        f"consistency of {FIRST}",
        f"consistency of {LAST}",
        f"mass of {FIRST} at least 0.001 kg",
        f"mass of {FIRST} at most 0.5 kg",
        f"mass of {LAST} at least 0.001 kg",
        f"mass of {LAST} at most 0.5 kg",
        "Fs1 at least 0",
        "Fs2 at least 0",
        "Fv1 at least 0",
        "Fv2 at least 0",
        "total mass, at least 0.5",
        "total mass, at most 0.7",
        "m_2 fixed",
        "Fv1 fixed",
        f"center of mass of {LAST} in an ellipsoid",
    ]
    by_name = {state.name: state for state in states}
    assert estimate.margins is not None
    assert by_name[f"consistency of {LAST}"].slack == pytest.approx(estimate.margins[1] - 1e-3)
    assert by_name[f"consistency of {LAST}"].unit == "kg.m2"
    assert by_name[f"mass of {LAST} at most 0.5 kg"].slack == pytest.approx(0.1)
    assert by_name["m_2 fixed"].active
    assert by_name["m_2 fixed"].slack == pytest.approx(0.0, abs=FEASIBLE)
    values = {state.slack is None or state.slack >= -FEASIBLE for state in states}
    assert values == {True}
    for state in states:
        assert set(state.to_dict()) == {
            "name",
            "kind",
            "side",
            "slack",
            "multiplier",
            "active",
            "unit",
        }
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
