"""`TorqueModel`: the torques that a motion needs, how uncertain they are, and their bounds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import Posterior
from sdpid.estimation.prior.prior import Prior, link_rows
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm
from sdpid.robot.inertia import inertia_tensor
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel, each_state

# Shares of the torque limit that are kept for what a model does not know: most descriptions have no
# friction, which takes 10 to 20 % of an arm's rated torque; an identified model leaves residuals.
_WITHOUT_FRICTION, _WITH_FRICTION, _IDENTIFIED = 0.2, 0.1, 0.05

# Descriptions have placeholders for friction, such as 1 N·m for every joint. What takes more than
# this part of the torque limit at full speed is one.
_MOST_FRICTION = 0.5

# Step of the central differences of friction curves, rad/s: far below any width of a sign.
_STEP = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueModel:
    """The torques of a robot along a motion.

    Attributes
    ----------
    dynamics : RobotDynamics
        The robot and its parameters, friction included.
    deviations : float
        How many standard deviations of the parameters are added; 0 for the nominal model.
    roots : ndarray, shape (links, 10, r)
        Of each link, rows of a root of the parameters' covariance.
    independent : bool
        Whether the links' errors are independent, each with its own r columns.
    friction_deviations : ndarray, shape (f,)
        Standard deviations of the parameters of friction.
    reserve : float
        Share of the torque limits that is kept for what the model does not know.
    notes : tuple of str
        What the model is and leaves out, one sentence each.
    """

    dynamics: RobotDynamics
    deviations: float
    roots: Array
    independent: bool
    friction_deviations: Array
    reserve: float
    notes: tuple[str, ...]

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        estimate: Estimate | RobotDynamics | None = None,
        *,
        spread: float = 0.0,
        reserve: float | None = None,
        prior: Prior | None = None,
    ) -> TorqueModel:
        """Build from a description or an estimate.

        Parameters
        ----------
        robot : RobotModel
            On a fixed base.
        estimate : Estimate or RobotDynamics, optional
            In place of the description's links and friction.
        spread : float, optional
            How many standard deviations of the parameters are added to the torques: those of the
            estimate, or of the prior about the description. By default none, the nominal model.
        reserve : float, optional
            Share of the torque limits to keep; by default 20 % where the description has no
            friction, 10 % where it has, and 5 % with an estimate.
        prior : Prior, optional
            What is believed of the description's links; by default that of `sdpid.identify`.

        Raises
        ------
        DataError
            When spread or reserve is out of range, the estimate is of another robot, or its
            errors are not known.
        """
        if not (np.isfinite(spread) and spread >= 0.0):
            raise DataError(f"torque: spread is {spread}; give a number of deviations from 0.")
        dynamics, words, usual = _dynamics(robot, estimate)
        kept = usual if reserve is None else reserve
        if not 0.0 <= kept < 1.0:
            raise DataError(f"torque: reserve is {kept}; give a share from 0 to below 1.")
        notes = [*words]
        if kept:
            notes.append(
                f"{100.0 * kept:g} % of every torque limit are kept for what the model lacks."
            )
        links, friction = robot.n_links, len(dynamics.terms.parameters)
        deviations: Array = np.zeros(friction)
        roots: Array = np.zeros((links, 10, 1))
        independent = True
        if spread and isinstance(estimate, Estimate):
            roots, deviations = _roots_of_estimate(estimate, links)
            independent = False
            notes.append(f"{spread:g} standard deviations of the estimate are added.")
        elif spread:
            rows = link_rows(Prior() if prior is None else prior, robot)
            roots = np.asarray(np.linalg.inv(rows))
            notes.append(f"{spread:g} standard deviations of the prior are added.")
        return cls(
            dynamics=dynamics,
            deviations=float(spread),
            roots=roots,
            independent=independent,
            friction_deviations=deviations,
            reserve=float(kept),
            notes=tuple(notes),
        )

    @property
    def robot(self) -> RobotModel:
        """The robot."""
        return self.dynamics.robot

    @property
    def known(self) -> bool:
        """Whether any link has a mass: of a description without, torques cannot be checked."""
        return bool(np.any(self.dynamics.theta[: 10 * self.robot.n_links : 10] != 0.0))

    def allowed(self, limit: Array) -> Array:
        """Return what the model's torques may use of limits (n,)."""
        return np.asarray((1.0 - self.reserve) * np.asarray(limit))

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """Return the nominal torques (K, n) of states (K, n), friction included, N·m (N)."""
        links = self.links(q, v, a)
        return links + self.friction(v, a) + np.abs(links) * self.load * np.sign(v)

    def spread(self, q: Array, v: Array, a: Array) -> Array:
        """Return the added deviations (K, n) of the torques, N·m (N)."""
        return self.link_spread(q, v, a) + self.friction_spread(v, a)

    def link_spread(self, q: Array, v: Array, a: Array) -> Array:
        """Return the part (K, n) of the links in `spread`: a seminorm of the regressor's rows."""
        robot = self.robot
        if not self.deviations:
            return np.zeros_like(v)
        Y = robot.regressor(q, v, a).reshape(len(q), robot.n, robot.n_links, 10)
        if self.independent:
            parts = [Y[:, :, k] @ root for k, root in enumerate(self.roots)]
            whole = np.concatenate(parts, axis=2)
        else:
            whole = np.einsum("knlp,lpr->knr", Y, self.roots, optimize=True)
        return np.asarray(self.deviations * np.linalg.norm(whole, axis=2))

    def friction_spread(self, v: Array, a: Array) -> Array:
        """Return the part (K, n) of friction in `spread`: deviations summed up."""
        columns = np.abs(self.dynamics.terms.columns(v, a))
        return np.asarray(self.deviations * (columns @ self.friction_deviations))

    def torque_and_derivatives(
        self, q: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return torques (K, n) and their derivatives with position, velocity and acceleration.

        Friction's derivative is that of the curve where it has one: the step of an exact sign has
        none.

        Returns
        -------
        torque : ndarray, shape (K, n)
        by_position, by_velocity, by_acceleration : ndarray, shape (K, n, n)
        """
        import pinocchio as pin

        robot, model, E = self.robot, self.model, self.robot.expansion
        data = model.createData()
        states = (robot.configuration(q), v @ E.T, a @ E.T)
        links = np.empty((len(q), model.nv))
        jacobians = np.empty((3, len(q), model.nv, model.nv))
        for k, state in enumerate(zip(*states, strict=True)):
            pin.computeRNEADerivatives(model, data, *state)
            links[k] = data.tau
            jacobians[:, k] = data.dtau_dq, data.dtau_dv, data.M
        # Pinocchio fills the upper half of M.
        jacobians[2] = np.triu(jacobians[2])
        jacobians[2] += np.triu(jacobians[2], 1).swapaxes(1, 2)
        jacobians = E.T @ jacobians @ E
        links = links @ E
        share = self.load * np.sign(v)
        jacobians *= (1.0 + np.sign(links) * share)[:, :, None]
        jacobians[1] += self._friction_by_velocity(v, a)
        jacobians[2] += self.dynamics.drive_inertia
        torque = links + self.friction(v, a) + np.abs(links) * share
        return torque, jacobians[0], jacobians[1], jacobians[2]

    def _friction_by_velocity(self, v: Array, a: Array) -> Array:
        """Return the derivative (K, n, n) of `friction` with the velocity."""
        n = self.robot.n
        jointwise = all(isinstance(term, JointwiseTerm) for term in self.dynamics.terms.terms)
        # Velocities that move at once: all of them where no joint's friction is another's.
        moves = [np.ones(n)] if jointwise else list(np.eye(n))
        found = np.zeros((len(v), n, n))
        for move in moves:
            higher, lower = (self.friction(v + s * _STEP * move, a) for s in (1.0, -1.0))
            slope = (higher - lower)[:, :, None] / (2.0 * _STEP)
            found += slope * (np.eye(n) if jointwise else move)
        return found

    def links(self, q: Array, v: Array, a: Array) -> Array:
        """Return the torques (K, n) that move and carry the links, without friction."""
        import pinocchio as pin

        model, E = self.model, self.robot.expansion
        states = self.robot.configuration(q), v @ E.T, a @ E.T
        return np.asarray(each_state(pin.rnea, model, (model.nv,), *states) @ E)

    def friction(self, v: Array, a: Array) -> Array:
        """Return the torques (K, n) of friction and rotors, but for friction of the load."""
        return np.asarray(self.dynamics.terms.columns(v, a) @ self.coefficients)

    @cached_property
    def coefficients(self) -> Array:
        """Parameters (f,) of friction."""
        return self.dynamics.theta[10 * self.robot.n_links :]

    @cached_property
    def load(self) -> Array:
        """Shares (n,) of the load that friction takes."""
        out = np.zeros(self.robot.n)
        for term, own in self.dynamics.terms.placed:
            if isinstance(term, LoadFriction):
                out += self.coefficients[own]
        return out

    @cached_property
    def model(self) -> Any:
        """Pinocchio's model of the links, gravity tilted, without rotors."""
        model = self.dynamics.to_pinocchio()
        model.armature = np.zeros(model.nv)
        return model

    @cached_property
    def sizes(self) -> tuple[Array, Array]:
        """Sizes (links, 3) of the bodies, and of their deviations; see `body_sizes`."""
        bodies = self.dynamics.theta[: 10 * self.robot.n_links].reshape(-1, 10)
        mass, moment = self.roots[:, :1], self.roots[:, 1:4]
        # Off-diagonal entries stand twice in the Frobenius norm, which bounds the spectral one.
        tensor = np.concatenate([self.roots[:, 4:], self.roots[:, [5, 7, 8]]], axis=1)
        parts = [np.linalg.norm(part, ord=2, axis=(1, 2)) for part in (mass, moment, tensor)]
        return body_sizes(bodies), self.deviations * np.column_stack(parts)


def body_sizes(bodies: Array) -> Array:
    """Return mass, and norms of first moment and rotational inertia, (links, 10) to (links, 3)."""
    moments = np.linalg.norm(bodies[:, 1:4], axis=1)
    inertias = np.linalg.norm(inertia_tensor(bodies), ord=2, axis=(1, 2))
    return np.column_stack([np.abs(bodies[:, 0]), moments, inertias])


def _left_out(terms: Iterable[FrictionTerm]) -> list[str]:
    """Return which terms are in no torque, in a sentence: those of positions and of joints."""
    kinds = [type(term) for term in terms if term.posed]
    left = dict.fromkeys(kind.__name__ for kind in kinds if kind not in (LoadFriction, Tilt))
    return [f"not in them: {', '.join(left)}; keep a larger reserve."] if left else []


def _dynamics(
    robot: RobotModel, estimate: Estimate | RobotDynamics | None
) -> tuple[RobotDynamics, list[str], float]:
    """Return the model, sentences about it, and the usual reserve."""
    if estimate is not None:
        found = estimate if isinstance(estimate, RobotDynamics) else estimate.model()
        if found.robot.joint_names != robot.joint_names:
            raise DataError(
                f"torque: the estimate is of '{found.robot.name}' with the joints "
                f"{', '.join(found.robot.joint_names)}; '{robot.name}' has "
                f"{', '.join(robot.joint_names)}."
            )
        words = ["torques are those of the estimate, friction included."]
        return found, words + _left_out(found.terms.terms), _IDENTIFIED
    viscous, coulomb = robot.described_friction()
    limit = robot.effort_limits
    speed = np.where(np.isfinite(robot.velocity_limits), robot.velocity_limits, 0.0)
    heavy = coulomb + viscous * speed > _MOST_FRICTION * limit
    viscous, coulomb = (np.where(heavy, 0.0, friction) for friction in (viscous, coulomb))
    terms = FrictionModel.from_terms(("coulomb", "viscous", "rotor_inertia"), robot.joint_names)
    values = [robot.prior.ravel(), coulomb, viscous, robot.described_armature()]
    dynamics = RobotDynamics(robot=robot, terms=terms, theta=np.concatenate(values))
    words = ["torques are those of the description, friction included."]
    words += _left_out(robot.springs)
    if any(np.count_nonzero(row) > 1 for row in robot.expansion):
        words.append("friction and rotors of joints that several motors move count at each alone.")
    light = [name for name, body in zip(robot.link_names, robot.prior, strict=True) if not body[0]]
    if len(light) == robot.n_links:
        return dynamics, ["the description has no masses: torques are not checked."], 0.0
    if light:
        words.append(f"the description gives {', '.join(light)} no mass.")
    if heavy.any():
        names = ", ".join(robot.joint_names[j] for j in np.flatnonzero(heavy))
        words.append(
            f"friction of {names} in the description would take more than "
            f"{100.0 * _MOST_FRICTION:g} % of the torque limit: it is not counted."
        )
    if np.all(coulomb > 0.0):
        return dynamics, words, _WITH_FRICTION
    if not np.any(coulomb > 0.0):
        words[0] = "torques are those of the description, which has no Coulomb friction."
    return dynamics, words, _WITHOUT_FRICTION


def _roots_of_estimate(estimate: Estimate, links: int) -> tuple[Array, Array]:
    """Return a root (links, 10, r) of the covariance of the links, and friction's deviations."""
    size = estimate.problem.n_theta
    covariance = Posterior.of(estimate).covariance(np.eye(size))
    values, vectors = np.linalg.eigh(covariance[: 10 * links, : 10 * links])
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    friction = np.sqrt(np.maximum(np.diag(covariance)[10 * links :], 0.0))
    return root.reshape(links, 10, -1), friction
