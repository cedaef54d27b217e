"""What is gained, and what lost, where left and right legs are said to be alike.

Go1, A1 and Solo12 in MuJoCo trot, and that alone is fitted; judged on a walk. Their links are 15 %
off the description in two ways: *mirrored*, right links being the images of left ones and friction
the same on both sides, or *unlike*, each link and each drive's friction by itself. Friction terms
are known, not their sizes. What is said beside the data and the prior of one nat:

* ``nothing``;
* ``mirror``: right links are mirror images of left ones; ``within 5 %``, ``within 20 %``: believed;
* ``friction``: of left and right joints it is equal; ``friction within 20 %``;
* ``both within 20 %``: links, believed, and friction.

    python examples/evidence/legged_mirror.py --seeds 3 --out results
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from legged import Walker
from study import Study, grouped

import sdpid
from sdpid._common.arrays import Array
from sdpid.constraints import Condition, Layout, Row, equal_friction, mirror_pairs
from sdpid.estimation.prior.prior import prior_terms
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.legged.truth import changed_parameters
from sdpid.robot.friction.model import FrictionModel
from sdpid.workflow.formulate import formulate

ROBOTS = ("go1", "a1", "solo12")
# Drives that are not alike differ by about this share, as their links do.
CHANGE = 0.15
CELL = ("robot", "truth", "said", "seed", "joints_percent", "base_force_n", "mass_percent")
COLUMNS = (
    "robot", "truth", "said", "seeds", "joints_percent", "joints_worst_percent",
    "base_force_n", "base_force_worst_n", "mass_percent",
)  # fmt: skip
# What is said of links (by how much they differ) and of friction; None says nothing.
SAID: dict[str, tuple[float | None, float | None]] = {
    "nothing": (None, None),
    "mirror": (0.0, None),
    "within 5 %": (0.05, None),
    "within 20 %": (0.2, None),
    "friction": (None, 0.0),
    "friction within 20 %": (None, 0.2),
    "both within 20 %": (0.2, 0.2),
}


@dataclass(frozen=True)
class Mirrored(Walker):
    """A robot whose left and right are alike, or not."""

    alike: bool

    @cached_property
    def theta(self) -> Array:
        """True parameters."""
        theta = np.array(changed_parameters(self.robot, change=CHANGE, seed=self.seed))
        friction = slice(10 * self.robot.n_links, None)
        if not self.alike:
            rng = np.random.default_rng([18, self.seed])
            theta[friction] *= np.exp(CHANGE * rng.normal(size=len(theta[friction])))
            return theta
        model = FrictionModel.from_terms(
            self.friction, self.robot.joint_names, first=self.robot.n_base
        )
        layout = Layout(self.robot, FrictionModel.from_terms((), self.robot.joint_names, first=6))
        for pair in mirror_pairs(self.robot):
            own = slice(10 * layout.link(pair.second), 10 * layout.link(pair.second) + 10)
            rows = [row for row in pair.compile(layout) if isinstance(row, Row)]
            # The second link is what it is less the difference that should be none.
            differences = [row.coefficients @ theta[: layout.count] for row in rows]
            theta[own] -= np.array(differences)
        joints = model.joint_names
        sizes = theta[friction].reshape(3, -1)
        for drives in equal_friction(self.robot):
            sizes[:, joints.index(drives.second)] = sizes[:, joints.index(drives.first)]
        return theta


def said(problem: Problem, quadruped: Mirrored, what: str) -> Problem:
    """Return the problem with what is said."""
    within, friction = SAID[what]
    others: list[Condition] = []
    if within == 0.0:
        others += mirror_pairs(quadruped.robot)
    if friction is not None:
        others += equal_friction(quadruped.robot, within=friction)
    problem = problem.constrained(constraints=problem.constraints.replace(others=others))
    if within:
        prior = sdpid.Prior(alike=mirror_pairs(quadruped.robot), within=within)
        problem = replace(problem, prior=prior_terms(prior, problem.require_rows("study")))
    return problem


def cells(name: str, seed: int, seconds: float, alike: bool) -> Iterator[tuple[object, ...]]:
    """Yield what one robot says."""
    quadruped = Mirrored(name, seed, seconds, alike)
    runs = {motion: quadruped.run(motion) for motion in ("trot", "walk")}
    quadruped.__dict__["runs"] = runs
    problem = formulate(
        quadruped.robot, [runs["trot"].recording], friction=quadruped.friction, effects="none"
    )
    for what in SAID:
        estimate = sdpid.solve_sdp(said(problem, quadruped, what))
        truth = "mirrored" if alike else "unlike"
        yield name, truth, what, seed, *quadruped.judged(estimate)


def main() -> None:
    """Write the table: medians and the worst of all seeds."""
    study = Study(
        __doc__,
        quick={"seeds": 1, "seconds": 2.0, "robots": ["solo12"]},
        seeds=3,
        seconds=4.0,
        robots=[*ROBOTS],
    )
    cases = itertools.product(range(study.seeds), study.robots, (True, False))
    found = study.rows(
        "cells.csv", CELL, cases, lambda case: cells(case[1], case[0], study.seconds, case[2])
    )
    rows = []
    for key, own in grouped(found, "robot", "truth", "said"):
        joints, force, mass = (own[column] for column in CELL[4:])
        ends = (np.median(joints), joints.max(), np.median(force), force.max(), np.median(mass))
        rows.append((*key, len(joints), *ends))
    study.write("legged_mirror.csv", COLUMNS, rows)


if __name__ == "__main__":
    main()
