"""Gains of a controller from a log with commanded positions, and how well it shows them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sdpid._common.arrays import Array, frozen, is_number
from sdpid._common.files import require_known
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.errors import DataError
from sdpid.experiment.processing.filters import low_pass
from sdpid.experiment.processing.motion import motion_frequency
from sdpid.experiment.recording.gaps import continuous, make_grid
from sdpid.experiment.recording.joints import require_fixed_base
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.controllers import PD, PID, Controller, P

KINDS: dict[str, type[P] | type[PD] | type[PID]] = {"p": P, "pd": PD, "pid": PID}
# Above this standard deviation of a gain, output error is no better than without the controller.
_LARGEST_DEVIATION = 0.1
# The right law explains all but noise; wrong ones leave more.
_LEAST_EXPLAINED = 0.98
# A law whose weights are off by less than this, squared and over their variances, is not excluded.
_DECIDED = 16.0
# An integral that takes this part of what is left belongs to the law, where more than this part
# of the efforts is left.
_INTEGRAL, _LEFT = 0.5, 1e-4
# The law is linear, so every signal may pass one filter; it lets pass what moves the robot, and
# its friction, and not the noise of encoders. In Hz, and as a part of the sample rate at most.
_PASS, _LEAST_PASS, _LARGEST_PART = 10.0, 2.0, 0.1
_ORDER = 2
# Ends are left out where the filter's guess of what came before still shows to 1e-4.
_FORGOTTEN = 9.0
# Rows for each period of the cut-off.
_ROWS = 4.0
_LEAST_ROWS = 200
# A delay is taken where it is this many deviations from zero, up to this many seconds.
_SURE, _LONGEST = 4.0, 0.02
# Contiguous blocks whose scores count as independent: of this many rows at least, some periods of
# the filter's cut-off.
_MOST_BLOCKS, _LEAST_BLOCKS, _ROWS_OF_BLOCK = 40, 10, 20


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FittedController(Shown):
    """A controller's gains as a log shows them, with their errors.

    Attributes
    ----------
    kind : str
        Kind of the controller: ``"p"``, ``"pd"`` or ``"pid"``.
    joint_names : tuple of str
        The joints.
    gains : mapping of str to ndarray, shape (n,)
        By their names in the controller's class.
    deviations : mapping of str to ndarray, shape (n,)
        Standard deviations over the gains, from blocks of residuals; without the bias by noise in
        the logged positions that the controller did not see.
    r_squared : ndarray, shape (n,)
        Part of the efforts' variance that the controller explains.
    offset : ndarray, shape (n,)
        Constant effort beside the controller's, N·m (N).
    delay : float
        By how much the efforts are later than the law, s; zero where the log shows none.
    feedforward : bool
        Whether the reference's velocity is in the law.
    cutoff_hz : float
        Cut-off of the filter that all signals passed.
    reasons : tuple of str
        Why the controller is not to be used; empty where it is.
    controller : Controller or None
        Of `sdpid.controllers`; None where gains are not positive.

    Examples
    --------
    >>> run = sdpid.simulate(robot, motion, seed=1)
    >>> fitted = sdpid.controllers.fit_controller(run, "p")
    >>> fitted.usable, fitted.kind, fitted.feedforward
    (True, 'p', False)
    >>> fitted.controller
    P(6 joints, proportional_gain 1.28... to 4.47..., velocity_gain ...)
    """

    kind: str
    joint_names: tuple[str, ...]
    gains: Mapping[str, Array]
    deviations: Mapping[str, Array]
    r_squared: Array
    offset: Array
    delay: float
    feedforward: bool
    cutoff_hz: float
    reasons: tuple[str, ...]
    controller: Controller | None

    _facts = ("kind", "usable", "feedforward", "delay, s")

    @property
    def usable(self) -> bool:
        """Whether gains are known well enough to simulate with, and explain the efforts."""
        return not self.reasons

    def require(self) -> Controller:
        """Return the controller.

        Raises
        ------
        DataError
            When it is not usable, with the reasons.
        """
        if self.reasons or self.controller is None:
            raise DataError(
                f"the controller is not known well enough: {'; '.join(self.reasons)}. Give it, as "
                "one of sdpid.controllers, or use a method that needs none."
            )
        return self.controller

    def table(self) -> Table:
        """Return one row a joint: gains, their deviations in percent, what is explained."""
        columns: dict[str, list[Any]] = {"joint": list(self.joint_names)}
        for name, values in self.gains.items():
            columns[name] = values.tolist()
            columns[f"{name}, deviation %"] = (100.0 * self.deviations[name]).tolist()
        columns["unexplained %"] = (100.0 * (1.0 - self.r_squared)).tolist()
        return Table.of_columns(columns)

    def describe(self) -> str:
        """Return gains and errors as a table, and what they may be used for."""
        law = f"{self.kind}, {'with' if self.feedforward else 'without'} feedforward of velocity"
        delay = f", delay {1e3 * self.delay:.3g} ms" if self.delay else ""
        verdict = "usable" if self.usable else "not usable: " + "; ".join(self.reasons)
        return "\n".join([f"controller {law}{delay}", self.table().text(4), verdict])

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        values = {**vars(self), "usable": self.usable}
        del values["controller"]
        return plain_dict(values)

    def _tables(self) -> Iterator[Table]:
        yield self.table()


def fit_controller(
    recording: Recording, kind: str = "pd", *, cutoff_hz: float | None = None
) -> FittedController:
    """Fit a controller's gains to efforts, positions and commanded positions of a log.

    Efforts are a linear function of the tracking error, its rate and its integral. All signals
    pass one zero-phase filter, which leaves that function as it is, and gains follow by least
    squares, joint by joint, with a constant and one delay.

    Noise in the logged positions that the controller did not see biases the weights of the error
    and its rate towards zero, the more the higher the cut-off; neither the deviations nor the
    reasons show it. Fits at two cut-offs that differ by more than their deviations do.

    Parameters
    ----------
    recording : Recording
        With commanded positions (`Recording.reference`), and efforts in N·m (N).
    kind : {"pd", "p", "pid"}
        Which of `sdpid.controllers` it is. Whether the commanded velocity is in the law is chosen
        by the data.
    cutoff_hz : float, optional
        Cut-off of the filter, at most a tenth of the sample rate; by default ten times the
        frequency below which the motion lies, at least 2 Hz.

    Returns
    -------
    FittedController
        With standard deviations from blocks of residuals, and reasons where it is not to be used:
        a gain with a standard deviation of more than 10 %, a gain that is not positive, efforts
        that the law does not explain.

    Raises
    ------
    DataError
        When there are no commanded positions, efforts are currents, the kind is not known, the base
        floats, the cut-off is too high, or the recording is too short.

    Examples
    --------
    >>> run = sdpid.simulate(robot, motion, seed=1)
    >>> fitted = sdpid.controllers.fit_controller(run, "p")
    >>> fitted.usable
    True
    >>> fitted.controller
    P(6 joints, proportional_gain 1.28... to 4.47..., velocity_gain ...)
    """
    require_known([kind], KINDS, "kind")
    if not isinstance(recording, Recording):
        raise DataError(
            f"recording: is {recording!r:.80}; give a Recording, such as "
            "sdpid.read_recording(path) returns."
        )
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
    signals, cutoff_hz = _signals(recording, cutoff_hz)
    off, told, seen, integral, *efforts = signals
    others = [integral] if kind == "pid" else []
    feedforward, doubts = _feedforward(_law_fit(efforts, [off, told, -seen, *others]))
    columns = [off, told - seen if feedforward else -seen, *others]
    fit = _law_fit(efforts, columns)
    gains, deviations = _named(fit, kind)
    doubts += _doubts(fit, gains, deviations, recording.names)
    if kind != "pid":
        more = _law_fit(efforts, [*columns, integral])
        taken = np.where(fit.left > _LEFT, 1.0 - more.left / np.maximum(fit.left, 1e-300), 0.0)
        if taken.max() >= _INTEGRAL:
            doubts.append(
                f"an integral of the error explains {taken.max():.0%} of what is left at "
                f"{recording.names[taken.argmax()]}, limit {_INTEGRAL:.0%}: fit kind='pid'"
            )
    controller: Controller | None = None
    if all(x.min() > 0.0 for name, x in gains.items() if name != "ki"):
        limited: dict[str, Any] = {name: np.maximum(x, 0.0) for name, x in gains.items()}
        controller = KINDS[kind](**limited, feedforward=feedforward)
    return FittedController(
        kind=kind,
        joint_names=recording.names,
        gains={name: frozen(x) for name, x in gains.items()},
        deviations={name: frozen(x) for name, x in deviations.items()},
        r_squared=frozen(1.0 - fit.left),
        offset=frozen(fit.weights[:, -1]),
        delay=fit.delay,
        feedforward=feedforward,
        cutoff_hz=cutoff_hz,
        reasons=tuple(doubts),
        controller=controller,
    )


class _LawFit(NamedTuple):
    """A law of n joints with m weights: least squares, and one delay of the efforts."""

    weights: Array
    covariances: Array
    left: Array
    delay: float


def _law_fit(efforts: Sequence[Array], columns: list[Array]) -> _LawFit:
    """Fit weights of columns (K, n) and a constant to efforts and their rates, which may be late.

    The effort at t + d, to first order in d, follows from the columns at t.
    """
    X = np.stack([*columns, np.ones_like(columns[0])], axis=-1).transpose(1, 0, 2)
    effort, rate = (each.T[..., None] for each in efforts)
    inverse = np.linalg.pinv(X)
    rest, move = (each - X @ (inverse @ each) for each in (effort, rate))
    least = np.maximum(1e-12 * np.mean(effort**2, axis=1, keepdims=True), 1e-300)
    weighted = move / np.maximum(np.mean(rest**2, axis=1, keepdims=True), least)
    size, delay, variance = float(np.sum(weighted * move)), 0.0, 0.0
    if size > 0.0:
        delay = -float(np.sum(weighted * rest)) / size
        scores = _block_sums(np.sum(weighted * (rest + delay * move), axis=0, keepdims=True))
        variance = float(np.sum(scores**2)) / size**2
    if delay**2 <= _SURE**2 * variance or abs(delay) > _LONGEST:
        delay, variance = 0.0, 0.0
    target, residual, moved = effort + delay * rate, rest + delay * move, inverse @ rate
    scores = _block_sums(X * residual)
    spread = inverse @ inverse.mT @ scores.mT
    # As many blocks as weights less.
    blocks, m = scores.shape[1:]
    covariances = blocks / (blocks - m) * spread @ spread.mT + variance * moved @ moved.mT
    left = np.mean(residual**2, axis=(1, 2)) / np.maximum(target.var(axis=(1, 2)), 1e-300)
    return _LawFit((inverse @ target)[..., 0], covariances, left, delay)


def _block_sums(rows: Array) -> Array:
    """Return the sums over contiguous blocks of rows (n, K, m), (n, blocks, m)."""
    count = min(max(rows.shape[1] // _ROWS_OF_BLOCK, _LEAST_BLOCKS), _MOST_BLOCKS)
    starts = np.linspace(0, rows.shape[1], count, endpoint=False).astype(np.intp)
    return np.asarray(np.add.reduceat(rows, starts, axis=1))


def _feedforward(fit: _LawFit) -> tuple[bool, list[str]]:
    """Return whether the commanded velocity is in the law, and a doubt about that.

    Either velocity has a weight of its own: equal ones with it, or none for the commanded one.
    """
    (told, seen), C = fit.weights[:, 1:3].T, fit.covariances
    of_difference = C[:, 1, 1] + C[:, 2, 2] - 2.0 * C[:, 1, 2]
    # Efforts of zero show neither, and without an error.
    with np.errstate(divide="ignore", invalid="ignore"):
        with_it = float(np.mean((told - seen) ** 2 / of_difference))
        without = float(np.mean(told**2 / C[:, 1, 1]))
    doubt = "the log does not show whether the commanded velocity is in the law"
    return with_it < without, [] if max(with_it, without) > _DECIDED else [doubt]


def _named(fit: _LawFit, kind: str) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return gains, and their deviations as parts of them, by the names of a class."""
    w, C = fit.weights[:, :-1].T, fit.covariances
    with np.errstate(divide="ignore", invalid="ignore"):
        variances = np.einsum("jmm->mj", C)[:-1] / w**2
        if kind == "p":
            common = 2.0 * C[:, 0, 1] / (w[0] * w[1])
            variances[0] = np.maximum(variances[0] + variances[1] - common, 0.0)
            w = np.stack([w[0] / w[1], w[1]])
    names = ("proportional_gain", "velocity_gain") if kind == "p" else ("kp", "kd", "ki")
    deviations = np.nan_to_num(np.sqrt(variances), nan=np.inf)
    return dict(zip(names, w, strict=False)), dict(zip(names, deviations, strict=False))


def _doubts(
    fit: _LawFit, gains: dict[str, Array], deviations: dict[str, Array], names: tuple[str, ...]
) -> list[str]:
    """Return why a controller is not to be used."""
    reasons = []
    left = int(np.argmax(fit.left))
    if 1.0 - fit.left[left] < _LEAST_EXPLAINED:
        reasons.append(
            f"the law explains {1.0 - fit.left[left]:.1%} of what moves {names[left]}, limit "
            f"{_LEAST_EXPLAINED:.0%}: it is another controller, or the efforts have other parts"
        )
    for name in [each for each in gains if each != "ki"]:
        values, own = gains[name], deviations[name]
        low, worst = int(np.argmin(values)), int(np.argmax(own))
        if not values[low] > 0.0:
            reasons.append(f"{name} of {names[low]} is {values[low]:.3g}, and must be positive")
        elif not own[worst] <= _LARGEST_DEVIATION:
            reasons.append(
                f"{name} of {names[worst]} has a standard deviation of {own[worst]:.0%}, limit "
                f"{_LARGEST_DEVIATION:.0%}"
            )
    return reasons


def _signals(log: Recording, cutoff_hz: float | None) -> tuple[Array, float]:
    """Return the signals of a controller (6, K, n), passed through one filter, and its cut-off.

    They are position error, commanded and measured velocity, integral, effort and its rate. The
    integral is that of the position error from the first sample of each piece on.
    """
    pieces, _ = continuous(log)
    if cutoff_hz is None:
        motion = motion_frequency(max(pieces, key=lambda piece: piece.n_samples))
        cutoff_hz = min(max(_PASS * motion, _LEAST_PASS), _LARGEST_PART * log.rate_hz)
    elif not (is_number(cutoff_hz) and 0.0 < cutoff_hz <= _LARGEST_PART * log.rate_hz):
        raise DataError(
            f"cutoff_hz: is {cutoff_hz!r:.80}, expected at most "
            f"{_LARGEST_PART * log.rate_hz:.4g} Hz, {_LARGEST_PART:g} of the sample rate."
        )
    signals = np.concatenate([_filtered(piece, cutoff_hz) for piece in pieces], axis=1)
    if signals.shape[1] < _LEAST_ROWS:
        raise DataError(
            f"fit_controller: {signals.shape[1]} rows are left at a cut-off of {cutoff_hz:.3g} Hz, "
            f"at least {_LEAST_ROWS} are needed; give a longer recording."
        )
    return signals, cutoff_hz


def _filtered(log: Recording, cutoff_hz: float) -> Array:
    """Return the signals of a piece without gaps: every so many rows, without the ends."""
    grid = make_grid(log)
    low = low_pass("butterworth", cutoff_hz, _ORDER, 1.0 / grid.step)
    edge = int(_FORGOTTEN * low.time_constant) + 3
    stride = max(1, int(1.0 / (grid.step * _ROWS * cutoff_hz)))
    if grid.count < 3 * edge:
        return np.empty((6, 0, log.n))
    tables: Any = (log.position, log.reference, log.effort)
    q, told, effort = (low.apply(grid.read(table, 0, grid.count)) for table in tables)
    v, told_v, rate = (np.gradient(each, grid.step, axis=0) for each in (q, told, effort))
    off = told - q
    integral = np.cumsum(off, axis=0) * grid.step - off * (grid.step / 2.0)
    signals = np.stack([off, told_v, v, integral, effort, rate])
    return np.ascontiguousarray(signals[:, edge : grid.count - edge : stride])
