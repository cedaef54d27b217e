"""Effects are chosen where the data hold them, and not where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sdpid._common.arrays import Array
from sdpid.errors import DataError, SolverError
from sdpid.estimation.compression.covariance import residual_covariance
from sdpid.estimation.effects.kinds import EFFECTS
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem, describe
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.selection.choose import with_chosen_effects, with_effects
from sdpid.estimation.selection.trials import Trials
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.motion import Motion
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coupling, RotorInertia, Stribeck
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import random_links
from tests.helpers.robots import TREE, small_arm
from tests.helpers.strategies import random_states
from tests.helpers.tolerances import COST

ARM = small_arm(4)
LINKS = random_links(np.random.default_rng(5), 4)
BODIES = tuple(tuple(float(x) for x in body) for body in LINKS)
TERMS = ("coulomb", "viscous", "offset")
NOISE = 0.02

# What is in the log, with the parameters of the effect.
TRUTHS: dict[str, tuple[FrictionTerm, Array]] = {
    "tilt": (Tilt(BODIES), np.radians([1.5, -0.5])),
    "load": (LoadFriction(BODIES), np.full(4, 0.1)),
    "rotor_inertia": (RotorInertia(), np.full(4, 0.2)),
    "falling": (Stribeck(velocity=0.5), np.full(4, 0.5)),
}


def logged(*effects: str, seed: int = 1, count: int = 400, color: float = 0.0) -> Samples:
    """Return samples of the arm with effects, and noise that remembers a share of itself."""
    rng = np.random.default_rng(seed)
    q, v, a = random_states(rng, ARM.n, count)
    motion = Motion(position=q, velocity=v, acceleration=a, robot=ARM)
    effort = ARM.inverse_dynamics(LINKS.ravel(), q, v, a)
    effort += 0.3 * np.sign(v) + 0.2 * v + 0.1
    for name in effects:
        term, values = TRUTHS[name]
        effort += term.columns_in(motion, ARM.joint_names) @ values
    noise = NOISE * rng.standard_normal(effort.shape)
    for k in range(1, count):
        noise[k] += color * noise[k - 1]
    return Samples(position=q, velocity=v, acceleration=a, effort=effort + noise)


def chosen(samples: Samples, robot: RobotModel = ARM) -> Problem:
    prior = Prior(bodies=1.1 * LINKS)

    def build(terms: tuple[str | FrictionTerm, ...]) -> Problem:
        return build_problem(robot, samples, friction=terms, weighting="residual", prior=prior)

    return with_chosen_effects(build(TERMS), TERMS, prior, build)


def names(problem: Problem) -> set[str]:
    return {each.name for each in problem.effects if each.chosen}


@pytest.mark.parametrize(
    "effects",
    [("tilt",), ("load",), ("rotor_inertia",), ("falling",), ("tilt", "rotor_inertia")],
    ids="+".join,
)
def test_what_is_there_is_chosen(effects: tuple[str, ...]) -> None:
    problem = chosen(logged(*effects))
    assert names(problem) == set(effects)
    estimate = solve_sdp(problem)
    found = estimate.named_theta()
    assert found is not None
    if "tilt" in effects:
        np.testing.assert_allclose(np.degrees([found["Gx"], found["Gy"]]), [1.5, -0.5], atol=0.05)
    if "load" in effects:
        np.testing.assert_allclose([found[f"Fl{j}"] for j in (2, 3, 4)], 0.1, atol=0.02)
    for each in problem.effects:
        if each.chosen:
            assert each.fall is not None
            assert each.least_fall is not None
            assert each.fall >= each.least_fall
            assert "lowers the cost by" in each.words
    assert {each["name"] for each in describe(problem)["effects"]} >= set(effects)


@pytest.mark.parametrize(("count", "color"), [(400, 0.0), (60, 0.0), (150, 0.8)])
def test_what_is_absent_is_not_chosen(count: int, color: float) -> None:
    for seed in range(3):
        problem = chosen(logged(seed=10 + seed, count=count, color=color))
        assert names(problem) == set()
        assert {each.name for each in problem.effects} == {*TRUTHS}
        assert all("would lower" in each.words for each in problem.effects)


def test_records_too_short_to_tell_choose_nothing() -> None:
    assert names(chosen(logged("tilt", count=12))) == set()


def test_a_tilt_that_would_be_seen_is_doubted() -> None:
    (effect,) = [each for each in EFFECTS if each.name == "tilt"]
    assert not effect.doubt({"Gx": np.radians(3.0), "Gy": 0.0})
    assert "load_robot(gravity" in effect.doubt({"Gx": np.radians(6.0), "Gy": 0.0})
    # And is not chosen, however much it explains.
    gravity = ARM.gravity + np.cross([0.2, 0.0, 0.0], ARM.gravity)
    tilted = RobotModel.from_pinocchio(ARM.pin_model, gravity=gravity.tolist())
    problem = chosen(logged(), tilted)
    (tilt,) = [each for each in problem.effects if each.name == "tilt"]
    assert not tilt.chosen
    assert tilt.fall is not None
    assert tilt.fall > 0.5
    assert "would be seen" in tilt.words


def test_the_choice_is_the_same_every_time() -> None:
    samples = logged("load")
    first, second = chosen(samples), chosen(samples)
    assert first.effects == second.effects
    np.testing.assert_array_equal(first.A, second.A)


def test_the_columns_are_those_of_the_estimate() -> None:
    """Tilt and load multiply the links: their columns are taken at the links that are found."""
    estimate = solve_sdp(chosen(logged("tilt")))
    (term,) = [t for t in estimate.problem.friction.terms if isinstance(t, Tilt)]
    assert term.bodies is not None
    assert estimate.theta is not None
    moved = Tilt(tuple(tuple(map(float, b)) for b in estimate.theta[:40].reshape(4, 10)))
    q, v, a = random_states(np.random.default_rng(0), 4, 50)
    motion = Motion(position=q, velocity=v, acceleration=a, robot=ARM)
    before, after = (t.columns_in(motion, ARM.joint_names) for t in (term, moved))
    # What is left of it is far below the noise.
    change = (after - before) @ np.radians([1.5, -0.5])
    assert np.abs(change).max() < 0.05 * NOISE


def test_effects_by_name() -> None:
    samples = logged()

    def build(terms: tuple[str | FrictionTerm, ...]) -> Problem:
        return build_problem(ARM, samples, friction=terms)

    problem = with_effects(build(TERMS), TERMS, ("rotor_inertia", "coupling", "tilt"), build)
    kinds = {type(term) for term in problem.friction.terms}
    assert {RotorInertia, Coupling, Tilt} <= kinds
    assert LoadFriction not in kinds
    assert {each.name for each in problem.effects} == {"rotor_inertia", "coupling", "tilt"}
    assert all(each.fall is None for each in problem.effects)
    assert with_effects(problem, TERMS, ("tilt",), build) is problem


def test_a_coupling_by_name_brings_rotor_inertia_along() -> None:
    samples = logged()

    def build(terms: tuple[str | FrictionTerm, ...]) -> Problem:
        return build_problem(ARM, samples, friction=terms)

    problem = with_effects(build(TERMS), TERMS, ("coupling",), build)
    assert {RotorInertia, Coupling} <= {type(term) for term in problem.friction.terms}
    told = {each.name: each.words for each in problem.effects}
    assert told == {
        "rotor_inertia": "rotor inertia: in the model with what was asked beside it",
        "coupling": "a coupled wrist: in the model as asked",
    }


def test_an_effect_without_a_place_is_refused_by_name() -> None:
    robot = small_arm(1)
    q, v, a = random_states(np.random.default_rng(0), 1, 50)
    samples = Samples(position=q, velocity=v, acceleration=a, effort=q)

    def build(terms: tuple[str | FrictionTerm, ...]) -> Problem:
        return build_problem(robot, samples, friction=terms)

    with pytest.raises(DataError, match=r"coupling has no place on 'arm1'.*two joints"):
        with_effects(build(TERMS), TERMS, ("coupling",), build)


def test_an_effect_has_no_place_twice_or_on_a_floating_base() -> None:
    floating = load_robot(TREE, root="free_flyer")
    for name in ("tilt", "load"):
        (effect,) = [each for each in EFFECTS if each.name == name]
        assert effect.term(floating, ()) is None
    for effect in EFFECTS:
        first = effect.term(ARM, (RotorInertia(),) if effect.name == "coupling" else ())
        assert first is not None
        assert effect.term(ARM, (RotorInertia(), first)) is None


def test_a_trial_costs_what_the_problem_with_its_terms_costs() -> None:
    samples = logged("rotor_inertia", seed=3)
    prior = Prior(bodies=1.1 * LINKS)
    problem = build_problem(ARM, samples, friction=TERMS, weighting="residual", prior=prior)
    terms = problem.friction.terms
    every = (*terms, Tilt(BODIES), RotorInertia())
    trials = Trials.of(problem, every, prior)
    sigma = residual_covariance(trials.rows)
    known = replace(samples, covariance=sigma)
    rng = np.random.default_rng(0)
    for some in (terms, (*terms, RotorInertia()), every):
        trial = trials.with_terms(some)
        whole = build_problem(ARM, known, friction=some, weighting="gls", prior=prior)
        theta = rng.uniform(0.0, 1.0, whole.n_theta)
        assert trial.base.theta_names == whole.base.theta_names
        assert trial.cost_of(theta) == pytest.approx(whole.cost_of(theta), rel=COST)
        friction = FrictionModel.from_terms(some, ARM.joint_names)
        assert trial.friction.parameters == friction.parameters
    assert trials.independent < samples.effort.size


def test_rows_elsewhere_are_refused() -> None:
    problem = build_problem(ARM, logged(), friction=TERMS, weighting="residual")
    with pytest.raises(DataError, match="rows"):
        Trials.of(problem.without_rows(), problem.friction.terms, None)


def test_a_solver_that_fails_costs_the_choice_and_not_the_problem(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def failing(problem: Problem) -> Estimate:
        raise SolverError("no optimum")

    monkeypatch.setattr("sdpid.estimation.selection.choose.solve_sdp", failing)
    problem = chosen(logged("tilt"))
    assert problem.effects == ()
    assert Tilt not in {type(term) for term in problem.friction.terms}


def test_what_was_found_without_a_proof_is_enough_to_compare(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unproven(problem: Problem) -> Estimate:
        raise SolverError("gap", found=solve_sdp(problem))

    monkeypatch.setattr("sdpid.estimation.selection.choose.solve_sdp", unproven)
    assert names(chosen(logged("tilt"))) == {"tilt"}
