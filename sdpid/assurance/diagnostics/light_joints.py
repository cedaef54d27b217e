"""Joints that are too light to be simulated: their effort error moves them more than they move.

An effort error e drives a joint of inertia M_jj off, and viscous friction d holds it back: after
a time t it has drifted by ``e/d·(t − T·(1 − exp(−t/T)))`` with T = M_jj/d, or ``e·t²/(2·M_jj)``
without friction. In predicted efforts M_jj hardly shows there: any value near zero is as good.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.tables import Shown
from sdpid.assurance.diagnostics.validation import Errors
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.dynamics import RobotDynamics

# Time of the drift, s, and the drift from which a joint is named, as a share of how far the joint
# itself goes in that time: from one on, simulating it is worse than letting it stand.
# docs/evidence/rollouts.md has every joint of six arms beside how it moves.
SECONDS = 0.1
LIGHT = 1.0

# How many times as hard a run may be asked to accelerate a joint: more is no advice. Light joints
# of the Panda and the LWR 4+ ask for 26 and 400 times, a UR10's description for thousands.
_HARDER = 100.0

# Positions along the motion at which the inertia is looked at.
_POSITIONS = 100

# Change of the velocity over which friction's slope is taken, as a share of the rms velocity.
_SLOPE = 0.2


@dataclass(frozen=True, kw_only=True, repr=False)
class LightJoint(Shown):
    """How far a joint's own effort error drives it.

    Attributes
    ----------
    joint : str
        Its name.
    inertia : float
        Median of M_jj along the motion, rotor included, kg·m² (kg).
    damping : float
        Slope of its friction about the root mean square velocity, N·m·s/rad (N·s/m).
    error : float
        Root mean square error of its effort in motion, N·m (N).
    velocity, acceleration : float
        Root mean squares of the recorded motion, rad/s and rad/s² (m/s and m/s²).
    rotor : bool
        Whether the model has a rotor inertia of this joint.
    """

    joint: str
    inertia: float
    damping: float
    error: float
    velocity: float
    acceleration: float
    rotor: bool = False

    _facts = ("joint", "inertia, kg·m²", "damping, N·m·s/rad", "error, N·m", "drift, rad", "ratio")

    @property
    def drift(self) -> float:
        """How far the effort error drives it in a tenth of a second, rad (m)."""
        slow = max(self.inertia, np.finfo(float).tiny)
        rate = self.damping * SECONDS / slow
        if rate < 1e-3:
            return self.error * SECONDS**2 / (2.0 * slow)
        return float(self.error / self.damping * SECONDS * (1.0 + np.expm1(-rate) / rate))

    @property
    def ratio(self) -> float:
        """The drift over how far the joint goes in that time."""
        return self.drift / max(self.velocity * SECONDS, np.finfo(float).tiny)

    @property
    def words(self) -> str:
        """What is the matter."""
        return (
            f"{self.joint} is too light to be simulated: its effort is off by {self.error:.2g} N·m "
            f"(rms), which moves an inertia of {self.inertia:.2g} kg·m² by {self.drift:.2g} rad in "
            f"{SECONDS:g} s, {self.ratio:.2g} times as far as the joint itself goes (limit "
            f"{LIGHT:g}); that inertia takes {self.inertia * self.acceleration:.2g} N·m of its "
            "effort, so that the recording hardly shows it"
        )

    @property
    def remedy(self) -> str:
        """What bounds it."""
        faster = self.error / max(self.inertia * self.acceleration, np.finfo(float).tiny)
        rotor = "" if self.rotor else ", or the rotor's inertia in the model, where a drive has one"
        first = ""
        run = (
            f"a run that accelerates it {faster:.2g} times as hard, so that its inertia takes as "
            "much effort as is off"
        )
        if self.damping <= 0.0:
            first = "fit its friction first, for the model has no viscous friction there; then "
        if faster > _HARDER:
            run = (
                f"no faster run, for the effort that is off is {faster:.0f} times what its "
                f"inertia takes (limit {_HARDER:g})"
            )
        return (
            f"what bounds {self.joint}: {first}a prior that holds its inertia nearer to the "
            f"description, where that is right (Prior(strength=100)){rotor}; {run}; or a longer "
            "run, where its friction is what is off"
        )


def light_joints(
    model: RobotDynamics, samples: Samples, errors: Errors, *, limit: float = LIGHT
) -> tuple[LightJoint, ...]:
    """Return the joints that drift more than `limit` times as far as they go.

    Parameters
    ----------
    model : RobotDynamics
        Of an arm on a fixed base; of others nothing is told.
    samples : Samples
        The motion.
    errors : Errors
        Of the efforts on it, in motion.
    limit : float, optional
        Least ratio that is told; 0 tells every joint that moves.
    """
    robot = model.robot
    if robot.free_flyer:
        return ()
    picked = np.linspace(0, samples.n_samples - 1, min(_POSITIONS, samples.n_samples)).astype(int)
    masses = model.mass_matrix(samples.position[picked])
    inertias = np.median(np.diagonal(masses, axis1=1, axis2=2), axis=0)
    rates = samples.velocity, samples.acceleration
    v, a = (np.sqrt(np.mean(np.square(each), axis=0)) for each in rates)
    change = np.diff(model.friction(np.stack([(1.0 - _SLOPE) * v, (1.0 + _SLOPE) * v])), axis=0)[0]
    damping = np.divide(change, 2.0 * _SLOPE * v, out=np.zeros_like(v), where=v > 0.0)
    found = [
        LightJoint(
            joint=name,
            inertia=float(inertias[j]),
            damping=max(float(damping[j]), 0.0),
            error=float(errors.rmse[j]),
            velocity=float(v[j]),
            acceleration=float(a[j]),
            rotor=bool(model.drive_inertia[j, j] > 0.0),
        )
        for j, name in enumerate(robot.joint_names)
        if errors.rows[j] and v[j] > 0.0 and a[j] > 0.0
    ]
    return tuple(each for each in found if each.ratio > limit)
