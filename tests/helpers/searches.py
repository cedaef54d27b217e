"""Small searches: of a planar arm with two joints, within limits of its joints alone."""

from types import SimpleNamespace
from typing import Any

import numpy as np

import sdpid
from sdpid.excitation.criterion.criterion import Criterion, Objective, ObjectiveKind
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.search.search import Search
from sdpid.excitation.search.space import SplineSpace
from sdpid.robot.model.model import RobotModel
from tests.helpers.robots import planar_arm

LIMITS = sdpid.Limits(lower=-1.5, upper=1.0, velocity=2.0, acceleration=4.0, jerk=40.0, share=1.0)


def criterion_of(robot: RobotModel, kind: ObjectiveKind, friction: tuple[str, ...]) -> Criterion:
    rows = BaseRows.of(robot, friction)
    known = np.zeros((rows.count, rows.count))
    return Criterion(rows=rows, objective=Objective(kind=kind), rates=np.ones(robot.n), known=known)


def search_of(limits: sdpid.Limits = LIMITS, **settings: Any) -> Search:
    robot = planar_arm()
    return Search(
        space=SplineSpace.of(robot.n, 4.0, intervals=8),
        criterion=criterion_of(robot, "mixed", ("viscous",)),
        limits=limits.of(robot),
        # None beside those of the joints.
        inequalities=SimpleNamespace(rows=lambda space: None),  # type: ignore[arg-type]
        name=robot.name,
        **settings,
    )
