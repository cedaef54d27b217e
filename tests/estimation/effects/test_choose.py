"""Nonlinear numbers of friction terms: found where the data say, and only there."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.optimize import nnls

import sdpid.estimation.effects.choose as profile_module
from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.effects.choose import close_terms
from sdpid.estimation.effects.variable_projection import OpenTerm, VariableProjection
from sdpid.estimation.problem import build_problem, describe
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm, OpenParameter
from sdpid.robot.friction.terms import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    SigmoidFriction,
    Stribeck,
)
from sdpid.robot.model.base_parameters import generic_states, structural_base
from sdpid.robot.model.load import load_robot
from tests.helpers.data import (
    friction_model,
    full_regressor,
    make_samples,
    random_covariance,
    random_theta,
)
from tests.helpers.robots import TREE, small_arm

ARM = small_arm(3)
NAMES = ARM.joint_names

# The search stops at 2 %; a second round about the same point does no worse.
FOUND = 0.03


def made(*terms: str | FrictionTerm, seed: int = 1, noise: float = 0.0, **fields: Any) -> Samples:
    rng = np.random.default_rng(seed)
    theta = random_theta(ARM, rng, terms)
    return make_samples(
        ARM, theta, rng, count=400, noise=noise, friction=terms, joint_names=NAMES, **fields
    )


@pytest.mark.parametrize(
    ("truth", "asked"),
    [
        (Coulomb(width=(0.3, 0.6, 1.0)), Coulomb(width=None)),
        (AsymmetricCoulomb(width=(0.3, 0.6, 1.0)), AsymmetricCoulomb(width=None)),
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
    problem = build_problem(ARM, made(truth, *rest), friction=(asked, *rest))
    closed = problem.friction.terms[0]
    assert type(closed) is type(truth)
    for name in ("width", "velocity"):
        if hasattr(truth, name):
            found, expected = getattr(closed, name), getattr(truth, name)
            np.testing.assert_allclose(found, expected, rtol=5 * FOUND if "wid" in name else FOUND)
    assert all(p.lower <= p.flat_from <= p.value <= p.flat_to <= p.upper for p in problem.profiled)
    assert all(p.determined for p in problem.profiled)


def test_several_terms_with_noise() -> None:
    """As good a fit as with the true numbers, which is all that the data can say."""
    truth = (Coulomb(width=0.2), Stribeck(velocity=(0.5, 0.7, 0.9)), "viscous")
    samples = made(*truth, noise=0.05)
    asked = (Coulomb(width=None), "stribeck", "viscous")
    problem = build_problem(ARM, samples, friction=asked)
    exact = build_problem(ARM, samples, friction=truth)
    assert problem.floor <= 1.001 * exact.floor
    assert len(problem.profiled) == 6
    again = build_problem(ARM, samples, friction=asked)
    assert again.profiled == problem.profiled
    np.testing.assert_array_equal(again.A, problem.A)


def search_of(samples: Samples, terms: tuple[FrictionTerm | str, ...], sigma: Array) -> Any:
    """Return a search at the middle of the limits, and its rows."""
    model = friction_model(ARM, terms)
    speeds = list(np.abs(samples.velocity).T)
    opened = [
        OpenTerm(k, t, p)
        for k, t in enumerate(model.terms)
        if (p := t.open_parameters(speeds, NAMES))
    ]
    closed = list(model.terms)
    for each in opened:
        closed[each.place] = each.closed
    model = replace(model, terms=tuple(closed))
    rows = RowSource(ARM, model, structural_base(ARM, model), samples)
    return VariableProjection(rows, sigma, opened), opened, model


@pytest.mark.parametrize("kind", ["one", "each"])
@pytest.mark.parametrize("masked", [False, True])
def test_the_cost_is_that_of_the_raw_rows(kind: str, masked: bool) -> None:
    rng = np.random.default_rng(5)
    mask = rng.random((400, 3)) < 0.7 if masked else None
    terms = (Coulomb(width=0.3), Stribeck(0.6), "viscous")
    samples = made(*terms, noise=0.1, mask=mask)
    sigma = random_covariance(rng, 3, None if kind == "one" else 400)
    asked = (Coulomb(width=None), Stribeck(), "viscous")
    search, opened, _ = search_of(samples, asked, sigma)
    search.run()
    closed = (opened[0].closed, opened[1].closed, "viscous")
    W = full_regressor(ARM, (samples.position, samples.velocity, samples.acceleration), closed)
    stacked, target = [], []
    for k in range(400):
        used = np.flatnonzero(np.ones(3) if mask is None else mask[k])
        if used.size:
            L = np.linalg.cholesky((sigma if kind == "one" else sigma[k])[np.ix_(used, used)])
            stacked.append(np.linalg.solve(L, W[k][used]))
            target.append(np.linalg.solve(L, samples.effort[k][used]))
    matrix, rhs = np.concatenate(stacked), np.concatenate(target)
    best = np.linalg.lstsq(matrix, rhs, rcond=1e-10)[0]
    assert search.cost == pytest.approx(float(np.sum((matrix @ best - rhs) ** 2)), rel=1e-6)


def test_a_negative_peak_does_not_imitate_a_smooth_sign() -> None:
    """Unsigned, the peak would be the difference between an exact and a smooth sign."""
    samples = made(Coulomb(width=0.4), "viscous")
    rows = ("coulomb", "viscous", Stribeck())
    search, _, _ = search_of(samples, rows, np.eye(3))
    search.run()
    without, _, _ = search_of(samples, ("coulomb", "viscous", Flat()), np.eye(3))
    assert search.cost == pytest.approx(without.cost, rel=1e-6)


@dataclass(frozen=True)
class Flat(JointwiseTerm):
    """A term without effect and with an open number."""

    symbol: ClassVar[str] = "Fx"
    unit: ClassVar[str] = "N.m"
    nonnegative: ClassVar[bool] = True
    velocity: float | tuple[float, ...] | None = None
    speed_fields: ClassVar[tuple[str, ...]] = ("velocity",)

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        return np.zeros_like(velocity)


def test_without_effect_the_middle_is_kept() -> None:
    problem = build_problem(ARM, made("viscous"), friction=("viscous", Flat()))
    for p in problem.profiled:
        assert p.value == pytest.approx(np.sqrt(p.lower * p.upper))
        assert (p.flat_from, p.flat_to) == (p.lower, p.upper)
        assert not p.determined


@dataclass(frozen=True)
class Power(FrictionTerm):
    """sign(v)·|v|^e, with one exponent for the robot, chosen by the data."""

    exponent: float | None = None

    def parameters(self, joint_names: Sequence[str]) -> Any:
        return Coulomb().parameters(joint_names)

    def columns(self, velocity: Array, acceleration: Array, joint_names: Sequence[str]) -> Array:
        assert self.exponent is not None
        shape = np.sign(velocity) * np.abs(velocity) ** self.exponent
        return np.asarray(shape[:, :, None] * np.eye(len(joint_names)))

    def open_parameters(
        self, speeds: Sequence[Array], joint_names: Sequence[str]
    ) -> tuple[OpenParameter, ...]:
        return (OpenParameter("exponent", 0.1, 3.0, "1"),) if self.exponent is None else ()

    def with_values(self, values: Sequence[float]) -> Power:
        return Power(values[0])


def test_a_term_of_ones_own_with_one_number_for_all_joints() -> None:
    problem = build_problem(ARM, made(Power(0.4), "offset"), friction=(Power(), "offset"))
    (found,) = problem.profiled
    assert (found.term, found.name, found.unit) == ("Power", "exponent", "1")
    assert found.value == pytest.approx(0.4, rel=FOUND)


@pytest.mark.parametrize("weighting", ["gls", "gls_per_sample", "eq9", "eq18", "residual"])
def test_every_weighting(weighting: Any) -> None:
    truth = Coulomb(width=(0.3, 0.6, 1.0))
    sigma = random_covariance(np.random.default_rng(2), 3, 400)
    samples = made(truth, "viscous", noise=0.01, covariance=sigma)
    problem = build_problem(
        ARM, samples, friction=(Coulomb(width=None), "viscous"), weighting=weighting
    )
    np.testing.assert_allclose([p.value for p in problem.profiled], truth.width, rtol=0.1)


def test_only_rows_in_use_count() -> None:
    """Nobody measured the last joint, nor the efforts of a floating base."""
    samples = made(Coulomb(width=0.5), "viscous")
    mask = np.ones((400, 3), dtype=bool)
    mask[:, 2] = False
    wrong = samples.effort.copy()
    wrong[:, 2] = 1e3
    both = [
        close_terms(
            friction_model(ARM, (Coulomb(width=None), "viscous")),
            ARM,
            replace(samples, mask=mask, effort=effort),
            lambda _: np.eye(3),
        )[1]
        for effort in (samples.effort, wrong)
    ]
    assert both[0] == both[1]
    assert [p.determined for p in both[0]] == [True, True, False]


def test_a_floating_base() -> None:
    robot = load_robot(TREE, root="free_flyer")
    rng = np.random.default_rng(4)
    terms = (Coulomb(width=2.0), "viscous")
    q, v, a = generic_states(robot, 300, 9)
    effort = full_regressor(robot, (q, v, a), terms) @ random_theta(robot, rng, terms)
    mask = np.ones(effort.shape, dtype=bool)
    mask[:, :6] = False
    samples = Samples(position=q, velocity=v, acceleration=a, effort=effort, mask=mask)
    model = friction_model(robot, (Coulomb(width=None), "viscous"))
    _, chosen = close_terms(model, robot, samples, lambda _: np.eye(robot.n))
    np.testing.assert_allclose([p.value for p in chosen], 2.0, rtol=FOUND)


def test_long_records_are_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    sigma = random_covariance(np.random.default_rng(2), 3, 400)
    samples = made(Coulomb(width=0.5), "viscous", covariance=sigma)
    asked = (Coulomb(width=None), "viscous")
    whole = build_problem(ARM, samples, friction=asked, weighting="gls_per_sample")
    monkeypatch.setattr(profile_module, "_MOST_SAMPLES", 130)
    thinned = build_problem(ARM, samples, friction=asked, weighting="gls_per_sample")
    for a, b in zip(whole.profiled, thinned.profiled, strict=True):
        assert a.value == pytest.approx(b.value, rel=FOUND)
    assert thinned.n_rows == whole.n_rows


def test_closed_terms_are_left_alone() -> None:
    samples = made("coulomb", "viscous")
    problem = build_problem(ARM, samples)
    assert problem.profiled == ()
    assert describe(problem)["profiled"] == []


def test_the_choice_is_shown() -> None:
    samples = made(Coulomb(width=0.5), "viscous", noise=0.01)
    problem = build_problem(ARM, samples, friction=(Coulomb(width=None), "viscous"))
    shown = describe(problem)
    assert json.loads(json.dumps(shown)) == shown
    assert [t["term"] for t in shown["friction_terms"]] == ["Coulomb", "Viscous"]
    assert shown["friction_terms"][0]["width"] == [p["value"] for p in shown["profiled"]]
    assert {"term", "name", "value", "flat_from", "flat_to"} <= set(shown["profiled"][0])
    # The estimate predicts other samples with the chosen values.
    fresh = made(Coulomb(width=0.5), "viscous", seed=1)
    error = problem.predict(solve_wls(problem).base, fresh) - fresh.effort
    assert np.sqrt(np.mean(error**2)) < 0.02


@pytest.mark.parametrize("seed", range(5))
def test_the_signed_fit_is_scipys(seed: int) -> None:
    """Least cost over the open columns, none of them negative."""
    rng = np.random.default_rng(seed)
    # Efforts that pull both ways, so that signs matter.
    samples = replace(made("viscous", seed=seed), effort=rng.normal(size=(400, 3)))
    asked = (Coulomb(width=None), Stribeck(), SigmoidFriction(), "viscous", "offset")
    search, opened, _ = search_of(samples, asked, np.eye(3))
    closed = (*(each.closed for each in opened), "viscous", "offset")
    W = full_regressor(ARM, (samples.position, samples.velocity, samples.acceleration), closed)
    matrix = W.reshape(-1, W.shape[2])
    # Terms without an open number may take any sign: they and the links are projected out.
    names = [p.name for p in friction_model(ARM, closed).parameters]
    fixed = np.r_[0:30, 30 + np.array([k for k, n in enumerate(names) if n[:2] in ("Fv", "Fo")])]
    columns = np.delete(matrix, fixed, axis=1)
    U, s, _ = np.linalg.svd(matrix[:, fixed], full_matrices=False)
    Q = U[:, s > 1e-9 * s[0]]
    effort = samples.effort.ravel()
    rest = nnls(columns - Q @ (Q.T @ columns), effort - Q @ (Q.T @ effort))[1]
    assert search.cost == pytest.approx(rest**2, rel=1e-6)
