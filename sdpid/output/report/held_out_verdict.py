"""Findings about what was held out: whether other motion is predicted, and within which bands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid.assurance.diagnostics.rest import moving_rows
from sdpid.errors import SdpidError
from sdpid.output.report.grades import Finding, percent
from sdpid.output.report.judged import Judged

# Held-out over training error. Another motion weighs the same defects differently, which makes
# some 20 % either way; at 1.5 half as much again is wrong on what was not seen as on what was.
CARRIES, FAILS = 1.2, 1.5

# Bands that should hold 95 % of the rows are believed down to this share.
COVERED = 0.9


def held_out_findings(result: Judged) -> Iterator[Finding]:
    """Yield how the error on what was held out compares, and what the bands hold of it."""
    yield from _held_out(result)
    yield from _beaten(result)
    yield from _bands(result)
    yield from _crossed(result)


def _held_out(result: Judged) -> Iterator[Finding]:
    """Compare the error on what was held out with the training error."""
    held_out = result.held_out
    if held_out is None:
        yield Finding(
            "caution",
            "Nothing was held out, so every error here is on the data that were fitted: how well "
            "it predicts other motion is not known. Give a second recording (--validation).",
        )
        return
    if not held_out.fit.moving.rows.any():
        yield Finding(
            "bad",
            "Nothing moves on what was held out: how well it predicts motion is not known. Give a "
            "recording of motion with --validation.",
            "judge it by what was held out: nothing moves there",
        )
        return
    held, own = held_out.fit.moving.relative, result.training.moving.relative
    ratio = held / max(own, np.finfo(float).tiny)
    numbers = f"relative residual in motion {percent(held)}, on the training data {percent(own)}"
    if held_out.by == "blocks":
        if ratio > FAILS:
            yield _not_seen(f"on blocks held out in turn {numbers}", ratio, "blocks")
        else:
            yield Finding(
                "caution",
                f"Other motion is not shown: on blocks of the same motion, held out in turn, "
                f"{numbers}. Give another motion with --validation.",
            )
    elif ratio <= CARRIES:
        yield Finding("good", f"It carries over to other motion: {numbers}.")
    elif ratio <= FAILS:
        yield Finding("caution", f"It is somewhat worse on other motion: {numbers}.")
    else:
        yield Finding(
            "bad",
            f"It does not carry over to other motion: {numbers}, {ratio:.1f} times as much. The "
            "motion was too poor for the model, or the robot changed in between (load, "
            "temperature).",
            f"trust it on other motion: {ratio:.1f} times the error on recordings not fitted",
        )


def _not_seen(numbers: str, ratio: float, what: str) -> Finding:
    """Return that what was held out of the recordings is predicted badly."""
    return Finding(
        "bad",
        f"It does not predict what it has not seen: {numbers}, {ratio:.1f} times as much. "
        "Parts of the recording show what the others do not: record more of it.",
        f"trust it on other motion: {ratio:.1f} times the error on {what} not fitted",
    )


def _beaten(result: Judged) -> Iterator[Finding]:
    """Say what costs less and predicts better, and what was tried against it."""
    held_out = result.held_out
    if held_out is None or (better := held_out.beaten_by) is None:
        return
    own, other = (each.told.relative for each in (held_out.fit, held_out.baselines[better]))
    tried = "; ".join(each.words for each in result.remedies)
    yield Finding(
        "bad",
        f"What costs less predicts better what was held out: {better} misses {percent(other)}, "
        f"this estimate {percent(own)}." + f" Tried: {tried}." * bool(tried),
        f"use it: {better} predicts better what was held out",
    )


def _bands(result: Judged) -> Iterator[Finding]:
    """Say how much of other motion the bands of predicted efforts hold."""
    share = inside_bands(result)
    if share is None:
        return
    good = share >= COVERED
    yield Finding(
        "good" if good else "caution",
        f"The 95 % bands of predicted efforts hold {percent(share)} of the rows in motion"
        + (
            "."
            if good
            else ": other motion is worse than the training recording lets expect; do not rely on "
            "the bands."
        ),
    )


def inside_bands(result: Judged) -> float | None:
    """Return the share of moving rows of other recordings within the 95 % bands, if any."""
    held_out = result.held_out
    if held_out is None or held_out.by != "recording":
        return None
    samples, moving = held_out.samples, moving_rows(held_out.samples, held_out.fit.slides)
    try:
        band = held_out.fit.effort_band
    except SdpidError:  # no covariance; a verdict must not cost the run
        return None
    if band is None or not moving.any():
        return None
    inside = np.abs(samples.effort - held_out.fit.effort_predicted) <= band
    return float(inside[moving].mean())


def _crossed(result: Judged) -> Iterator[Finding]:
    """Compare the error of the cross-validation that was asked for with the training error."""
    crossed = result.cross_validation
    if crossed is None:
        return
    blocks = crossed.by == "time"
    what = "blocks of time" if blocks else "recordings"
    low, high = float(crossed.relatives.min()), float(crossed.relatives.max())
    ratio = crossed.relative / max(crossed.training, np.finfo(float).tiny)
    numbers = (
        f"with {len(crossed.relatives)} {what} held out in turn, and every choice made without "
        f"them, the relative residual in motion is {percent(crossed.relative)} ({percent(low)} to "
        f"{percent(high)}), on the training data {percent(crossed.training)}"
    )
    if ratio > FAILS:
        yield _not_seen(numbers, ratio, what)
    elif blocks:
        yield Finding("caution", f"It predicts blocks of the same motion: {numbers}.")
    elif ratio <= CARRIES:
        yield Finding("good", f"It predicts what it has not seen as well: {numbers}.")
    else:
        yield Finding("caution", f"It is somewhat worse on what it has not seen: {numbers}.")
