"""`Elasticity`: what two encoders tell of gears that give way."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Shown, Table, plain
from sdpid.estimation.elasticity.signals import Run, runs_of
from sdpid.estimation.elasticity.terms import DeflectionTerm
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.inspection.block_fit import BLOCKS
from sdpid.experiment.recording.recording import Recording

# Level of all intervals.
LEVEL = 0.95
# Samples of curves.
_POINTS = 2000


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Elasticity(Shown):
    """Compliances of gears, and what else stands between the encoders of motors and links.

    Arrays have an entry for each joint, NaN where there is one encoder only, but for rotors.

    Attributes
    ----------
    estimate : Estimate
        The rigid robot.
    delay_s, delay_error_s : ndarray, shape (n,)
        By how much the links' encoders are read later than the motors', s, and its standard error;
        the same for all joints unless recordings that were left out ask for more.
    compliance, compliance_error : ndarray, shape (n,)
        Deflection per torque, rad/(N·m) (m/N of sliding joints), not negative, and its error.
    stiffness : ndarray, shape (n,)
        Its inverse, N·m/rad (N/m); NaN where the interval holds an infinite one.
    interval : ndarray, shape (n, 2)
        Of the stiffness, at a level of 95 %.
    rotor_inertia : ndarray, shape (n,)
        Rotor inertias, seen from behind the gears, whose torques were taken off, kg·m² (kg).
    conditional : tuple of str
        Joints whose motion does not tell the rotor from the link: their stiffness holds for the
        rotor inertia above.
    terms : tuple of tuple of DeflectionTerm
        Further parts of the deflection of every joint.
    rms : ndarray, shape (R, n)
        What is not explained in each recording, rad (m), rms.
    curves : dict of str to ndarray, shape (3, K)
        By joint: torque, measured deflection without delay and offset, and predicted deflection
        in some samples of the first recording.

    Examples
    --------
    >>> from dataclasses import replace
    >>> links = log.position - 1e-6 * log.effort  # as if gears gave way
    >>> found = sdpid.identify_elasticity(result, replace(log, link_position=links))
    >>> print(found.in_words())
    elasticity: links' encoders late by ... ms; stiffness of joint_2 ...
    >>> found.deflection(log).shape == log.position.shape
    True
    """

    estimate: Estimate
    delay_s: Array
    delay_error_s: Array
    compliance: Array
    compliance_error: Array
    stiffness: Array
    interval: Array
    rotor_inertia: Array
    conditional: tuple[str, ...]
    terms: tuple[tuple[DeflectionTerm, ...], ...]
    rms: Array
    curves: dict[str, Array]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.estimate.problem.robot.joint_names

    def _shown(self) -> dict[str, object]:
        return {"robot": self.estimate.problem.robot.name, "conditional": self.conditional}

    def _tables(self) -> Iterator[Table]:
        yield self.table()

    def table(self) -> Table:
        """Return delay, stiffness and its interval, rotor inertia and further terms by joint."""
        low, high = self.interval.T.tolist()
        columns: dict[str, Any] = {"joint": self.joint_names, "delay, s": self.delay_s.tolist()}
        columns |= {"stiffness, N·m/rad": self.stiffness.tolist(), "from": low, "to": high}
        columns |= {"rotor inertia, kg·m²": self.rotor_inertia.tolist()}
        columns |= {"further terms": [", ".join(t.kind for t in each) for each in self.terms]}
        return Table.of_columns(columns)

    def in_words(self) -> str:
        """Return the delay and every joint's stiffness in a line."""
        late, reach = 1e3 * self.delay_s, 1e3 * student() * self.delay_error_s
        told = np.flatnonzero(np.isfinite(late)).tolist()
        some = told if len(set(late[told].tolist())) > 1 else told[:1]
        delays = ", ".join(f"{late[j]:.3g} ± {reach[j]:.2g} ms" for j in some)
        stiff = [j for j in told if np.isfinite(self.stiffness[j])]
        names, ends = self.joint_names, self.interval.tolist()
        parts = [f"links' encoders late by {delays}"]
        if stiff:
            each = (
                f"{names[j]} {self.stiffness[j]:.3g} ({ends[j][0]:.3g} to {ends[j][1]:.3g})"
                for j in stiff
            )
            parts.append(f"stiffness of {', '.join(each)} N·m/rad")
        if soft := [names[j] for j in told if j not in stiff]:
            parts.append(f"none told of {', '.join(soft)}")
        if own := [names[j] for j in stiff if names[j] in self.conditional]:
            parts.append(f"given the rotor inertia of {', '.join(own)}")
        return "elasticity: " + "; ".join(parts)

    def deflection(self, log: Recording) -> Array:
        """Return how far motors are ahead of links, (N, n), as the encoders record it.

        The delay is included; offsets of encoders, which differ between recordings, are not.

        Parameters
        ----------
        log : Recording
            Of positions of links only lines of their encoders need more than those of motors.

        Returns
        -------
        ndarray, shape (N, n)
            For every sample of the recording, rad (m); zero for joints with one encoder, NaN for
            samples alone between gaps.
        """
        found = np.full((log.n_samples, len(self.compliance)), np.nan)
        for run, late, _, own in self._parts(log):
            time, half = run.time, 0.5 * (run.time[1] - run.time[0])
            rows = (log.time >= time[0] - half) & (log.time <= time[-1] + half)
            found[rows] = 0.0
            for j, column in zip(self._joints.tolist(), (late + own).T, strict=True):
                found[rows, j] = np.interp(log.time[rows], time, column)
        return found

    def errors(self, log: Recording) -> Array:
        """Return by how much links' positions are predicted wrong, (N, n), each mean taken off.

        In uniform samples of the stretches without gaps; zero for joints with one encoder.
        """
        parts = [run.difference - late - own for run, late, _, own in self._parts(log)]
        missed = np.concatenate(parts)
        found = np.zeros((len(missed), len(self.compliance)))
        found[:, self._joints] = missed - missed.mean(axis=0)
        return found

    def with_curves(self, log: Recording) -> Elasticity:
        """Return it with the `curves` of a recording, of its longest stretch."""
        run, late, torque, own = max(self._parts(log), key=lambda each: len(each[0].time))
        measured = run.difference - late
        both = np.stack([torque, measured - np.mean(measured - own, axis=0), own])
        few = both[:, :: -(-both.shape[1] // _POINTS)]
        names = [self.joint_names[j] for j in self._joints.tolist()]
        return replace(self, curves={name: few[:, :, k] for k, name in enumerate(names)})

    @property
    def _joints(self) -> Indices:
        """Joints with two encoders, (m,)."""
        return np.flatnonzero(np.isfinite(self.compliance))

    def _parts(self, log: Recording) -> Iterator[tuple[Run, Array, Array, Array]]:
        """Yield stretches, their deflection by delay, torques, and deflection by these, (N, m)."""
        joints = self._joints
        for run in runs_of(self.estimate, log, joints, self.rotor_inertia):
            velocity, torque = run.late(self.delay_s[joints])
            own = self.compliance[joints] * torque
            for k, j in enumerate(joints.tolist()):
                for term in self.terms[j]:
                    own[:, k] += term.columns(run.link[:, k], torque[:, k]) @ term.weights
            yield run, self.delay_s[joints] * velocity, torque, own

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; what cannot be told is None."""
        names = ("delay_s", "delay_error_s", "compliance", "compliance_error", "stiffness")
        found = {name: getattr(self, name) for name in (*names, "interval", "rotor_inertia", "rms")}
        terms = [
            [{"kind": t.kind, "numbers": t.numbers, "weights": t.weights} for t in each]
            for each in self.terms
        ]
        values: dict[str, Any] = plain(
            {
                "joints": self.joint_names,
                "level": LEVEL,
                **found,
                "conditional": self.conditional,
                "terms": terms,
            }
        )
        return values

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write as JSON, whole or not at all."""
        atomic_write_text(path, json.dumps(self.to_dict(), indent=2) + "\n")


def student(freedom: Array | float = BLOCKS - 1.0) -> Array:
    """Return how many standard errors an interval reaches to either side."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(freedom, 0.5 * (1.0 + LEVEL)))
