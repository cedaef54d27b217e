"""Which friction terms, filter and cut-off predict best on five real robots, each left out in turn.

Every candidate is fitted to the training part of every set by the semidefinite program with the
default prior, and scored by its residual on what was held out (see real_robots.py). Of each robot
the others choose.

    python examples/studies/robot_defaults.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from data_sets import ROBOTS, SETS
from real_robots import DEFAULT, DRIVES, METHODS, QUICK, Case, Terms, found

import sdpid
from sdpid._common.arrays import Array, Mask
from sdpid._common.files import atomic_write_text
from sdpid.experiment.preparation.for_robot import SMOOTH, default_processing
from sdpid.experiment.processing.filters import FilterType, low_pass
from sdpid.experiment.processing.motion import motion_frequency
from sdpid.experiment.recording.gaps import continuous

Change = Callable[[sdpid.Recording, sdpid.Processing], sdpid.Processing]


def smooth(*others: str | sdpid.friction.FrictionTerm, width: float | None = SMOOTH) -> Terms:
    """Return a smooth sign, other terms, viscous friction and an offset."""
    return (sdpid.friction.Coulomb(width=width), *others, "viscous", "offset")


FRICTION: dict[str, Terms] = {
    "sign": ("coulomb", "viscous", "offset"),
    "tanh 0.01": smooth(width=0.01),
    "tanh 0.02": smooth(),
    "tanh 0.05": smooth(width=0.05),
    "tanh 0.1": smooth(width=0.1),
    "tanh, chosen widths": smooth(width=None),
    "tanh 0.02, Stribeck": smooth(sdpid.friction.Stribeck(width=SMOOTH)),
    "tanh 0.02, square root": smooth("square_root"),
    "tanh 0.02, sigmoid 0.2": smooth(sdpid.friction.SigmoidFriction(velocity=0.2)),
    "tanh 0.02, sigmoid": smooth("sigmoid"),
    "tanh 0.01, sigmoid": smooth("sigmoid", width=0.01),
    "tanh 0.05, sigmoid": smooth("sigmoid", width=0.05),
    "tanh 0.02, square root, sigmoid": smooth("square_root", "sigmoid"),
    "tanh 0.02, sigmoid, rotor inertia": smooth("sigmoid", "rotor_inertia"),
    "asymmetric tanh 0.02, sigmoid": (
        sdpid.friction.AsymmetricCoulomb(width=SMOOTH),
        *smooth("sigmoid")[1:],
    ),
}

# More terms must predict better by more than this, or any noise would add some.
BETTER = 1.01

# Cut-offs, as factors of the default rule's (30 times the motion, at most 2/15 of the rate).
CUTOFFS: tuple[float, ...] = (1.0 / 3.0, 0.5, 2.0 / 3.0, 1.0, 1.5, 2.0)


# The filter that leaves the least error of an acceleration, from the spectrum of positions: it
# takes from the motion what lies above its cut-off and leaves of the noise what lies below. This is
# Winter's residual analysis [winter2009] carried to the acceleration, with the expected error in
# place of a knee in a curve. Positions of real robots do not have white noise alone: quanta, and
# stamps that are off while the joint moves, leave errors whose rate is white. Both shapes are
# fitted to the upper part of the spectrum and continued downwards; motion is what lies below the
# frequency at which the spectrum meets them.
# The noise is read off above this share of the sampling rate, where arms do not move.
_NOISE_ABOVE = 0.1
# The spectrum is summed over so many bands a decade, and so many cut-offs are tried in one: near
# its least the error changes little.
_BANDS = 40
_CUTOFFS = 12
# Motion ends where, over an octave, the power is no more than so many times that of the noise,
# whose shape is a guess. What stands out further up is vibration, which no rigid model explains.
_STANDS_OUT = 4.0
_ORDERS = (1, 2, 3, 4)
# In the order in which they are preferred.
_TYPES: tuple[FilterType, ...] = ("butterworth", "bessel")
# A higher order (longer memory) or another type must be better by this part of the error.
_SLACK = 0.05
# The cut-off has at least this many periods in the record, and lies below this part of the rate.
_LEAST_PERIODS, _MOST_OVER_RATE = 20.0, 2.0 / 15.0


def least_error(log: sdpid.Recording, default: sdpid.Processing) -> sdpid.Processing:
    """Return the default with the filter of least expected error of the acceleration."""
    log = max(continuous(log)[0], key=lambda piece: piece.n_samples)
    rate = log.rate_hz
    highest = _MOST_OVER_RATE * rate
    lowest = min(max(motion_frequency(log), _LEAST_PERIODS * rate / log.n_samples), highest)
    frequency, motion, noise = _accelerations(log)
    total = motion.sum(axis=0)
    moves = total > 0.0
    # Each joint counts alike.
    signal = (motion[:, moves] / total[moves]).mean(axis=1)
    floor = (noise[:, moves] / total[moves]).mean(axis=1)
    count = max(2, math.ceil(_CUTOFFS * math.log10(highest / lowest)) + 1)
    best = []
    for kind in _TYPES:
        for order in _ORDERS:
            found = []
            for cutoff in np.geomspace(lowest, highest, count).tolist():
                gain = low_pass(kind, min(cutoff, highest), order, rate).gain(frequency, rate)
                error = float(signal @ (1.0 - gain) ** 2 + floor @ gain**2) ** 0.5
                found.append((error, kind, order, min(cutoff, highest)))
            best.append(min(found))
    least = min(error for error, *_ in best)
    good = [each for each in best if each[0] <= (1.0 + _SLACK) * least]
    _, kind, order, cutoff = min(good, key=lambda each: (_TYPES.index(each[1]), each[2]))
    return replace(default, filter=kind, order=order, cutoff_hz=cutoff)


def _accelerations(log: sdpid.Recording) -> tuple[Array, Array, Array]:
    """Return the frequencies (B,) of bands, and power of acceleration and of its noise (B, n).

    Of second differences, which are what the filter is followed by; their spectrum is steep
    neither way, so that a window of Hann keeps bands apart.
    """
    count = log.n_samples - 2
    differences = np.diff(np.asarray(log.position), n=2, axis=0)
    differences *= np.hanning(count)[:, None]
    power = np.abs(np.fft.rfft(differences, axis=0)[1:]) ** 2
    frequency = np.fft.rfftfreq(count, 1.0 / log.rate_hz)[1:]
    bands = np.unique(np.floor(_BANDS * np.log10(frequency / frequency[0])), return_index=True)[1]
    lines = np.diff(np.append(bands, frequency.size))
    seen = np.add.reduceat(power, bands, axis=0)
    # White noise of the rate of the position and of the position, differenced once and twice.
    shape = (2.0 * np.sin(math.pi * frequency / log.rate_hz)) ** 2
    shapes = np.column_stack([np.add.reduceat(shape**k, bands) for k in (1, 2)])
    center = np.add.reduceat(frequency, bands) / lines
    noise = _noise(shapes, seen, center > _NOISE_ABOVE * log.rate_hz)
    return center, *_parted(seen, noise)


def _parted(seen: Array, noise: Array) -> tuple[Array, Array]:
    """Part what was seen (B, n) into motion, below where it meets the noise, and the rest."""
    octave = round(_BANDS * math.log10(2.0))
    motion, rest = np.zeros_like(seen), seen.copy()
    for j in range(seen.shape[1]):
        known = noise[:, j] > 0.0
        ratio = np.divide(seen[:, j], noise[:, j], out=np.full(len(seen), np.inf), where=known)
        # Over an octave, so that what lies between the harmonics of a motion is not its end.
        above = [ratio[b : b + octave].mean() <= _STANDS_OUT for b in range(len(ratio))]
        end = above.index(True) if True in above else len(above)
        rest[:end, j] = np.minimum(noise[:end, j], seen[:end, j])
        motion[:end, j] = seen[:end, j] - rest[:end, j]
    return motion, rest


def _noise(shapes: Array, seen: Array, quiet: Mask) -> Array:
    """Return the power of the noise (B, n): the two shapes, fitted where nothing moves."""
    from scipy.optimize import nnls

    noise = np.zeros_like(seen)
    for j in range(seen.shape[1]):
        used = quiet & (seen[:, j] > 0.0)
        if used.any():
            # Relative errors, since the power of a band scatters in proportion to itself.
            weights, _ = nnls(shapes[used] / seen[used, j, None], np.ones(np.count_nonzero(used)))
            noise[:, j] = shapes @ weights
    return noise


# Other ways to process, beside the default's cut-off.
FILTERS: dict[str, Change] = {
    "default": lambda log, default: default,
    "least error": least_error,
    "Bessel": lambda log, default: replace(default, filter="bessel"),
    "order 2": lambda log, default: replace(default, order=2),
    "central": lambda log, default: replace(default, derivative="central"),
    "Savitzky-Golay": lambda log, default: replace(default, derivative="savitzky_golay"),
}


def times(factor: float) -> Change:
    """Return the default with another cut-off, up to what differences allow."""

    def change(log: sdpid.Recording, default: sdpid.Processing) -> sdpid.Processing:
        highest = max(2.0 / 15.0 * log.rate_hz, default.cutoff_hz)
        return replace(default, cutoff_hz=min(factor * default.cutoff_hz, highest))

    return change


def choices(
    cases: Sequence[Case],
    friction: Mapping[str, Terms],
    factors: Iterable[float],
    filters: Mapping[str, Change],
) -> str:
    """Return what other defaults would predict, and which are best without each robot."""
    default, usual = FILTERS["default"], smooth("sigmoid")
    terms = scores(cases, {label: (each, default) for label, each in friction.items()})
    size = {label: len(candidate) for label, candidate in friction.items()}
    cutoffs = {f"{30.0 * factor:.0f} times the motion": times(factor) for factor in factors}
    tables = [left_out("terms", terms, size)]
    for title, changes in (("cut-off", cutoffs), ("processing", filters)):
        found = scores(cases, {label: (usual, change) for label, change in changes.items()})
        tables.append(left_out(title, found))
    return "\n\n".join(tables) + "\n"


def scores(
    cases: Sequence[Case], candidates: Mapping[str, tuple[Terms, Change]]
) -> dict[str, dict[str, float]]:
    """Return the held-out residuals of all candidates on all sets, %."""
    out = {}
    for label, (terms, change) in candidates.items():
        out[label] = {case.name: held_out(case, terms, change) for case in cases}
        print(label, [f"{value:.2f}" for value in out[label].values()], flush=True)
    return out


def held_out(case: Case, terms: Terms, change: Change) -> float:
    """Return the residual in %, on held-out rows that every candidate shares."""
    processing = default_processing(case.log)
    # The same rows for every filter, or the lowest cut-off would win by smoothing what is
    # predicted.
    fresh = case.held_out(processing)
    drives = tuple(term for term in DRIVES.get(case.name, ()) if term not in terms)
    try:
        samples = case.trained(change(case.log, processing))
        problem = case.problem(samples, METHODS[DEFAULT], (*terms, *drives))
        return 100.0 * sdpid.validate(sdpid.solve_sdp(problem), fresh).relative
    except sdpid.errors.SdpidError:
        return float("inf")


def left_out(
    title: str, scores: Mapping[str, Mapping[str, float]], size: Mapping[str, int] | None = None
) -> str:
    """Return the table of candidates, and of each robot what the others would have chosen.

    The least geometric mean is chosen; where candidates have sizes, of those within 1 % of it
    the smallest, and of equally small ones the first.
    """
    names = list(next(iter(scores.values())))
    lines = [f"| {title} | " + " | ".join(ROBOTS[n] for n in names) + " | geometric mean |"]
    lines.append("|---|" + "---|" * (len(names) + 1))
    for label, score in scores.items():
        values = [score[name] for name in names]
        mean = float(np.exp(np.mean(np.log(values))))
        lines.append(f"| {label} | " + " | ".join(f"{v:.3g}" for v in (*values, mean)) + " |")
    lines += ["", "| left out | the others choose | it then has, % |", "|---|---|---|"]
    for name in names:
        others = [other for other in names if other != name]

        def mean_of(label: str, others: Sequence[str] = others) -> float:
            return float(np.mean([np.log(scores[label][other]) for other in others]))

        best = min(scores, key=mean_of)
        if size is not None:
            limit = mean_of(best) + float(np.log(BETTER))
            best = min((label for label in scores if mean_of(label) <= limit), key=size.__getitem__)
        lines.append(f"| {ROBOTS[name]} | {best} | {scores[best][name]:.3g} |")
    return "\n".join(lines)


def main() -> int:
    """Compare and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--quick", action="store_true", help="two sets, few candidates")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    names = found(options.data, QUICK if options.quick else tuple(SETS))
    friction, factors, filters = FRICTION, CUTOFFS, FILTERS
    if options.quick:
        friction = {label: FRICTION[label] for label in ("tanh 0.02", "tanh 0.02, sigmoid")}
        factors = CUTOFFS[2:4]
        filters = {label: FILTERS[label] for label in ("default", "least error")}
    text = "Nothing to show: no data.\n"
    if names:
        cases = [Case.read(options.data, name) for name in names]
        text = choices(cases, friction, factors, filters)
    atomic_write_text(options.out / "robot_defaults.md", text)
    print(f"\n{text}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
