"""What currents are explained by: links, loads, and what each drive loses.

A joint's current is what the bodies need over its gain, and what its own drive loses:

    current_j = (L_j · bodies) / gain_j + F_j · phi_j

with L the regressor of the links (and of gravity's direction, where that is open) and of what they
carry, and F friction, offset and rotor inertia of the drive of joint j. As phi_j is of joint j
alone it is estimated in amperes, whatever the gain is. The errors are the currents'.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.drive_gains.load import Load
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.effects.kinds import Effects, names_of_effects
from sdpid.estimation.prior.prior import Prior, link_rows
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.selection.choose import with_chosen_effects, with_effects
from sdpid.experiment.preparation.prepare import (
    SMOOTH,
    ProcessingOf,
    chosen_processing,
    friction_of,
)
from sdpid.experiment.processing.choose import with_changes
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm
from sdpid.robot.friction.terms import BY_NAME, Coulomb
from sdpid.robot.model.base_parameters import BaseParameters, structural_base
from sdpid.robot.model.model import RobotModel

# Rows of slow motion are masked: there friction under load is least like any curve. Below this
# speed, rad/s, or this share of the joints' usual speed, whichever is less, and within this time,
# s, of it. On two pairs of records of a UR10e it lowers what is left of the wrist's currents by a
# third, and the gains of joints 4 and 6 of the pairs come nearer (docs/evidence/drive_gains.md).
_SLOW, _SLOW_SHARE, _SLOW_TIME = 0.1, 0.2, 0.1
# A joint keeps at least this share of its rows, or is not masked.
_KEPT = 0.3


@dataclass(frozen=True, kw_only=True, eq=False)
class GainModel:
    """An arm, its drives, and what it carries in some recordings.

    The parameters of all bodies are one vector (Y,): ten of each link, those that all joints share
    (gravity's direction), then ten of each load in its frame.

    Attributes
    ----------
    robot : RobotModel
        The arm.
    terms : tuple of str or FrictionTerm
        Terms of the drives, and of gravity's direction.
    alike : tuple of str
        Names of terms that are the same in all recordings; of others each has its own.
    samples : tuple of Samples
        Of all recordings, efforts in A.
    loads : tuple of Load
        What is known of those that the last recordings carry, one each.
    placed : ndarray, shape (10·links, 10)
        What a load's parameters in its frame add to the links'.
    free : ndarray of bool, shape (n,)
        Which gains are not known.
    description_error : float or None
        Relative error that the described links are granted; None where they are not believed.
    """

    robot: RobotModel
    terms: tuple[str | FrictionTerm, ...]
    alike: tuple[str, ...]
    samples: tuple[Samples, ...]
    loads: tuple[Load, ...]
    placed: Array
    free: Mask
    description_error: float | None

    def __post_init__(self) -> None:
        if unknown := [name for name in self.alike if name not in BY_NAME]:
            raise DataError(
                f"shared: names {unknown[0]!r}, which is no friction term; there are "
                f"{', '.join(BY_NAME)}."
            )

    @cached_property
    def friction(self) -> FrictionModel:
        """The terms."""
        return FrictionModel.from_terms(self.terms, self.robot.joint_names)

    @cached_property
    def n_arm(self) -> int:
        """How many of the bodies' parameters are not the loads'."""
        return len(self.placed) + int(np.sum(self._parameters[2]))

    @cached_property
    def known(self) -> Array:
        """What is known of the bodies' parameters, (Y,): of loads as if they were points."""
        return np.concatenate([np.zeros(self.n_arm), *(load.theta for load in self.loads)])

    @cached_property
    def unknown(self) -> Mask:
        """Which of the bodies' parameters are to be found, (Y,)."""
        loads = (np.arange(10) >= load.first_unknown for load in self.loads)
        return np.concatenate([np.ones(self.n_arm, dtype=bool), *loads])

    def bodies(self, unknown: Array) -> Array:
        """Return the parameters (Y,) of which those to be found are off what is known by these."""
        whole = self.known.copy()
        whole[self.unknown] += unknown
        return whole

    def carried(self, bodies: Array) -> Array:
        """Return the loads (loads, 10) among the bodies' parameters, about their frame's origin."""
        return bodies[self.n_arm :].reshape(-1, 10)

    def loaded_links(self, bodies: Array) -> list[Array]:
        """Return the links (links, 10) of each recording, with the load where there is one."""
        size = len(self.placed)
        every = range(len(self.samples))
        return [(self._joined(k) @ bodies)[:size].reshape(-1, 10) for k in every]

    @cached_property
    def used(self) -> Array:
        """Rows in use of each joint, (n,), one at least."""
        counts = [each.used.sum(axis=0) for each in self.samples]
        return np.asarray(np.maximum(np.sum(counts, axis=0), 1.0))

    @cached_property
    def spread(self) -> Array:
        """Standard deviations of the currents about each recording's mean, (n,), A."""
        currents = [np.ma.array(each.effort, mask=~each.used) for each in self.samples]
        squares = [each.var(axis=0).filled(0.0) * each.count(axis=0) for each in currents]
        return np.asarray(np.sqrt(np.sum(squares, axis=0) / self.used))

    @cached_property
    def believed(self) -> tuple[Array, Array]:
        """Rows (r, Y) and right-hand side of the described links, with errors of variance one."""
        if self.description_error is None:
            return np.zeros((0, len(self.known))), np.zeros(0)
        size = len(self.placed)
        rows = np.zeros((size, len(self.known)))
        for k, block in enumerate(link_rows(Prior(), self.robot)):
            own = slice(10 * k, 10 * k + 10)
            rows[own, own] = block / self.description_error
        return rows, rows[:, :size] @ self.robot.prior.ravel()

    def columns(self, number: int, links: Array) -> Iterator[Array]:
        """Yield of each joint the columns (K, c + Y + 1) of a recording.

        They are friction's, of each recording its own but for terms that are alike; the bodies';
        and the current. Rows that are not used are zero. `links` (links, 10) load the gears.
        """
        samples, given = self.samples[number], tuple(tuple(map(float, link)) for link in links)
        terms = [
            replace(term, bodies=given) if isinstance(term, LoadFriction) else term
            for term in self.friction.terms
        ]
        friction = FrictionModel.from_terms(terms, self.robot.joint_names)
        rows = RowSource(self.robot, friction, self._base, samples).with_every_column()
        regressor = rows.regressor(slice(0, samples.n_samples))
        acts, apart, shared = self._parameters
        count = rows.base.count - len(shared)
        of_arm = np.append(np.ones(count, dtype=bool), shared)
        of_theta = np.append(np.ones(len(self.placed), dtype=bool), shared)
        matrix = rows.base.matrix[np.ix_(of_arm, of_theta)]
        size, bodies = len(self.known), matrix @ self._joined(number)
        # A drive's parameter that does the same as the arm's, such as a rotor's inertia and that of
        # all links about the first axis, is estimated in amperes: rounding would tell them apart.
        same = self._base.matrix[:, len(self.placed) :] != 0.0
        same = same[:, same.sum(axis=0) == 1].any(axis=1)
        bodies[:count][same[self._base.kept < len(self.placed)], : self.n_arm] = 0.0
        for j in range(self.robot.n):
            own, F = regressor[:, j, of_arm] @ bodies, regressor[:, j, count:]
            together, alone = acts[:, j] & ~apart, acts[:, j] & apart
            first, width = int(together.sum()), int(alone.sum())
            out = np.zeros((samples.n_samples, first + len(self.samples) * width + size + 1))
            out[:, :first] = F[:, together]
            out[:, first + number * width :][:, :width] = F[:, alone]
            out[:, -size - 1 :] = np.column_stack([own, samples.effort[:, j]])
            out[~samples.used[:, j]] = 0.0
            yield out

    @cached_property
    def _base(self) -> BaseParameters:
        return structural_base(self.robot, self.friction)

    @cached_property
    def _parameters(self) -> tuple[Mask, Mask, Mask]:
        """On which joints each friction parameter acts, which are not alike, and the arm's own.

        Shapes are (f, n), (f,) and (f,). Where one acts on several joints, each has its own value.
        """
        n, count = self.robot.n, len(self.friction.parameters)
        acts, (apart, shared) = np.ones((count, n), dtype=bool), np.zeros((2, count), dtype=bool)
        for term, place in self.friction.placed:
            apart[place] = not isinstance(term, tuple(BY_NAME[name] for name in self.alike))
            shared[place] = isinstance(term, Tilt)
            if isinstance(term, JointwiseTerm | LoadFriction):
                own = self.friction.parameters[place]
                acts[place] = np.array([[p.joint] for p in own]) == np.arange(n)
        return acts & ~shared[:, None], apart, shared

    def _joined(self, number: int) -> Array:
        """Return what takes the bodies' parameters to the arm's, its load in the link (p, Y)."""
        found = np.eye(self.n_arm, len(self.known))
        load = number - len(self.samples) + len(self.loads)
        if load >= 0:
            first = self.n_arm + 10 * load
            found[: len(self.placed), first : first + 10] = self.placed
        return found


def gain_processing(
    logs: Sequence[Recording], given: ProcessingOf
) -> tuple[Processing, str | None]:
    """Return one processing for all recordings, and why it was chosen.

    Raises
    ------
    DataError
        When a change names no setting, or recordings have periods.
    """
    if any(log.period is not None for log in logs):
        raise DataError("gains: leave periods out of the recordings (period=None).")
    if isinstance(given, Processing):
        return given, None
    common, why = chosen_processing([replace(log, currents=False) for log in logs])
    speeds = [np.sqrt(np.mean(np.gradient(log.position, log.time, axis=0) ** 2)) for log in logs]
    slow = {
        "reversal_speed": min(_SLOW, _SLOW_SHARE * float(np.median(speeds))),
        "reversal_time": _SLOW_TIME,
        "kept_share": _KEPT,
    }
    return with_changes(common, {**slow, **({} if given is None else given)}), why


def first_terms(robot: RobotModel) -> tuple[str | FrictionTerm, ...]:
    """Return terms with which nearly right gains are found, before any are chosen by the data."""
    with_load = [LoadFriction(width=SMOOTH)] if np.any(robot.prior[:, 0] > 0.0) else []
    return (Coulomb(width=SMOOTH), "viscous", "offset", "rotor_inertia", *with_load)


def chosen_terms(
    robot: RobotModel,
    samples: Samples,
    log: Recording,
    gains: Array,
    friction: Iterable[str | FrictionTerm] | None,
    effects: Effects,
) -> tuple[tuple[FrictionTerm, ...], tuple[str, ...]]:
    """Return the friction terms, their numbers closed, and what the data say of effects.

    Parameters
    ----------
    robot : RobotModel
        The arm.
    samples : Samples
        Without load, efforts in A.
    log : Recording
        What they were made of, or the first of several.
    gains : ndarray, shape (n,)
        Nearly right gains.
    friction, effects
        As `identify_drive_gains` takes them.
    """
    names, given = names_of_effects(effects), friction_of(log, friction)
    torques = replace(samples, effort=samples.effort * gains)
    prior = Prior() if np.any(robot.prior[:, 0] > 0.0) else None
    constraints = Constraints.of_size(robot)

    def build(terms: tuple[str | FrictionTerm, ...]) -> Problem:
        return build_problem(
            robot,
            torques,
            friction=terms,
            weighting="residual",
            constraints=constraints,
            prior=prior,
            check_excitation=False,
        )

    problem = build(given)
    if names is None:
        problem = with_chosen_effects(problem, given, prior, build)
    elif names:
        problem = with_effects(problem, given, names, build)
    terms = problem.friction.terms
    return terms, tuple(each.words for each in problem.origin.effects if each.chosen)
