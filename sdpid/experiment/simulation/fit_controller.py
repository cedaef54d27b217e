"""Fit a controller's gains to a log with commanded positions."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.experiment.recording.floating.robots import require_fixed_base
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.controllers import PD, PID, ComputedTorque, P
from sdpid.experiment.simulation.fitted_controller import FittedController
from sdpid.experiment.simulation.law import Controller
from sdpid.experiment.simulation.law_fit import Law, LawFit, fit_law
from sdpid.experiment.simulation.tracking import Tracking, tracking
from sdpid.robot.model.dynamics import RobotDynamics

KINDS = ("p", "pd", "pid", "computed_torque")
# Above this standard deviation of a gain, output error is no better than without the controller.
_LARGEST_DEVIATION = 0.1
# The right law explains all but noise; wrong ones leave more.
_LEAST_EXPLAINED = 0.98
# A law whose weights are off by less than this, squared and over their variances, is not excluded.
_DECIDED = 16.0
# An integral that takes this part of what is left belongs to the law, where more than this part
# of the efforts is left.
_INTEGRAL, _LEFT = 0.5, 1e-4


def fit_controller(
    recording: Recording,
    kind: str = "pd",
    *,
    model: RobotDynamics | None = None,
    cutoff_hz: float | None = None,
) -> FittedController:
    """Fit a controller's gains to efforts, positions and commanded positions of a log.

    Efforts are a linear function of the tracking error, its rate and its integral. All signals
    pass one zero-phase filter, which leaves that function as it is, and gains follow by least
    squares, joint by joint, with a constant and one delay. Where noise of the encoders, had the
    controller not seen it, would bias gains by more than 2 %, the commanded motion of all joints
    serves as instruments.

    Parameters
    ----------
    recording : Recording
        With commanded positions (`Recording.reference`), and efforts in N·m (N).
    kind : {"pd", "p", "pid", "computed_torque"}
        Which of `sdpid.controllers` it is. Whether the commanded velocity is in the law is chosen
        by the data.
    model : RobotDynamics, optional
        The model of the controller, for computed torque.
    cutoff_hz : float, optional
        Cut-off of the filter; by default ten times the frequency below which the motion lies.

    Returns
    -------
    FittedController
        With standard deviations from blocks of residuals, and reasons where it is not to be used:
        a gain with a standard deviation of more than 10 %, a gain that is not positive, efforts
        that the law does not explain.

    Raises
    ------
    DataError
        When there are no commanded positions, efforts are currents, the kind is not known, a
        model is missing, or the recording is too short.

    Examples
    --------
    >>> run = sdpid.simulate(robot, motion, seed=1)
    >>> fitted = sdpid.controllers.fit_controller(run, "p")
    >>> fitted.usable
    True
    >>> fitted.controller
    P(6 joints, proportional_gain 1.28... to 4.47..., velocity_gain ...)
    >>> sdpid.controllers.fit_controller(run, "computed_torque", model=estimate.model()).usable
    False
    """
    if kind not in KINDS:
        raise DataError(f"kind: '{kind}' is not known; known are {', '.join(KINDS)}.")
    require_fixed_base(recording, "fit_controller")
    if recording.reference is None:
        raise DataError(
            "fit_controller: the recording has no commanded positions (reference); read the log "
            "with their columns, columns={'reference': ...}."
        )
    if recording.currents:
        raise DataError(
            "fit_controller: efforts are currents in A; give the gains of the drives (gains=), or "
            "read them as torques."
        )
    if (kind == "computed_torque") != (model is not None):
        raise DataError(
            "fit_controller: computed torque needs the model of the controller (model=), and no "
            f"other kind takes one; the kind is '{kind}'."
        )
    if model is not None:
        recording = match_joints(model.robot, recording)
    signals = tracking(recording, cutoff_hz)
    law, doubt = _law(signals, kind, model)
    best = fit_law(signals, law)
    gains, deviations = _named(best, kind)
    reasons = doubt + _doubts(best, gains, deviations, recording.names)
    if kind in ("p", "pd"):
        reasons += _missing_integral(signals, best, recording.names)
    fixed = {name: frozen(values) for name, values in gains.items()}
    return FittedController(
        kind=kind,
        joint_names=recording.names,
        gains=fixed,
        deviations={name: frozen(values) for name, values in deviations.items()},
        bias=frozen(best.bias),
        r_squared=frozen(1.0 - best.left),
        offset=frozen(best.weights[:, -1]),
        delay=best.delay,
        feedforward=best.law.feedforward,
        method="instrumental" if best.instrumental else "least_squares",
        cutoff_hz=signals.cutoff_hz,
        reasons=tuple(reasons),
        controller=_controller(kind, fixed, best.law.feedforward, model),
    )


def _law(signals: Tracking, kind: str, model: RobotDynamics | None) -> tuple[Law, list[str]]:
    """Return the law of a kind, with or without the commanded velocity, and a doubt about that."""
    s = signals
    off, slow = s.reference - s.position, s.reference_velocity - s.velocity
    if model is not None:
        # The model's mass matrix couples the joints; its inverse takes them apart again.
        arm = SimulatedArm.of(model)
        M, _ = arm.mass_and_bias(s.position, s.velocity)
        without_gains = ComputedTorque(model, kp=np.full(arm.n, 1e-12), kd=np.zeros(arm.n))
        motion = (s.position, s.velocity, s.reference, s.reference_velocity)
        known = without_gains.effort(*motion, s.reference_acceleration)
        pair = np.stack([s.effort - known, s.effort_rate], axis=-1)
        target, rate = np.moveaxis(np.linalg.solve(M, pair), -1, 0)
        return Law.of([off, slow], target, rate), []
    integral = [s.integral] if kind == "pid" else []
    effort = (s.effort, s.effort_rate)
    # Either velocity has a weight of its own: equal ones with feedforward, or none for the
    # commanded one.
    pair_of_rates = [s.reference_velocity, -s.velocity]
    both = fit_law(s, Law.of([off, *pair_of_rates, *integral], *effort, velocity=2))
    told, seen = both.weights[:, 1], both.weights[:, 2]
    C = both.covariances
    of_difference = C[:, 1, 1] + C[:, 2, 2] - 2.0 * C[:, 1, 2]
    with_it = float(np.mean((told - seen) ** 2 / of_difference))
    without = float(np.mean(told**2 / C[:, 1, 1]))
    feedforward = with_it < without
    column = slow if feedforward else -s.velocity
    law = Law.of([off, column, *integral], *effort, feedforward=feedforward)
    if max(with_it, without) > _DECIDED:
        return law, []
    return law, ["the log does not show whether the commanded velocity is in the law"]


def _named(fit: LawFit, kind: str) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return gains, and their deviations as parts of them, by the names of a class."""
    w = fit.weights[:, :-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        deviation = np.nan_to_num(np.sqrt(fit.variances) / np.abs(w), nan=np.inf)
        if kind != "p":
            names = ("kp", "kd", "ki")[: w.shape[1]]
            gains = {name: np.array(w[:, k]) for k, name in enumerate(names)}
            return gains, {name: deviation[:, k] for k, name in enumerate(names)}
        common = fit.covariances[:, 0, 1] / (w[:, 0] * w[:, 1])
        ratio = deviation[:, 0] ** 2 + deviation[:, 1] ** 2 - 2.0 * common
        return (
            {"proportional_gain": w[:, 0] / w[:, 1], "velocity_gain": np.array(w[:, 1])},
            {
                "proportional_gain": np.sqrt(np.maximum(ratio, 0.0)),
                "velocity_gain": deviation[:, 1],
            },
        )


def _doubts(
    fit: LawFit, gains: dict[str, Array], deviations: dict[str, Array], names: tuple[str, ...]
) -> list[str]:
    """Return why a controller is not to be used."""
    reasons = []
    left = int(np.argmax(fit.left))
    if 1.0 - fit.left[left] < _LEAST_EXPLAINED:
        reasons.append(
            f"the law explains {1.0 - fit.left[left]:.1%} of what moves {names[left]}, limit "
            f"{_LEAST_EXPLAINED:.0%}: it is another controller, or the efforts have other parts"
        )
    for name, values in gains.items():
        if name == "ki":
            continue
        worst = int(np.argmax(deviations[name]))
        if not values.min() > 0.0:
            j = int(np.argmin(values))
            reasons.append(f"{name} of {names[j]} is {values[j]:.3g}, and must be positive")
        elif not deviations[name][worst] <= _LARGEST_DEVIATION:
            reasons.append(
                f"{name} of {names[worst]} has a standard deviation of "
                f"{deviations[name][worst]:.0%}, limit {_LARGEST_DEVIATION:.0%}"
            )
    return reasons


def _missing_integral(signals: Tracking, fit: LawFit, names: tuple[str, ...]) -> list[str]:
    """Return that the law lacks an integral, where it does."""
    more = fit_law(signals, fit.law.with_column(signals.integral))
    taken = np.where(fit.left > _LEFT, 1.0 - more.left / np.maximum(fit.left, 1e-300), 0.0)
    j = int(np.argmax(taken))
    if taken[j] < _INTEGRAL:
        return []
    return [
        f"an integral of the error explains {taken[j]:.0%} of what is left at {names[j]}, limit "
        f"{_INTEGRAL:.0%}: fit kind='pid'"
    ]


def _controller(
    kind: str, gains: dict[str, Array], feedforward: bool, model: RobotDynamics | None
) -> Controller | None:
    """Return the controller; None where gains are not those of one."""
    if "ki" in gains:
        gains = {**gains, "ki": np.maximum(gains["ki"], 0.0)}
    try:
        if model is not None:
            return ComputedTorque(model, **gains)
        if kind == "p":
            return P(**gains, feedforward=feedforward)
        law = PID if kind == "pid" else PD
        return law(**gains, feedforward=feedforward)
    except DataError:
        return None
