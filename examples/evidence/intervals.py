"""How often intervals, comparisons and draws are right about a known truth, in four parts.

* ``periodic``: do 95 % intervals hold the truth 95 % of the time? Each seed draws its own
  excitation and noise for the Denso plant, well inside all constraints or exactly on them. Counted
  are the intervals of Gauss and Markov, the profile likelihood and the block bootstrap of
  `sdpid.confidence_intervals`.
* ``boundary``: a truth on the boundary of what is possible. Every draw adds white noise to the
  exact efforts of one motion, identifies, and asks for the 95 % profile interval of every base and
  standard parameter. Reported are the worst parameters of each case, beside the average.
* ``pairs``: pairs of logs of a simulated UR5, 100 s each, each with its own motion and noise, are
  compared (`Estimate.compare_to`): of the same robot, and with one link heavier.
* ``draws``: how often the draws of `sdpid.sample_parameters` surround the truth, of recordings of
  simulated_logs.py through `sdpid.identify` with its defaults, and of arms of ``boundary``, with a
  prior whose bodies differ from the truth anew in every run, and without a prior. Of each run 1000
  robots are drawn, and the central 95 % of the draws of each parameter are compared with the truth:
  of base parameters, and with a prior of standard ones.

    python examples/evidence/intervals.py --parts boundary --draws 200 --out results
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from simulated_logs import RADIUS, drawn, log_of, perturbed, there
from study import Rows, Study

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.plant.simulate import default_parameters, true_parameters
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.inertia import (
    Consistency,
    complement,
    physical_parameters,
    point_masses,
    second_moment_from_inertia,
    theta_from_physical,
)
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.workflow.formulate import formulate

DENSO = "denso_vp6242"
# Margin of the Denso on its boundary, kg·m².
MARGIN = 0.02
METHODS = ("gauss_markov", "profile", "bootstrap")

# The robot of pairs, the link that gets heavier, and by what share its ten parameters grow.
PAIRED, LINK, HEAVIER = "ur5_robot", 3, 0.2

# Of the motion of an arm; and the corners of a cube.
SAMPLES = 200
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1.0)])

# Arms that are drawn from, whose truth is inside and on the boundary.
DRAWN = ("rod on the axis", "inside", "plate", "point")
ARM, ALONE = "arm, ", ", no prior"
LEVEL = 0.95
# Standard deviation of the logarithms by which a prior's bodies differ from the truth, as those of
# simulated robots differ from their description.
DIFFERENT = 0.15


def body(size: float, center: list[float]) -> Array:
    """Return eight points in the corners of a cube, 1 kg in all, (10,)."""
    return np.asarray(point_masses(np.full(8, 0.125), size * CUBE + np.array(center)))


@dataclass(frozen=True)
class Case:
    """A two-link arm with crossing axes whose last link is given, (10,), and how it is measured."""

    last: Array
    mass_max: float = 1.0
    noise: float = 0.5
    margin: float = 0.0
    consistency: Consistency = "pseudo_inertia"

    @property
    def robot(self) -> sdpid.RobotModel:
        """The arm."""
        return sdpid.RobotModel.from_mdh([{"r": 0.2}, {"alpha": np.pi / 2}], name="arm")

    @property
    def theta(self) -> Array:
        """The truth."""
        return np.concatenate([body(0.1, [0.1, 0.05, 0.0]), self.last, [0.5, 0.4, 0.8, 0.6]])

    def measured(self) -> tuple[dict[str, Array], Array, BaseParameters]:
        """Return a motion, its exact efforts (K, n), and the base parameters."""
        rng, shape = np.random.default_rng(20), (SAMPLES, self.robot.n)
        # Ranges of positions, velocities and accelerations, rad and s.
        ranges = {"position": np.pi, "velocity": 3.0, "acceleration": 10.0}
        motion = {name: rng.uniform(-most, most, shape) for name, most in ranges.items()}
        samples = sdpid.Samples(**motion, effort=np.ones(shape))
        problem = sdpid.build_problem(self.robot, samples)
        return motion, problem.predict(problem.base_of(self.theta)), problem.base

    def problem(self, white: Array, **more: Any) -> Any:
        """Return the problem of a draw of noise, (K, n) of variance one."""
        motion, exact, base = self.measured()
        effort = exact + self.noise * white
        return sdpid.build_problem(
            self.robot,
            sdpid.Samples(**motion, effort=effort, block=4),
            base=base,
            constraints=sdpid.Constraints(mass_max=self.mass_max, margin=self.margin),
            consistency=self.consistency,
            **more,
        )


def rod(direction: list[float], start: list[float]) -> Array:
    """Return a thin rod of 1 kg and 0.3 m, (10,)."""
    steps = np.linspace(0.0, 0.3, 20)[:, None]
    unit = np.array(direction) / np.linalg.norm(direction)
    return np.asarray(point_masses(np.full(20, 0.05), np.array(start) + steps * unit))


def plate() -> Array:
    """Return a flat rectangle of 1 kg across no axis, (10,)."""
    sides = np.array([[0.3, 0.0, 0.1], [0.0, 0.2, 0.1]])
    grid = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)]) / 2.0
    return np.asarray(point_masses(np.full(9, 1.0 / 9.0), grid @ sides + [0.1, 0.05, 0.05]))


CASES = {
    "inside": Case(body(0.1, [0.1, 0.0, 0.05]), mass_max=20.0, noise=0.1),
    "rod on the axis": Case(rod([0, 0, 1], [0, 0, 0])),
    "rod off the axis": Case(rod([1, 0.3, 0.2], [0.05, 0.02, 0.0])),
    "plate": Case(plate()),
    "point": Case(point_masses(np.ones(1), np.array([[0.1, 0.05, 0.15]]))),
    # The 6×6 spatial inertia of the last link has exactly the margin asked for.
    "6x6 at its apex": Case(
        theta_from_physical(1.0, np.array([0.0, 0.0, 0.15]), 0.005 * np.eye(3)),
        margin=0.005,
        consistency="spatial_inertia",
    ),
}


def denso(*, boundary: bool) -> Array:
    """Return the Denso's parameters: its own links, or three plates and three rods on a margin."""
    theta = np.array(true_parameters(DENSO))
    if not boundary:
        return theta
    mass, com, inertia = physical_parameters(theta[:60].reshape(6, 10))
    for i in range(6):
        values, vectors = np.linalg.eigh(second_moment_from_inertia(inertia[i]))
        if i == 5:
            com[i, :2], vectors = 0.0, np.eye(3)
        kept = values * [0.0, float(i < 3), 1.0]
        inertia[i] = complement((vectors * kept) @ vectors.T + MARGIN * np.eye(3))
    theta[:60] = theta_from_physical(mass, com, inertia).ravel()
    return theta


def held(study: Study, case: str, seed: int) -> Rows:
    """Yield of every kind of interval the share that holds the truth of an experiment."""
    boundary = case != "inside"
    robot, theta = sdpid.load_robot(DENSO), denso(boundary=boundary)
    path = sdpid.paper_excitation(DENSO, seed, periods=study.periods, period=study.period)
    log = sdpid.simulate(robot, path, theta=theta, seed=seed, progress=False)
    constraints = sdpid.Constraints(margin=MARGIN) if boundary else sdpid.Constraints()
    samples = sdpid.process(log, progress=False)
    problem = sdpid.build_problem(robot, samples, constraints=constraints)
    estimate, names, truth = sdpid.solve_sdp(problem), problem.base.names, problem.base_of(theta)
    for method in METHODS:
        how: dict[str, Any] = {"method": method, "resamples": study.resamples, "seed": seed}
        found = sdpid.confidence_intervals(estimate, parameters=names, **how)
        yield case, method, found.contains(truth).mean()


def standard_error(own: dict[str, Array]) -> float | None:
    """Return that of a mean coverage, %: parameters of one experiment are correlated."""
    held = own["held"]
    return 100.0 * np.std(held, ddof=1) / np.sqrt(len(held)) if len(held) > 1 else None


def periodic(study: Study) -> None:
    """Count what holds of records with periods."""
    header, cases = ("case", "intervals", "held"), ("inside", "on the boundary")
    wanted = cases[:1] if study.quick else cases
    found = study.rows("each.csv", header, partial(held, study), wanted, range(study.seeds))
    columns = {"coverage_percent": "percent held", "error_percent": standard_error}
    study.summary("coverage.csv", found, header[:2], columns)


def held_of_arm(name: str, seed: int) -> Rows:
    """Yield of each parameter whether its interval holds the truth."""
    case = CASES[name]
    problem = case.problem(np.random.default_rng(seed).standard_normal((SAMPLES, case.robot.n)))
    base = problem.base
    names = (*base.names, *base.theta_names)
    truth = dict(zip(names, [*(base.matrix @ case.theta), *case.theta], strict=True))
    found = sdpid.confidence_intervals(sdpid.solve_sdp(problem), method="profile", n_jobs=1)
    yield from zip(found.names, found.contains([truth[each] for each in found.names]), strict=True)


def least_held(own: dict[str, Any], names: Iterable[str], count: int, digits: int) -> str:
    """Return the parameters that are held least often, %."""
    shares = {name: 100.0 * own["held"][own["parameter"] == name].mean() for name in names}
    least = sorted(shares, key=lambda name: shares[name])[:count]
    return ", ".join(f"{name} {shares[name]:.{digits}f}" for name in least)


def boundary(study: Study) -> None:
    """Count what holds of truths on the boundary."""
    arms = [*CASES][:1] if study.quick else CASES
    header = ("case", "run", "parameter", "held")
    found = study.rows("arms.csv", header, held_of_arm, arms, range(study.draws))
    columns: dict[str, Any] = {
        "draws": lambda own: study.draws,
        "held_least_percent": lambda own: least_held(own, dict.fromkeys(own["parameter"]), 6, 1),
        "mean_percent": "percent held",
    }
    study.summary("boundary_coverage.csv", found, ("case",), columns)


def compared(pair: int) -> Rows:
    """Yield whether the estimates of two logs agree, of one robot and of two."""
    robot = sdpid.load_robot(PAIRED)
    theta = default_parameters(robot)
    changed = np.array(theta)
    changed[10 * LINK : 10 * LINK + 10] *= 1.0 + HEAVIER

    def estimate(seed: int, parameters: Array) -> Estimate:
        # The seed draws the motion, too.
        log = sdpid.simulate(robot, theta=parameters, seed=seed, progress=False)
        return sdpid.solve_sdp(formulate(robot, log))

    first = estimate(2 * pair, theta)
    cases = {"same robot": theta, f"link {LINK + 1} +{100 * HEAVIER:g} %": changed}
    for case, parameters in cases.items():
        found = first.compare_to(estimate(2 * pair + 1, parameters))
        tested = sum(each.agree is not None for each in found.differences)
        yield case, not found.agree, tested, len(found.outside)


def pairs(study: Study) -> None:
    """Count how often estimates of one robot agree, and those of a changed robot differ."""
    header = ("case", "differ", "tested", "outside")
    found = study.rows("pairs.csv", header, compared, range(study.pairs))
    columns: dict[str, Any] = {
        "pairs": "count differ",
        "joint test differs": lambda own: f"{100 * own['differ'].mean():.0f} %",
        "single parameters differ": lambda own: (
            f"{100 * own['outside'].sum() / own['tested'].sum():.1f} %"
        ),
    }
    study.summary("agreement.csv", found, ("case",), columns)


def surrounded(
    estimate: Estimate, truth: Array, count: int, seed: int, *, standard: bool = True
) -> Rows:
    """Draw, and compare with the true standard parameters; NaN are unknown.

    Yield of a parameter with a known truth how far outside of its range the truth is, in widths of
    it; and of its run the least effective sample size, the largest R-hat, seconds of one core.
    """
    start = time.process_time()
    samples = sdpid.sample_parameters(estimate, count, seed)
    seconds = time.process_time() - start
    base = estimate.problem.base
    unknown = np.isnan(truth)
    true_base = base.matrix @ np.where(unknown, 0.0, truth)
    true_base[np.any(base.matrix[:, unknown] != 0.0, axis=1)] = np.nan
    sizes = samples.draws.effective_sizes.min(), samples.draws.r_hat.max()
    kinds = [("base", base.names, samples.base, true_base)]
    if standard:
        kinds.append(("standard", base.theta_names, samples.theta, truth))
    for kind, names, values, true in kinds:
        ends = 0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL)
        lower, upper = np.quantile(values, ends, axis=0)
        # A parameter that the constraints fix is known, and has no range to speak of.
        width = np.where(upper > lower, upper - lower, np.nan)
        outside = np.maximum(np.maximum(lower - true, true - upper), 0.0) / width
        for name, each in zip(names, outside, strict=True):
            if not np.isnan(each):
                yield kind, name, each, each == 0.0, *sizes, seconds


def run_of(count: int, name: str, seed: int) -> Rows:
    """Yield a run of a robot's log, or of an arm with noise and a prior of its own."""
    if not name.startswith(ARM):
        log, truth = log_of(drawn(name, seed), seed)
        estimate = sdpid.identify(truth.robot, log).estimate
        yield from surrounded(estimate, truth.theta(estimate.problem), count, seed)
        return
    prior = not name.endswith(ALONE)
    case = CASES[name.removeprefix(ARM).removesuffix(ALONE)]
    rng = np.random.default_rng(seed)
    white = rng.standard_normal((SAMPLES, case.robot.n))
    links = case.theta[: 10 * case.robot.n_links].reshape(-1, 10)
    thick = np.asarray(raise_second_moments(links, RADIUS**2 * links[:, 0]))
    belief = sdpid.Prior(bodies=perturbed(thick, DIFFERENT, rng)) if prior else None
    estimate = sdpid.solve_sdp(case.problem(white, weighting="residual", prior=belief))
    # Without a prior, what the data leave open has no other range than the possible ones.
    yield from surrounded(estimate, case.theta, count, seed, standard=prior)


def draws(study: Study) -> None:
    """Count how often draws surround the truth."""
    header = ("case", "run", "parameters", "parameter", "outside", "held", "size", "r_hat")
    arms = [f"{ARM}{name}{prior}" for name in study.arms for prior in ("", ALONE)]
    robots = there() if study.logs else ()
    runs = [*((name, k) for name in robots for k in range(study.logs))]
    runs += ((name, k) for name in arms for k in range(study.runs))
    found = study.rows("runs.csv", (*header, "seconds"), partial(run_of, study.count), runs)
    columns: dict[str, Any] = {
        "runs": lambda own: len(np.unique(own["run"])),
        "intervals": "count held",
        "held_percent": "percent held",
        "held_least_percent": lambda own: least_held(own, np.unique(own["parameter"]), 3, 0),
        "widths_outside_most": "max outside",
        "least_effective_size": "min size",
        "largest_r_hat": "max r_hat",
        "seconds": "median seconds",
    }
    study.summary("sample_coverage.csv", found, ("case", "parameters"), columns)


PARTS: dict[str, Callable[[Study], None]] = {
    "periodic": periodic,
    "boundary": boundary,
    "pairs": pairs,
    "draws": draws,
}


def main() -> None:
    """Run the parts that are asked for."""
    study = Study(
        __doc__,
        quick={
            **{"seeds": 1, "period": 19.0, "resamples": 80, "draws": 1, "pairs": 1},
            **{"arms": [DRAWN[0]], "runs": 1, "count": 100, "logs": 0},
        },
        parts=[*PARTS],
        seeds=(40, "experiments of periodic"),
        periods=12,
        period=(76.0, "s; the paper's is 380"),
        resamples=(200, "of the bootstrap"),
        draws=(200, "of the noise of boundary"),
        pairs=40,
        logs=(6, "logs of each robot that is drawn from"),
        runs=(40, "runs of each arm that is drawn from"),
        arms=[*DRAWN],
        count=(1000, "draws of each run"),
    )
    for part in study.parts:
        PARTS[part](study)


if __name__ == "__main__":
    main()
