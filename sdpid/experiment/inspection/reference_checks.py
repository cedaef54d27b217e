"""Check that commanded positions are those that the robot followed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.finding import Finding
from sdpid.experiment.inspection.kinds import found
from sdpid.experiment.inspection.motion_checks import scale_in_words
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.rest import moving
from sdpid.experiment.recording.stored import taken

# Compared on this many samples from the middle of a piece, as means over 1000 intervals.
_COMPARED = 100_000
_INTERVALS = 1000
_LEAST_INTERVALS = 20
# On six simulated arms fits to a joint's own reference correlate by more than 0.999, those to
# another joint's by less than 0.75.
_CORRELATED = 0.9
_SCALE = 1.3
# What is left between them once the effort that gravity and friction need is accounted for
# (rad, or m).
_OFFSET = 0.1
# Positions do not come before their references (s); clocks and filters account for a few samples.
_EARLIEST = -0.02

# Positions, references and efforts as means over intervals, and the intervals' length in s.
_Means: TypeAlias = tuple[Array, Array, Array, float]


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """A reference as scale × the position some time later, plus an offset.

    What a proportional controller lags behind for its effort is accounted for: a slow loop is no
    wrong reference.
    """

    scale: float
    offset: float
    lag: float
    correlation: float


@check
def references(subject: Subject) -> Iterator[Finding]:
    """Find references that the positions do not follow."""
    if subject.log.reference is None or not subject.pieces:
        return
    longest = subject.longest
    means = _means(longest)
    if means is None:
        return
    position, reference, effort, step = means
    wrong: dict[str, tuple[str, _Fit]] = {}
    for j in np.flatnonzero(moving(*subject.position_range)).tolist():
        fit = _fit(position[:, j], reference[:, j], effort[:, j], step)
        what = _wrong(fit, longest.names, j, means)
        if what is not None:
            wrong[longest.names[j]] = what, fit
    if not wrong:
        return
    # Joints mostly share the defect: columns that are swapped, a unit, another signal.
    alone = len(wrong) == 1
    numbers = {
        key if alone else f"{name}: {key}": value
        for name, (_, fit) in wrong.items()
        for key, value in vars(fit).items()
    }
    told = "; of ".join(f"{name} {what}" for name, (what, _) in wrong.items())
    yield found("reference_unlike", next(iter(wrong)) if alone else None, wrong=told, **numbers)


def _wrong(fit: _Fit, names: tuple[str, ...], j: int, means: _Means) -> str | None:
    """Return what is wrong with a joint's reference, in words."""
    if fit.correlation < _CORRELATED:
        position, reference, effort, step = means
        each = zip(position.T, effort.T, strict=True)
        others = [_fit(q, reference[:, j], tau, step).correlation for q, tau in each]
        best = int(np.argmax(others))
        if others[best] > _CORRELATED:
            return f"is followed by {names[best]} (correlation {others[best]:.3g})"
        return f"is not followed (correlation {fit.correlation:.2f}, limit {_CORRELATED:g})"
    if not 1.0 / _SCALE < fit.scale < _SCALE:
        words = scale_in_words(fit.scale)
        limits = f"limit {1.0 / _SCALE:.2g} to {_SCALE:g}"
        return f"is {fit.scale:.3g} times the position{words}, {limits}"
    if abs(fit.offset) > _OFFSET:
        return f"is {fit.offset:.3g} rad off the position on average, limit {_OFFSET:g}"
    if fit.lag < _EARLIEST:
        return f"comes {-fit.lag:.3g} s after the motion, limit {-_EARLIEST:g}: it is no command"
    return None


def _means(log: Recording) -> _Means | None:
    """Return means of positions, references, efforts over intervals, and the intervals' length."""
    assert log.reference is not None
    begin = max(0, (log.n_samples - _COMPARED) // 2)
    given = (log.position, log.reference, log.effort)
    tables = [taken(each, begin, begin + _COMPARED) for each in given]
    stride = max(1, len(tables[0]) // _INTERVALS)
    count = len(tables[0]) // stride
    if count < _LEAST_INTERVALS:
        return None
    position, reference, effort = (
        table[: count * stride].reshape(count, stride, -1).mean(axis=1) for table in tables
    )
    return position, reference, effort, stride * log.step


def _fit(position: Array, reference: Array, effort: Array, step: float) -> _Fit:
    """Fit a reference by the position, its rate, the effort and a constant."""
    rate = (position[2:] - position[:-2]) / (2.0 * step)
    position, reference = position[1:-1], reference[1:-1]
    mean = float(position.mean())
    signals = (position - mean, rate, effort[1:-1], np.ones_like(rate))
    columns = np.column_stack(signals)
    weights = np.linalg.lstsq(columns, reference)[0]
    scale, slope, _, level = weights.tolist()
    return _Fit(
        scale=scale,
        offset=level - mean,
        lag=slope / scale if scale != 0.0 else 0.0,
        correlation=_correlation(columns @ weights, reference),
    )


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation of two signals, 0 where one is constant."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else 0.0
