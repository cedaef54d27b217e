"""`Elasticity`: what two encoders tell of gears that give way."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Shown, Table, plain
from sdpid.estimation.elasticity.signals import runs_of
from sdpid.estimation.elasticity.terms import DeflectionTerm
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.inspection.block_fit import BLOCKS
from sdpid.experiment.recording.recording import Recording

# Level of all intervals.
LEVEL = 0.95


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Elasticity(Shown):
    """Compliances of gears, and what else stands between the encoders of motors and links.

    Arrays have an entry for each joint, NaN where there is one encoder only.

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

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.estimate.problem.robot.joint_names

    def _shown(self) -> dict[str, object]:
        return {"robot": self.estimate.problem.robot.name, "conditional": self.conditional}

    def _tables(self) -> Iterator[Table]:
        low, high = self.interval.T.tolist()
        columns: dict[str, Any] = {"joint": self.joint_names, "delay, s": self.delay_s.tolist()}
        columns |= {"stiffness, N·m/rad": self.stiffness.tolist(), "from": low, "to": high}
        columns |= {"rotor inertia, kg·m²": self.rotor_inertia.tolist()}
        columns |= {"further terms": [", ".join(t.kind for t in each) for each in self.terms]}
        yield Table.of_columns(columns)

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
        for time, predicted, _ in self._parts(log):
            half = 0.5 * (time[1] - time[0])
            rows = (log.time >= time[0] - half) & (log.time <= time[-1] + half)
            for j, column in enumerate(predicted.T):
                found[rows, j] = np.interp(log.time[rows], time, column)
        return found

    def errors(self, log: Recording) -> Array:
        """Return by how much links' positions are predicted wrong, (N, n), each mean taken off.

        In uniform samples of the stretches without gaps.
        """
        missed = np.concatenate(
            [measured - predicted for _, predicted, measured in self._parts(log)]
        )
        return np.asarray(missed - missed.mean(axis=0))

    def _parts(self, log: Recording) -> Iterator[tuple[Array, Array, Array]]:
        """Yield times, predicted and measured differences of all joints in every stretch."""
        joints = np.flatnonzero(np.isfinite(self.compliance))
        for run in runs_of(self.estimate, log, joints, self.rotor_inertia):
            predicted, measured = np.zeros((2, len(run.link), len(self.compliance)))
            velocity, torque = run.late(self.delay_s[joints])
            for k, j in enumerate(joints.tolist()):
                predicted[:, j] = self.delay_s[j] * velocity[:, k]
                predicted[:, j] += self.compliance[j] * torque[:, k]
                for term in self.terms[j]:
                    predicted[:, j] += term.columns(run.link[:, k], torque[:, k]) @ term.weights
            measured[:, joints] = run.difference
            yield run.time, predicted, measured

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


def student() -> float:
    """Return how many standard errors an interval reaches to either side."""
    from scipy.special import stdtrit

    return float(stdtrit(BLOCKS - 1, 0.5 * (1.0 + LEVEL)))
