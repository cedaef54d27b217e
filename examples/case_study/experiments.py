"""Simulate and process the experiments of the Denso case study, on either plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from joblib import Parallel, cpu_count, delayed

import sdpid
from sdpid import plots

ROBOT = "denso_vp6242"
FOLDER = Path(__file__).resolve().parents[2] / "models" / ROBOT
AXES = 6

# Whether a plant has effects that no linear model has.
PLANTS = {"ideal": False, "unmodeled": True}

# Simulations at a time: at the paper's size each holds 4.6 million samples, a gigabyte.
JOBS = 2


def true_theta() -> np.ndarray:
    """Return the standard parameters of both plants."""
    return np.loadtxt(FOLDER / "true_parameters.csv", delimiter=",", skiprows=1, usecols=2)


@dataclass(frozen=True)
class Size:
    """Size of the experiments.

    Attributes
    ----------
    periods : int
        Recorded periods.
    period : float
        Length of a period, s.
    seed : int
        Of motion and noise; the second experiment has another.
    window : tuple of float
        Seconds of the record that the picture of the filtering shows.
    """

    periods: int
    period: float
    seed: int
    window: tuple[float, float]

    def trajectory(self, *, fresh: bool = False) -> sdpid.Trajectory:
        """Return the paper's excitation, for the second experiment another one."""
        return sdpid.paper_excitation(
            ROBOT, self.number(fresh=fresh), periods=self.periods, period=self.period
        )

    def number(self, *, fresh: bool) -> int:
        """Return the seed of an experiment."""
        return self.seed + 1000 * fresh

    @property
    def processing(self) -> tuple[sdpid.Processing, sdpid.Processing]:
        """The default for periodic records, and section III-C to the letter."""
        # Sigma_k needs more periods than joints; with fewer its pooled form is used throughout.
        kind = "pooled" if self.periods <= AXES + 1 else "period"
        default = sdpid.Processing(covariance=kind)
        return default, replace(sdpid.Processing.paper(), covariance=kind)


@dataclass(frozen=True)
class Experiment:
    """What is measured on a plant.

    Attributes
    ----------
    samples, literal : Samples
        The experiment, processed by default and by section III-C to the letter.
    check, check_literal : Samples
        The second experiment, processed the same ways.
    floor : ndarray, shape (6,)
        Root mean square of the second experiment's noise on its rows, N·m.
    """

    samples: sdpid.Samples
    literal: sdpid.Samples
    check: sdpid.Samples
    check_literal: sdpid.Samples
    floor: np.ndarray


def run_experiments(
    plants: Sequence[str], size: Size, out: Path, report: Callable[[int, int], None]
) -> dict[str, Experiment]:
    """Simulate and process all experiments, and draw the filtering of each plant's first.

    `report` is called with how many are done, and of how many, after each.
    """
    kinds = ("first", "fresh", "noiseless")
    tasks = [(plant, kind) for plant in plants for kind in kinds]
    work = Parallel(n_jobs=min(JOBS, cpu_count()), return_as="generator")
    found = {}
    results = work(delayed(_measured)(*task, size, out) for task in tasks)
    for count, (task, samples) in enumerate(zip(tasks, results, strict=True), 1):
        found[task] = samples
        report(count, len(tasks))
    experiments = {}
    for plant in plants:
        (samples, literal), (check, check_literal), (exact,) = (
            found[plant, kind] for kind in kinds
        )
        noise = np.where(check.mask, check.effort - exact.effort, 0.0)
        floor = np.sqrt((noise**2).sum(axis=0) / check.mask.sum(axis=0))
        experiments[plant] = Experiment(samples, literal, check, check_literal, floor)
    return experiments


def _measured(plant: str, kind: str, size: Size, out: Path) -> list[sdpid.Samples]:
    """Return the samples of one experiment, as often as it is processed."""
    fresh = kind != "first"
    log = sdpid.simulate(
        sdpid.load_robot(ROBOT),
        size.trajectory(fresh=fresh),
        theta=true_theta(),
        seed=size.number(fresh=fresh),
        noise=kind != "noiseless",
        unmodeled=PLANTS[plant],
    )
    if kind == "noiseless":
        return [sdpid.process(log, replace(size.processing[0], covariance=None))]
    if kind == "first":
        title = "Axis 1 before and after filtering"
        stages = sdpid.Processing.paper().stages(log, 0, window=size.window)
        plots.save_figure(stages.plot(title=title), out / plant / "figure_3.png")
    return [sdpid.process(log, processing) for processing in size.processing]
