"""The equations of motion of a tree in 50 digits: Newton and Euler, out to the tips and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mpmath as mp
import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.regressor_kernel import FLOATING, PRISMATIC, REVOLUTE, Tree

DIGITS = 50


def exact_regressor(robot: RobotModel, q: Array, v: Array, a: Array) -> Any:
    """Return the regressor (n, 10·links) of one sample as an array of 50-digit numbers."""
    tree = robot.tree
    with mp.workdps(DIGITS):
        motion = ExactMotion(tree, robot.offset, q, v, a)
        columns = [motion.efforts(i, unit) for i in range(len(tree.kind)) for unit in np.eye(10)]
        return np.array(columns, dtype=object).T


def exact_jacobian(
    robot: RobotModel, q: Array, link: int, place: Array, offset: Array
) -> tuple[Any, Any]:
    """Return the efforts (n, 3) of unit forces along the world's axes at a point, and of moments.

    The point is at `place` in a link, and at `offset` from there in the world's axes.
    """
    tree = robot.tree
    with mp.workdps(DIGITS):
        motion = ExactMotion(tree, robot.offset, q, np.zeros(robot.n), np.zeros(robot.n))
        R, i = numbers(np.eye(3)), link
        while i >= 0:
            R, i = motion.R[i].dot(R), int(tree.parent[i])
        forces, moments = [], []
        for axis in numbers(np.eye(3)):
            own = R.T.dot(axis)
            moment = _cross(numbers(place), own) + R.T.dot(_cross(numbers(offset), axis))
            forces.append(motion.felt(link, own, moment))
            moments.append(motion.felt(link, numbers(np.zeros(3)), own))
        return np.array(forces, dtype=object).T, np.array(moments, dtype=object).T


def numbers(values: Any) -> Any:
    """Return doubles as 50-digit numbers."""
    return np.vectorize(mp.mpf, otypes=[object])(np.asarray(values, dtype=float))


def _cross(x: Any, y: Any) -> Any:
    return np.array([x[i] * y[j] - x[j] * y[i] for i, j in ((1, 2), (2, 0), (0, 1))])


class ExactMotion:
    def __init__(self, tree: Tree, offset: Array, q: Array, v: Array, a: Array) -> None:
        self.tree = tree
        self.factor = numbers(tree.factor)
        self.v, self.a = (self.factor * numbers(x)[tree.column] for x in (v, a))
        self.R: list[Any] = []
        self.r: list[Any] = []
        self.motions: list[tuple[Any, Any, Any]] = []
        stored = FLOATING in tree.kind
        for i, p in enumerate(tree.parent):
            to = tree.first_v[i]
            if stored:
                own = numbers(q[tree.first_q[i] :])
            else:
                own = self.factor[to] * numbers(q[[tree.column[to]]]) + mp.mpf(float(offset[to]))
            self._place(i, own, stored)
            self._move(i, int(p))

    def _place(self, i: int, q: Any, stored: bool) -> None:
        tree = self.tree
        turn, place = numbers(tree.turn[i]), numbers(tree.place[i])
        if tree.kind[i] == PRISMATIC:
            R, place = turn[2], [place[0] + place[1] * q[0]]
        elif tree.kind[i] == FLOATING:
            x, y, z, w = q[3:7]
            S = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            R = turn[2].dot(numbers(np.eye(3)) + 2 * w * S + 2 * S.dot(S))
        else:
            cosine, sine = (
                (q[0], q[1]) if stored and tree.unbounded[i] else (mp.cos(q[0]), mp.sin(q[0]))
            )
            R = turn[0] * cosine + turn[1] * sine + turn[2]
        self.R.append(R)
        self.r.append(place[0])

    def _move(self, i: int, p: int) -> None:
        tree, R, r, to = self.tree, self.R[i], self.r[i], int(self.tree.first_v[i])
        zero = numbers(np.zeros(3))
        w, al, b = self.motions[p] if p >= 0 else (zero, zero, -numbers(tree.gravity))
        b = R.T.dot(b + _cross(al, r) + _cross(w, _cross(w, r)))
        w, al = R.T.dot(w), R.T.dot(al)
        axis = numbers(tree.axis[i])
        if tree.kind[i] == FLOATING:
            w, al = self.v[to + 3 : to + 6], self.a[to + 3 : to + 6]
            b = b + self.a[to : to + 3] + _cross(w, self.v[to : to + 3])
        elif tree.kind[i] == REVOLUTE:
            speed = axis * self.v[to]
            al = al + axis * self.a[to] + _cross(w, speed)
            w = w + speed
        else:
            b = b + axis * self.a[to] + 2 * _cross(w, axis * self.v[to])
        self.motions.append((w, al, b))

    def efforts(self, i: int, unit: Sequence[float]) -> Any:
        """Return the efforts of all coordinates for one parameter of link i."""
        w, al, b = self.motions[i]
        m, h = mp.mpf(unit[0]), numbers(unit[1:4])
        xx, xy, yy, xz, yz, zz = numbers(unit[4:])
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        force = m * b + _cross(al, h) + _cross(w, _cross(w, h))
        moment = _cross(h, b) + inertia.dot(al) + _cross(w, inertia.dot(w))
        return self.felt(i, force, moment)

    def felt(self, i: int, force: Any, moment: Any) -> Any:
        """Return the efforts of a force at the origin of link i and a moment, in its own axes."""
        found = numbers(np.zeros(self.tree.n))
        while i >= 0:
            to, column = int(self.tree.first_v[i]), self.tree.column
            if self.tree.kind[i] == FLOATING:
                found[column[to : to + 6]] += np.concatenate([force, moment])
            else:
                along = moment if self.tree.kind[i] == REVOLUTE else force
                found[column[to]] += self.factor[to] * numbers(self.tree.axis[i]).dot(along)
            force, moment = self.R[i].dot(force), self.R[i].dot(moment)
            moment = moment + _cross(self.r[i], force)
            i = int(self.tree.parent[i])
        return found
