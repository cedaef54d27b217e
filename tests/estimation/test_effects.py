"""Effects of the drives and numbers of friction terms that the data choose."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls

import sdpid
from sdpid import Prior, RobotModel, Samples, build_problem, load_robot, solve_sdp, solve_wls
from sdpid._common.arrays import Array
from sdpid.errors import DataError, SolverError
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.effects import choose as effects_module
from sdpid.estimation.effects.bending import Bending
from sdpid.estimation.effects.choose import VariableProjection, close_terms, closed, opened
from sdpid.estimation.effects.kinds import EFFECTS, at_estimate
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.problem import Problem, describe
from sdpid.estimation.sdp.solve import solved_or_found
from sdpid.estimation.selection import choose as selection
from sdpid.estimation.selection.choose import with_effects, with_every_term
from sdpid.robot.friction.posed import LoadFriction, PositionFriction, Tilt
from sdpid.robot.friction.position import Hysteresis
from sdpid.robot.friction.term import FrictionTerm, OpenParameter, SampledMotion
from sdpid.robot.friction.terms import (
    Coulomb,
    Coupling,
    RotorInertia,
    SigmoidFriction,
    Stribeck,
    term_from_dict,
    term_to_dict,
)
from tests.helpers import data, world
from tests.helpers.arm import ARM
from tests.helpers.identified import SATURATED, saturating
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, small_arm
from tests.helpers.strategies import random_states
from tests.helpers.tolerances import COST

ARM3 = small_arm(3)
NAMES = ARM3.joint_names

# The search stops at 2 %; a second round about the same point does no worse.
FOUND = 0.03


def made(*terms: str | FrictionTerm, seed: int = 1, noise: float = 0.0, **fields: Any) -> Samples:
    rng = np.random.default_rng(seed)
    theta = data.random_theta(ARM3, rng, terms)
    return data.make_samples(
        ARM3, theta, rng, count=400, noise=noise, friction=terms, joint_names=NAMES, **fields
    )


@pytest.mark.parametrize(
    ("truth", "asked"),
    [
        (Coulomb(width=(0.3, 0.6, 1.0)), Coulomb(width=None)),
        (
            sdpid.friction.AsymmetricCoulomb(width=(0.3, 0.6, 1.0)),
            sdpid.friction.AsymmetricCoulomb(width=None),
        ),
        (Stribeck(velocity=(0.4, 0.8, 1.2)), Stribeck()),
        (SigmoidFriction(velocity=(0.3, 0.6, 1.0)), SigmoidFriction()),
        (Coupling(NAMES[1], NAMES[2], width=0.5), Coupling(NAMES[1], NAMES[2], width=None)),
        (
            Stribeck(velocity=(0.5, 0.9, 1.3), width=(0.2, 0.3, 0.4)),
            Stribeck(velocity=None, width=None),
        ),
    ],
)
def test_true_values_are_found(truth: FrictionTerm, asked: FrictionTerm) -> None:
    rest = ("viscous", "offset")
    problem = build_problem(ARM3, made(truth, *rest), friction=(asked, *rest))
    closed = problem.friction.terms[0]
    assert type(closed) is type(truth)
    for name in ("width", "velocity"):
        if hasattr(truth, name):
            found, expected = getattr(closed, name), getattr(truth, name)
            np.testing.assert_allclose(found, expected, rtol=5 * FOUND if "wid" in name else FOUND)
    chosen = problem.origin.profiled
    assert all(p.lower <= p.flat_from <= p.value <= p.flat_to <= p.upper for p in chosen)
    assert all(p.determined for p in chosen)


def test_several_terms_with_noise() -> None:
    """As good a fit as with the true numbers, which is all that the data can say."""
    truth = (Coulomb(width=0.2), Stribeck(velocity=(0.5, 0.7, 0.9)), "viscous")
    samples = made(*truth, noise=0.05)
    asked = (Coulomb(width=None), "stribeck", "viscous")
    problem = build_problem(ARM3, samples, friction=asked)
    exact = build_problem(ARM3, samples, friction=truth)
    assert problem.floor <= 1.001 * exact.floor
    assert len(problem.origin.profiled) == 6


def search_of(samples: Samples, terms: tuple[FrictionTerm | str, ...], sigma: Array) -> Any:
    """Return a search at the middle of the limits, and its rows."""
    model = data.friction_model(ARM3, terms)
    found = opened(model, list(np.abs(samples.velocity).T))
    rows = data.row_source(ARM3, samples, closed(model, found)[0].terms)
    return VariableProjection(rows, sigma, found), found


@pytest.mark.parametrize("kind", ["one", "each"])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("pulled", [False, True])
def test_the_cost_is_that_of_the_raw_rows(kind: str, masked: bool, pulled: bool) -> None:
    """Least over the open columns, joints' own not negative, and over all others of any sign."""
    rng = np.random.default_rng(5)
    mask = rng.random((400, 3)) < 0.7 if masked else None
    samples = made(Coulomb(width=0.3), Stribeck(0.6), "viscous", noise=0.1, mask=mask)
    if pulled:
        # Efforts that pull both ways, so that signs matter.
        samples = replace(samples, effort=rng.normal(size=(400, 3)))
    sigma = data.random_covariance(rng, 3, None if kind == "one" else 400)
    asked = (Coulomb(width=None), Stribeck(), Coupling(*NAMES[1:], width=None), "viscous")
    search, found = search_of(samples, asked, sigma)
    if not pulled:
        search.run()
    terms = (*(each.closed() for each in found), "viscous")
    W = data.full_regressor(ARM3, (samples.position, samples.velocity, samples.acceleration), terms)
    rows, effort = data.whitened(W, samples.effort, samples.used, sigma)
    # The links and viscous friction are projected out.
    matrix = rows.reshape(1200, -1)
    U, s, _ = np.linalg.svd(np.delete(matrix, slice(30, 39), axis=1), full_matrices=False)
    # Inertia and viscous friction crosswise may have any sign.
    signed = np.column_stack([matrix[:, 30:39], -matrix[:, 36:38], effort.ravel()])
    Q = U[:, s > 1e-9 * s[0]]
    left = signed - Q @ (Q.T @ signed)
    assert search.cost == pytest.approx(nnls(left[:, :-1], left[:, -1])[1] ** 2, rel=1e-6)


@dataclass(frozen=True)
class Power(FrictionTerm):
    """sign(v)·|v|^e, with one exponent for the robot, chosen by the data."""

    exponent: float | None = None

    def parameters(self, joint_names: Sequence[str]) -> Any:
        return Coulomb().parameters(joint_names)

    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        shape = np.sign(velocity) * np.abs(velocity) ** self.exponent
        return np.asarray(shape[:, :, None] * np.eye(len(joint_names)))

    def open_parameters(
        self, speeds: Sequence[Array], joint_names: Sequence[str]
    ) -> tuple[OpenParameter, ...]:
        return (OpenParameter("exponent", 0.1, 3.0, "1"),) if self.exponent is None else ()

    def with_values(self, values: Sequence[float]) -> "Power":
        return Power(values[0])


def test_a_term_of_ones_own_with_one_number_for_all_joints() -> None:
    problem = build_problem(ARM3, made(Power(0.4), "offset"), friction=(Power(), "offset"))
    (found,) = problem.origin.profiled
    assert (found.term, found.name, found.unit) == ("Power", "exponent", "1")
    assert found.value == pytest.approx(0.4, rel=FOUND)


@pytest.mark.parametrize("weighting", ["gls", "gls_per_sample", "eq9", "eq18", "residual"])
def test_every_weighting(weighting: Any) -> None:
    truth = Coulomb(width=(0.3, 0.6, 1.0))
    sigma = data.random_covariance(np.random.default_rng(2), 3, 400)
    samples = made(truth, "viscous", noise=0.01, covariance=sigma)
    asked = (Coulomb(width=None), "viscous")
    problem = build_problem(ARM3, samples, friction=asked, weighting=weighting)
    np.testing.assert_allclose([p.value for p in problem.origin.profiled], truth.width, rtol=0.1)


def test_only_rows_in_use_count() -> None:
    """Nobody measured the last joint, nor the efforts of a floating base."""
    samples = made(Coulomb(width=0.5), "viscous")
    mask = np.tile([True, True, False], (400, 1))
    wrong = samples.effort.copy()
    wrong[:, 2] = 1e3
    model = data.friction_model(ARM3, (Coulomb(width=None), "viscous"))
    cases = (replace(samples, mask=mask, effort=effort) for effort in (samples.effort, wrong))
    both = [close_terms(model, ARM3, each, lambda _: np.eye(3))[1] for each in cases]
    assert both[0] == both[1]
    assert [p.determined for p in both[0]] == [True, True, False]
    # Without effect the middle is kept.
    unseen = both[0][2]
    assert unseen.value == pytest.approx(np.sqrt(unseen.lower * unseen.upper))
    assert (unseen.flat_from, unseen.flat_to) == (unseen.lower, unseen.upper)


def test_long_records_are_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    sigma = data.random_covariance(np.random.default_rng(2), 3, 400)
    samples = made(Coulomb(width=0.5), "viscous", covariance=sigma)
    asked = (Coulomb(width=None), "viscous")
    whole = build_problem(ARM3, samples, friction=asked, weighting="gls_per_sample")
    monkeypatch.setattr(effects_module, "_MOST_SAMPLES", 130)
    thinned = build_problem(ARM3, samples, friction=asked, weighting="gls_per_sample")
    for a, b in zip(whole.origin.profiled, thinned.origin.profiled, strict=True):
        assert a.value == pytest.approx(b.value, rel=FOUND)
    assert thinned.n_rows == whole.n_rows


def test_the_choice_is_shown() -> None:
    samples = made(Coulomb(width=0.5), "viscous", noise=0.01)
    closed_terms = build_problem(ARM3, samples)
    assert closed_terms.origin.profiled == ()
    assert describe(closed_terms)["profiled"] == []
    problem = build_problem(ARM3, samples, friction=(Coulomb(width=None), "viscous"))
    shown = describe(problem)
    assert json.loads(json.dumps(shown)) == shown
    assert [t["term"] for t in shown["friction_terms"]] == ["Coulomb", "Viscous"]
    assert shown["friction_terms"][0]["width"] == [p["value"] for p in shown["profiled"]]
    assert {"term", "name", "value", "flat_from", "flat_to"} <= set(shown["profiled"][0])
    # The estimate predicts other samples with the chosen values.
    fresh = made(Coulomb(width=0.5), "viscous", seed=1)
    error = problem.predict(solve_wls(problem).base, fresh) - fresh.effort
    assert np.sqrt(np.mean(error**2)) < 0.02


# ---- Derivatives of friction by the speeds that the data chose, against the shapes themselves.


def test_derivatives_are_those_of_the_shape() -> None:
    problem, values = saturating(np.random.default_rng(1)), SATURATED[20:]
    assert Bending.of(problem.friction, (), values).deviations.size == 0
    found = Bending.of(problem.friction, problem.origin.profiled, values)
    v = np.linspace(-2.0, 2.0, 30)[:, None] * np.ones(2)
    motion = SampledMotion(position=v, velocity=v, acceleration=v, robot=ARM)
    speeds = np.array([each.value for each in problem.origin.profiled])
    # d(tanh(v/w))/d(log w) = -(v/w)·sech²(v/w)
    ratio = v / speeds
    expected = -values[:2] * ratio / np.cosh(ratio) ** 2
    columns = found.columns(motion)
    assert columns.shape == (30, 2, 2)
    np.testing.assert_allclose(np.einsum("kjj->kj", columns), expected, atol=2e-3)
    assert not columns[:, [0, 1], [1, 0]].any()
    limits = [np.log(each.upper / each.lower) / np.sqrt(12.0) for each in problem.origin.profiled]
    np.testing.assert_allclose(found.deviations, limits)


def test_errors_count_the_speeds_that_the_data_chose() -> None:
    """Friction scatters more for them, and the truth is within as often as stated."""
    rng = np.random.default_rng(2)
    alone, beside = [], []
    for _ in range(15):
        problem = saturating(rng)
        estimate = sdpid.solve_sdp(problem)
        error = estimate.base - problem.base_of(SATURATED)
        at = [problem.base.names.index(name) for name in ("Fsg1", "Fsg2", "Fv1", "Fv2")]
        for given, ratios in ((None, alone), (estimate.theta, beside)):
            variance = np.diag(NoiseSpectrum.of(problem, given).covariance)
            ratios.append(np.mean((error**2 / variance)[at]))
    # Of 60 squares the mean scatters by a fifth; those of one joint are correlated.
    assert np.mean(alone) > 1.8 * np.mean(beside)
    assert np.mean(beside) == pytest.approx(1.0, abs=0.5)


# ---- Where effects are made linear, and what they say.


PAIR = data.random_links(np.random.default_rng(0), 2)
PAIRS = tuple(tuple(float(x) for x in body) for body in PAIR)
RANGE = np.array([[-1.0, -2.0], [1.0, 2.0]])
SATURATING = (Coulomb(width=0.005), SigmoidFriction((0.1, 0.4)), sdpid.friction.Viscous())


def test_the_load_rubs_where_the_joint_does() -> None:
    friction = {"Fs1": 3.0, "Fs2": 0.0, "Fsg1": 1.0, "Fsg2": 2.0, "Fv1": 1.0, "Fv2": 1.0}
    term = next(each for each in EFFECTS if each.name == "load").term(ARM, SATURATING, RANGE)
    assert term == LoadFriction(width=0.005)
    assert at_estimate(term, PAIR, friction, SATURATING) == LoadFriction(
        PAIRS, width=0.005, share=(0.25, 1.0), velocity=(0.1, 0.4)
    )
    # Without a sigmoid it is the sign, and other terms are what they were.
    assert at_estimate(term, PAIR, friction, SATURATING[:1]) == LoadFriction(PAIRS, width=0.005)
    assert at_estimate(Tilt(), PAIR, friction, SATURATING) == Tilt(PAIRS)
    assert at_estimate(RotorInertia(), PAIR, friction, SATURATING) == RotorInertia()


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_every_effect_says_what_it_is(effect: Any) -> None:
    assert 0.0 < effect.least_fall < 1.0
    assert effect.title
    assert effect.meaning
    parameters = {"Gx": 0.01, "Gy": -0.02, "Fl1": 0.05, "Fl2": 0.1}
    words = {"tilt": "0.57° about x and -1.15° about y", "load": "5.0 to 10.0 % of the load"}
    assert words.get(effect.name, "") in effect.size(parameters)


# ---- Effects are chosen where the data hold them, and not where they do not.


ARM4 = small_arm(4)
LINKS = data.random_links(np.random.default_rng(5), 4)
BODIES = tuple(tuple(float(x) for x in body) for body in LINKS)
TERMS = ("coulomb", "viscous", "offset")
NOISE = 0.02

# What is in the log, with the parameters of the effect.
TRUTHS: dict[str, tuple[FrictionTerm, Array]] = {
    "tilt": (Tilt(BODIES), np.radians([1.5, -0.5])),
    "load": (LoadFriction(BODIES), np.full(4, 0.1)),
    "rotor_inertia": (RotorInertia(), np.full(4, 0.2)),
    "falling": (Stribeck(velocity=0.5), np.full(4, 0.5)),
    "hysteresis": (Hysteresis("joint_3", (0.1, 0.3)), np.array([0.2, 0.2])),
}


def logged(*effects: str, seed: int = 1, count: int = 400, color: float = 0.0) -> Samples:
    """Return samples of the arm with effects, and noise that remembers a share of itself."""
    rng = np.random.default_rng(seed)
    q, v, a = random_states(rng, ARM4.n, count)
    motion = SampledMotion(position=q, velocity=v, acceleration=a, robot=ARM4)
    effort = ARM4.inverse_dynamics(LINKS.ravel(), q, v, a)
    effort += 0.3 * np.sign(v) + 0.2 * v + 0.1
    for name in effects:
        term, values = TRUTHS[name]
        effort += term.columns_in(motion, ARM4.joint_names) @ values
    noise = NOISE * rng.standard_normal(effort.shape)
    for k in range(1, count):
        noise[k] += color * noise[k - 1]
    return Samples(position=q, velocity=v, acceleration=a, effort=effort + noise)


def builder(samples: Samples, robot: RobotModel = ARM4, **options: Any) -> Any:
    """Return what makes a problem of friction terms."""
    return lambda terms: build_problem(robot, samples, friction=terms, **options)


def chosen(samples: Samples, robot: RobotModel = ARM4) -> Problem:
    prior = Prior(bodies=1.1 * LINKS)
    build = builder(samples, robot, weighting="residual", prior=prior)
    return selection.with_chosen_effects(build(TERMS), TERMS, prior, build)


def names(problem: Problem) -> set[str]:
    return {each.name for each in problem.origin.effects if each.chosen}


@pytest.mark.parametrize(
    "effects",
    [*((name,) for name in TRUTHS), ("tilt", "rotor_inertia")],
    ids="+".join,
)
def test_what_is_there_is_chosen(effects: tuple[str, ...]) -> None:
    problem = chosen(logged(*effects))
    assert names(problem) == set(effects)
    if effects == ("load",):
        # The choice is the same every time.
        again = chosen(logged(*effects))
        assert again.origin.effects == problem.origin.effects
        np.testing.assert_array_equal(again.A, problem.A)
    found = solve_sdp(problem).named_theta()
    if "tilt" in effects:
        np.testing.assert_allclose(np.degrees([found["Gx"], found["Gy"]]), [1.5, -0.5], atol=0.05)
    if "load" in effects:
        np.testing.assert_allclose([found[f"Fl{j}"] for j in (2, 3, 4)], 0.1, atol=0.02)
    if "hysteresis" in effects:
        # At its joint alone, and all of it.
        weights = {name: value for name, value in found.items() if name.startswith("Fh")}
        assert [*weights] == ["Fha3", "Fhb3", "Fhc3"]
        assert sum(weights.values()) == pytest.approx(0.4, rel=0.05)
    for each in problem.origin.effects:
        if each.chosen:
            assert each.fall >= each.least_fall
            assert "lowers the cost by" in each.words
    assert {each["name"] for each in describe(problem)["effects"]} >= set(effects)


@pytest.mark.parametrize(("count", "color"), [(400, 0.0), (60, 0.0), (150, 0.8)])
def test_what_is_absent_is_not_chosen(count: int, color: float) -> None:
    for seed in range(3):
        problem = chosen(logged(seed=10 + seed, count=count, color=color))
        assert names(problem) == set()
        assert {each.name for each in problem.origin.effects} == {*TRUTHS}
        assert all("would lower" in each.words for each in problem.origin.effects)
        assert any("hysteresis of all joints" in each.words for each in problem.origin.effects)
    # Nor is what is there, in a record too short to tell.
    assert names(chosen(logged("tilt", count=12))) == set()


def test_friction_over_position_is_taken_by_name_alone() -> None:
    samples = logged()
    low, high = samples.position.min(axis=0), samples.position.max(axis=0)
    drag = PositionFriction(tuple(low), tuple(high))
    values = np.repeat([0.1, 0.0, 0.9], 4)
    motion = SampledMotion(
        position=samples.position,
        velocity=samples.velocity,
        acceleration=samples.acceleration,
        robot=ARM4,
    )
    own = drag.columns_in(motion, ARM4.joint_names) @ values
    samples = replace(samples, effort=samples.effort + own)
    assert "position" not in names(chosen(samples))
    prior = Prior(bodies=1.1 * LINKS)
    build = builder(samples, weighting="residual", prior=prior)
    problem = with_effects(build(TERMS), TERMS, ("position",), build)
    (told,) = problem.origin.effects
    assert told.words == "friction over position: in the model as asked"
    (term,) = [t for t in problem.friction.terms if isinstance(t, PositionFriction)]
    assert term == drag
    assert term_from_dict(term_to_dict(term)) == term
    found = solve_sdp(problem).named_theta()
    level = [found[f"Fp{k}{j + 1}"] + found[f"Fs{j + 1}"] for k in "abc" for j in range(4)]
    np.testing.assert_allclose(level, values + 0.3, atol=0.03)


def test_hysteresis_by_name_is_that_of_each_joint_that_moves() -> None:
    samples = logged()
    position = samples.position.copy()
    position[:, 1] = 0.2
    samples, prior = replace(samples, position=position), Prior(bodies=1.1 * LINKS)
    build = builder(samples, weighting="residual", prior=prior)
    problem = with_effects(build(TERMS), TERMS, ("hysteresis",), build)
    names = [each for each in problem.base.names if each.startswith("Fh")]
    # Elements that slip after short ways are told apart from others.
    assert names == [f"Fh{k}{j}" for j in (1, 3, 4) for k in "abc"]
    words = [each.words for each in problem.origin.effects]
    assert words[1] == "hysteresis of joint_3: in the model as asked"


def test_a_tilt_that_would_be_seen_is_doubted() -> None:
    (effect,) = [each for each in EFFECTS if each.name == "tilt"]
    assert not effect.doubt({"Gx": np.radians(3.0), "Gy": 0.0})
    assert "load_robot(gravity" in effect.doubt({"Gx": np.radians(6.0), "Gy": 0.0})
    # And is not chosen, however much it explains.
    gravity = ARM4.gravity + np.cross([0.2, 0.0, 0.0], ARM4.gravity)
    tilted = RobotModel.from_pinocchio(ARM4.pin_model, gravity=gravity.tolist())
    problem = chosen(logged(), tilted)
    (tilt,) = [each for each in problem.origin.effects if each.name == "tilt"]
    assert not tilt.chosen
    assert tilt.fall > 0.5
    assert "would be seen" in tilt.words


def test_the_columns_are_those_of_the_estimate() -> None:
    """Tilt and load multiply the links: their columns are taken at the links that are found."""
    estimate = solve_sdp(chosen(logged("tilt")))
    (term,) = [t for t in estimate.problem.friction.terms if isinstance(t, Tilt)]
    assert term.bodies is not None
    moved = Tilt(tuple(tuple(map(float, b)) for b in estimate.theta[:40].reshape(4, 10)))
    q, v, a = random_states(np.random.default_rng(0), 4, 50)
    motion = SampledMotion(position=q, velocity=v, acceleration=a, robot=ARM4)
    before, after = (t.columns_in(motion, ARM4.joint_names) for t in (term, moved))
    # What is left of it is far below the noise.
    change = (after - before) @ np.radians([1.5, -0.5])
    assert np.abs(change).max() < 0.05 * NOISE


def test_effects_by_name() -> None:
    build = builder(logged())
    problem = with_effects(build(TERMS), TERMS, ("coupling", "tilt"), build)
    kinds = {type(term) for term in problem.friction.terms}
    assert {RotorInertia, Coupling, Tilt} <= kinds
    assert LoadFriction not in kinds
    assert all(each.fall is None for each in problem.origin.effects)
    told = {each.name: each.words.partition(" (")[0] for each in problem.origin.effects}
    # A coupling brings rotor inertia along.
    assert told == {
        "tilt": "a tilted base: in the model as asked",
        "rotor_inertia": "rotor inertia: in the model with what was asked beside it",
        "coupling": "a coupled wrist: in the model as asked",
    }
    assert with_effects(problem, TERMS, ("tilt",), build) is problem


def test_effects_without_a_place_or_rows_are_refused() -> None:
    robot = small_arm(1)
    build = builder(world.samples(robot)[0], robot)
    words = r"coupling has no place on 'arm1'.*two joints"
    refuses(DataError, words, with_effects, build(TERMS), TERMS, ("coupling",), build)
    problem = build_problem(ARM4, logged(), friction=TERMS, weighting="residual")
    refuses(DataError, "rows", with_every_term, problem.without_rows(), (), None)
    # Nor have they one twice or, some of them, on a floating base.
    floating = load_robot(TREE, root="free_flyer")
    for effect in (own for each in EFFECTS for own in each.each(ARM4, (), RANGE[:, [0, 1, 0, 1]])):
        if effect.name in ("tilt", "load"):
            assert effect.term(floating, (), RANGE) is None
        first = effect.term(ARM4, (RotorInertia(),) if effect.name == "coupling" else (), RANGE)
        assert first is not None
        assert effect.term(ARM4, (RotorInertia(), first), RANGE) is None


def test_a_trial_costs_what_the_problem_with_its_terms_costs() -> None:
    samples = logged("rotor_inertia", seed=3)
    prior = Prior(bodies=1.1 * LINKS)
    problem = build_problem(ARM4, samples, friction=TERMS, weighting="residual", prior=prior)
    every = (*problem.friction.terms, Tilt(BODIES), RotorInertia())
    largest, independent = with_every_term(problem, every, prior)
    sigma = Factor.of(largest.rows, "residual").sigma
    known, rng = replace(samples, covariance=sigma), np.random.default_rng(0)
    for absent in ((), every[-2:-1], every[-1:], every[-2:]):
        trial = selection.without_terms(largest, absent)
        present = tuple(term for term in every if term not in absent)
        whole = build_problem(ARM4, known, friction=present, weighting="gls", prior=prior)
        theta = dict(zip(whole.base.theta_names, rng.uniform(0.0, 1.0, whole.n_theta), strict=True))
        all_of_it = np.array([theta.get(name, 0.0) for name in trial.base.theta_names])
        expected = whole.cost_of(np.array(list(theta.values())))
        assert trial.cost_of(all_of_it) == pytest.approx(expected, rel=COST)
        assert len(trial.feasible.rows) == trial.n_theta - whole.n_theta
    assert independent < samples.effort.size


@pytest.mark.parametrize("found", [False, True])
def test_a_solver_that_fails_costs_the_choice_and_not_the_problem(
    found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was found without a proof is enough to compare."""

    def failing(problem: Problem) -> Estimate:
        raise SolverError("no proof", found=solve_sdp(problem) if found else None)

    monkeypatch.setattr(selection, "solved_or_found", lambda x: solved_or_found(x, failing))
    problem = chosen(logged("tilt"))
    assert names(problem) == ({"tilt"} if found else set())
    assert bool(problem.origin.effects) == found
    assert (Tilt in {type(term) for term in problem.friction.terms}) == found
