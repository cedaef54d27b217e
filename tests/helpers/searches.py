"""Small searches: of a planar arm with two joints, within limits of its joints alone."""

from dataclasses import dataclass
from typing import Any

import numpy as np

import sdpid
from sdpid.excitation.criterion.criterion import Criterion, Objective, ObjectiveKind
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.limits.check import LimitCheck, check_trajectory
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.search.search import Search
from sdpid.excitation.search.space import SplineSpace
from sdpid.robot.model.model import RobotModel
from tests.helpers.robots import planar_arm

LIMITS = sdpid.Limits(lower=-1.5, upper=1.0, velocity=2.0, acceleration=4.0, jerk=40.0, share=1.0)


@dataclass(frozen=True)
class JointsAlone:
    """No limits beside those of the joints."""

    robot: RobotModel
    limits: JointLimits

    def rows(self, space: Any) -> None:
        return None

    def learn(self, check: LimitCheck) -> None:
        raise AssertionError("linear limits hold at every instant")

    def check(self, curve: Any) -> LimitCheck:
        return check_trajectory(self.robot, curve, self.limits, collision=False)


def criterion_of(robot: RobotModel, kind: ObjectiveKind, friction: tuple[str, ...]) -> Criterion:
    rows = BaseRows.of(robot, friction)
    known = np.zeros((rows.count, rows.count))
    return Criterion(rows=rows, objective=Objective(kind=kind), rates=np.ones(robot.n), known=known)


def search_of(limits: sdpid.Limits = LIMITS, **settings: Any) -> Search:
    robot = planar_arm()
    joints = limits.of(robot)
    return Search(
        space=SplineSpace.of(robot.n, 4.0, intervals=8),
        criterion=criterion_of(robot, "mixed", ("viscous",)),
        limits=joints,
        inequalities=JointsAlone(robot, joints),
        name=robot.name,
        **settings,
    )
