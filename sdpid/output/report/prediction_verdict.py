"""Findings about a prediction: how well efforts are explained, and whether friction is missing.

Every limit is a constant here, with its reason.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sdpid.assurance.diagnostics.residuals import JointErrors, joint_errors, used_rows
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.experiment.processing.samples import Samples

Level = Literal["good", "caution", "bad"]

# Share of a joint's effort that is explained (R²). At 0.95 the error is 22 % of the effort's
# spread, and a feedback loop is left with less than a quarter of the work; at 0.8 it is 45 %, and
# what the model gets wrong is about as large as friction or gravity alone usually are.
EXPLAINED, HARDLY = 0.95, 0.8

# A joint whose effort hardly varies has a low R² however small its error is. An error of a tenth of
# the effort itself is small all the same: payloads and temperature change it by as much. It lifts a
# joint by one level and no more, since R² alone tells a model from a constant.
SMALL = 0.1

# A joint that was never faster than this (rad/s) did not move: velocity noise at standstill stays
# below, and so does what is masked around reversals.
MOVES = 0.02

# Share of the errors' variance that goes with velocity: a tenth of it is 5 % of the RMSE, less
# than the choice of a filter makes.
FRICTION = 0.1

# Of that share a line or a sign explains this much, or else the shape is another one.
_SHAPE = 0.5

# Below this share of its effort an error does not matter, whatever its shape: torque sensors and
# torque constants are hardly known to 2 %.
_NEGLIGIBLE = 0.02

# Names listed before "and 3 more".
_LISTED = 4


@dataclass(frozen=True)
class Finding:
    """A finding of the verdict.

    Attributes
    ----------
    level : {"good", "caution", "bad"}
        What it means for the model.
    text : str
        A sentence or two.
    """

    level: Level
    text: str


def prediction_findings(samples: Samples, fit: Validation) -> tuple[Finding, ...]:
    """Return the findings about a prediction of one recording.

    Parameters
    ----------
    samples : Samples
        The measurements that were predicted.
    fit : Validation
        Their prediction.

    Returns
    -------
    tuple of Finding
        The most important first.
    """
    return (
        *effort_findings(samples, fit, "this recording"),
        *friction_findings(fit, joint_errors(samples, fit)),
    )


def grade(samples: Samples, fit: Validation, joint: int) -> Level:
    """Grade how well a joint's effort is explained, by `EXPLAINED`, `HARDLY`, `SMALL` and `MOVES`.

    Of a joint that stood still at most "caution": a constant would have predicted its effort too.
    """
    small = float(fit.nrmse[joint]) <= SMALL
    if not _moved(samples, joint):
        return "caution" if small else "bad"
    r2 = float(fit.r2[joint])
    if r2 >= (HARDLY if small else EXPLAINED):
        return "good"
    return "caution" if small or r2 >= HARDLY else "bad"


def _moved(samples: Samples, joint: int) -> bool:
    """Return whether a joint moved on the rows in use."""
    speeds = np.abs(samples.velocity[used_rows(samples, joint), joint])
    return bool(np.any(speeds > MOVES))


def effort_findings(samples: Samples, fit: Validation, where: str) -> Iterator[Finding]:
    """Yield which joints' efforts are predicted well, roughly or badly; `where` names the data."""
    joints: dict[Level, list[str]] = {"good": [], "caution": [], "bad": []}
    still: list[str] = []
    flat: list[str] = []
    unmeasured = False
    for j, name in enumerate(fit.joint_names):
        if not np.any(used_rows(samples, j)):
            unmeasured = True
            continue
        if not _moved(samples, j):
            still.append(name)
            continue
        level = grade(samples, fit, j)
        constant = level == "caution" and float(fit.r2[j]) < 0.0
        (flat if constant else joints[level]).append(f"{name} ({_explained(fit, j)})")
    if joints["good"]:
        every = not (joints["caution"] or joints["bad"] or flat or still or unmeasured)
        which = "every joint" if every else "the joints"
        yield Finding(
            "good",
            f"Trust it for the effort of {which} in motion like the recorded, as feed-forward and "
            f"simulation need; share of the effort's variance explained on {where}: "
            f"{listed(joints['good'], 99)}.",
        )
    if joints["caution"]:
        yield Finding(
            "caution",
            f"Expect it to be roughly right, not exact, for {listed(joints['caution'], 99)}; "
            "feedback has to make up for the rest. In brackets: share of the effort's variance "
            f"explained on {where}.",
        )
    if flat:
        yield Finding(
            "caution",
            f"Do not rely on it for how the effort varies of {listed(flat, 99)}: on {where} the "
            f"effort is nearly constant. The error is small beside it (limit {percent(SMALL)}), "
            "but its mean predicts better. Validate on a motion in which the effort varies.",
        )
    if joints["bad"]:
        yield Finding(
            "bad",
            f"Do not trust it for the effort of {listed(joints['bad'], 99)}: too little of the "
            "variance is explained. Contact cannot be told from model error there.",
        )
    if still:
        yield Finding(
            "bad",
            f"Joints that did not move on {where} (never faster than {MOVES:g} rad/s): "
            f"{listed(still, 99)}. How well their effort is predicted in motion is not known. "
            "Record them moving.",
        )


def friction_findings(fit: Validation, errors: tuple[JointErrors, ...]) -> Iterator[Finding]:
    """Yield the joints whose errors depend on velocity, by the shape of the dependence."""
    nrmse = dict(zip(fit.joint_names, fit.nrmse.tolist(), strict=True))
    kinds: dict[str, list[str]] = {}
    for each in errors:
        if each.share < FRICTION or nrmse[each.joint] < _NEGLIGIBLE:
            continue
        if max(each.with_sign, each.with_velocity) < _SHAPE * each.share:
            kind = (
                "with speed along a curve, neither a constant nor a line: try the terms stribeck "
                "or square_root"
            )
        elif each.with_sign >= each.with_velocity:
            kind = (
                "with the direction of motion: Coulomb friction has another level here, or is not "
                "in the model"
            )
        else:
            kind = (
                "in proportion to velocity: viscous friction has changed, as with temperature, or "
                "is not in the model"
            )
        kinds.setdefault(kind, []).append(f"{each.joint} ({percent(each.share)})")
    for kind, names in kinds.items():
        yield Finding(
            "caution",
            f"Friction is not fully modeled. Errors go {kind}. Share of the error's variance: "
            f"{listed(names, 99)}.",
        )


def listed(names: Iterable[str], most: int = _LISTED) -> str:
    """Join up to `most` names with commas, and count the rest."""
    every = list(names)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(every[:most]) + more


def _explained(fit: Validation, joint: int) -> str:
    """Return R² in words: below zero the mean effort predicts better."""
    r2, nrmse = float(fit.r2[joint]), float(fit.nrmse[joint])
    if r2 < 0.0:
        error = f", error {percent(nrmse)} of the effort" if nrmse <= SMALL else ""
        return f"worse than a constant{error}"
    return "over 99.9 %" if r2 > 0.999 else percent(r2)


def percent(share: float) -> str:
    """Return a share in percent."""
    return f"{100.0 * share:.3g} %"
