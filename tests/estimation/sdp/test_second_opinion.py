"""The optimum against another solver, and against the problem written down a second time."""

from __future__ import annotations

from pathlib import Path

import pytest

import sdpid
from sdpid.assurance.diagnostics.active_constraints import constraint_states
from sdpid.constraints import CenterOfMassInEllipsoid, MassInEllipsoid, MirrorPair, TotalMass
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.prior.prior import Prior, PriorKind
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.robot.inertia import Consistency
from sdpid.workflow.formulate import formulate
from tests.helpers.arm import BODIES, BOTH, CONDITIONS, FIRST, LAST, REFLECTION, arm_problem
from tests.helpers.independent import Second
from tests.helpers.tolerances import SAME_OPTIMUM

# SCS, a first-order method, gets there in a second where bounds are no wider than needed.
SCS = {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 50_000}


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("name", ["none", *CONDITIONS])
def test_small_arms(name: str, consistency: Consistency) -> None:
    problem = arm_problem(*CONDITIONS.get(name, ()), consistency=consistency)
    ours = solve_sdp(problem).cost
    second = Second(problem)
    assert second.solve("CLARABEL") == pytest.approx(ours, rel=SAME_OPTIMUM)
    assert second.solve("SCS", **SCS) == pytest.approx(ours, rel=SAME_OPTIMUM)
    # The condition costs something, or this would compare nothing.
    if name != "none":
        free = solve_sdp(arm_problem(consistency=consistency)).cost
        assert ours > free * (1.0 + 10.0 * SAME_OPTIMUM)


@pytest.mark.parametrize("name", ["none", "all mass"])
@pytest.mark.parametrize("kind", ["pullback", "entropic"])
def test_priors(kind: PriorKind, name: str) -> None:
    """The log-det divergence as CVXPY writes it, by exponential cones of its own."""
    prior = Prior(kind=kind, bodies=BODIES, strength=0.5)
    problem = arm_problem(*CONDITIONS.get(name, ()), prior=prior)
    ours = solve_sdp(problem).cost
    second = Second(problem, prior)
    assert second.solve("CLARABEL") == pytest.approx(ours, rel=SAME_OPTIMUM)
    assert second.solve("SCS", **SCS) == pytest.approx(ours, rel=SAME_OPTIMUM)


@pytest.mark.parametrize("kind", ["pullback", "entropic"])
def test_links_that_are_nearly_mirror_images(kind: PriorKind) -> None:
    pair = MirrorPair(FIRST, LAST, reflection=REFLECTION)
    costs = {}
    for within in (0.05, 1e4):
        # Second takes bodies as they are: these need no repair.
        prior = Prior(kind=kind, bodies=BODIES, alike=(pair,), within=within)
        problem = arm_problem(prior=prior)
        costs[within] = solve_sdp(problem).cost
        second = Second(problem, prior)
        assert second.solve("CLARABEL") == pytest.approx(costs[within], rel=SAME_OPTIMUM)
    # What is hardly believed costs nothing; what is believed is paid for.
    free = solve_sdp(arm_problem(prior=Prior(kind=kind, bodies=BODIES))).cost
    assert costs[1e4] == pytest.approx(free, rel=SAME_OPTIMUM)
    assert costs[0.05] > free * (1.0 + 10.0 * SAME_OPTIMUM)


@pytest.mark.parametrize("kind", ["pullback", "entropic", None])
def test_a_real_recording(data_folder: Path, kind: PriorKind | None) -> None:
    folder = data_folder / "ur10_unisa"
    robot = sdpid.load_robot(folder / "ur10.urdf")
    prior = None if kind is None else Prior(kind=kind)
    conditions = (
        TotalMass(20.0, tolerance=0.5),
        CenterOfMassInEllipsoid("forearm_link", (0, 0, 0.2), (0.1, 0.1, 0.2)),
        MassInEllipsoid("upper_arm_link", (0, 0, 0.3), (0.1, 0.1, 0.4)),
    )
    problem = formulate(
        robot,
        sdpid.read_recording(folder / "ur10_exciting.npz"),
        constraints=Constraints(
            mass_max=30.0, theta_max=100.0, friction_max=100.0, others=conditions
        ),
        prior=False if prior is None else prior,
    )
    ours = solve_sdp(problem)
    assert any(state.active and state.name.startswith("total") for state in constraint_states(ours))
    second = Second(problem, prior)
    assert second.solve("CLARABEL") == pytest.approx(ours.cost, rel=SAME_OPTIMUM)
    looser = {"eps_abs": 1e-8, "eps_rel": 1e-8, "max_iters": 50_000}
    assert second.solve("SCS", **looser) == pytest.approx(ours.cost, rel=SAME_OPTIMUM)
