"""Choose the processing of a recording, with reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from operator import itemgetter
from typing import Any

from sdpid._common.files import require_known
from sdpid.errors import DataError
from sdpid.experiment.processing.base import base_limit, landing_share
from sdpid.experiment.processing.filters import BAND_OVER_RATE
from sdpid.experiment.processing.motion import MOTION_SHARE, motion_frequency, noise_limit
from sdpid.experiment.processing.settings import Processing, Reason
from sdpid.experiment.recording.floating import Contacts
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.plausible import disagreement
from sdpid.experiment.recording.recording import Recording

# The cut-off for records without periods: this many times the frequency below which 95 % of the
# motion lies (the paper's decade above the fastest motion, which reaches some three times as far),
# and at most the share of the sampling rate up to which positions are differentiated well.
_CUTOFF_OVER_MOTION = 25.0
# Rows are masked this share of a period of the cut-off around slow motion; a longer mask costs rows
# near reversals that other motion has. A joint that hardly moves is not masked.
_MASKED_PERIODS = 0.1
_KEPT_SHARE = 0.1
# Recordings with a base: a filter that forgets, since a foot counts as down for as long as it is
# remembered. Its half length is one period of the cut-off. At 9, 15 and 24 times the motion errors
# on a walk of a simulated Solo12 were 0.24, 0.08 and 0.06 % (stand, trot, hang; friction known),
# and the number of samples grows with it.
_FINITE_ORDER = 2
_FINITE_CUTOFF_OVER_MOTION = 15.0
# Noise in accelerations makes inertias too small by its share of the accelerations' power. At 15
# times a trot, 90 Hz, that is 0.5 %, several standard errors; below this share it is a fraction of
# one, and trots of a simulated Go1 and Solo12 were two to five times nearer to the truth. Not less
# than this many times the motion.
_NOISE_SHARE = 2e-4
_LEAST_CUTOFF_OVER_MOTION = 5.0
# Noise of a pose that the base's accelerations are differences of makes masses too small by its
# share of the power of gravity and acceleration: 1.1 % at 23.5 Hz and 0.03 % at 10 Hz of a
# simulated Go1 (3e-4 m at 1 kHz), as computed. The same share as of joints, with more room.
_LEAST_CUTOFF_OF_POSE_OVER_MOTION = 2.0
# A landing jolts joints and base within a sample or two, so that differences of positions are not
# the accelerations that the efforts of these samples belong to. Without the samples whose filter
# sees one, stand, trot and hang together had half the errors on a walk. A trot alone had twice the
# errors: there most of what is fast is a landing. So not where more than this share would go.
_MOST_NEAR_LANDINGS = 0.1
# Below this rate differences of the position lose too much, and a recorded velocity is used.
RATE_OF_DIFFERENCES = 100.0


def default_processing(
    log: Recording, changes: Processing | Mapping[str, Any] | None = None
) -> Processing:
    """Choose how a recording is processed, from this recording alone.

    A record with periods is averaged over them, filtered as by ``Processing()``; where they are
    too few for a covariance of each sample, one is pooled over the samples, and one period alone
    has none.

    A record without periods passes a Butterworth filter of order 4 whose cut-off is 25 times the
    frequency below which 95 % of its motion lies (the median over the joints), at most 2/15 of the
    sampling rate: of 12 to 50 times it predicts best on six real robots
    (docs/evidence/real_robots.md). Rows
    near reversals and at rest are masked, unless less than a tenth of a joint's rows would stay. A
    recorded velocity is used below 100 Hz, where differences of the position lose too much, as
    long as it is the rate of the position. Recordings with a base: docs/guides/processing.md.

    Parameters
    ----------
    log : Recording
        What is to be trained on. Where it has gaps, its longest piece decides.
    changes : Processing or mapping, optional
        What is changed afterwards. The source of the base's accelerations decides what noise they
        have; other changes say nothing here.

    Returns
    -------
    Processing
        Its `reasons` say why each setting has its value.

    Raises
    ------
    DataError
        When no joint moves.
    """
    source: dict[str, Any] = {}
    settings: dict[str, Any] = {}
    if isinstance(changes, Mapping) and "base_motion" in changes:
        source["base_motion"] = changes["base_motion"]
    if log.period_layout is not None:
        reasons = [_with_periods(log.period_layout[2], log.n)]
    else:
        log = max(continuous(log)[0], key=lambda piece: piece.n_samples)
        settings, reasons = _without_periods(log, source.get("base_motion", "auto"))
    settings |= {reason.field: reason.value for reason in reasons}
    return Processing(**settings, **source, reasons=tuple(reasons))


def with_changes(processing: Processing, changes: Mapping[str, Any]) -> Processing:
    """Return a processing with some settings changed.

    Raises
    ------
    DataError
        When a change names no setting, or its value is out of range.
    """
    if not isinstance(changes, Mapping):
        raise DataError(
            f"processing: is {changes!r}, expected a Processing or a mapping of its settings."
        )
    settings = [field.name for field in fields(Processing) if field.name != "reasons"]
    require_known(changes, settings, "processing", "is no setting")
    return replace(processing, **changes)


def _with_periods(periods: int, joints: int) -> Reason:
    """Choose the covariance that the periods allow."""
    covariance, why = None, "no spread"
    if periods > joints:
        covariance, why = "period", "more than joints"
    elif periods > 1:
        covariance, why = "pooled", f"no more than {joints} joints: too few for one a sample"
    text = f"{periods} {'period' if periods == 1 else 'periods'}, {why}"
    return Reason(field="covariance", value=covariance, text=text)


def _without_periods(log: Recording, base_motion: str) -> tuple[dict[str, Any], list[Reason]]:
    """Choose filter, velocity and derivative from a record without gaps, the last two with why."""
    motion, rate = motion_frequency(log), log.rate_hz
    slowest = rate / log.n_samples
    times = _CUTOFF_OVER_MOTION if log.base is None else _FINITE_CUTOFF_OVER_MOTION
    lies = f"{100 * MOTION_SHARE:g} % of the motion lies below {motion:.4g} Hz"
    cap = f"2/15 of the rate of {rate:.6g} Hz"
    why = f"{times:g} × motion, below {cap}; {lies}"
    if motion < slowest:
        why = f"{times:g} × {slowest:.4g} Hz, the slowest that the record shows"
    bounds = [
        (BAND_OVER_RATE * rate, f"{cap}, below {times:g} × motion; {lies}"),
        (times * max(motion, slowest), why),
    ]
    if log.base is not None:
        quiet, least = noise_limit(log, _NOISE_SHARE), _LEAST_CUTOFF_OVER_MOTION
        why = (
            f"noise is {100 * _NOISE_SHARE:g} % of the power of joint accelerations below; "
            f"at most {times:g} × motion, at least {least:g} ×; {lies}"
        )
        bounds.append((max(quiet, least * motion), why))
        still = base_limit(log.base, rate, _NOISE_SHARE, base_motion)
        least = _LEAST_CUTOFF_OF_POSE_OVER_MOTION
        why = (
            f"noise in the base's acceleration is {100 * _NOISE_SHARE:g} % of the power of gravity "
            f"below, at least {least:g} × motion; {lies}"
        )
        bounds.append((max(still, least * motion), why))
    # The first of equal ones.
    cutoff, why = min(bounds, key=itemgetter(0))
    velocity, why_velocity = _velocity(log, max(motion, slowest))
    reasons = [
        Reason(field="cutoff_hz", value=cutoff, text=why),
        Reason(field="velocity", value=velocity, text=why_velocity),
    ]
    if log.contacts is not None:
        reasons.append(_impact(log.contacts, rate, cutoff))
    return {
        "order": 4 if log.base is None else _FINITE_ORDER,
        "decimation": None,
        "reversal_time": _MASKED_PERIODS / cutoff,
        "kept_share": _KEPT_SHARE,
        "derivative": "central4",
        "filter": "butterworth" if log.base is None else "finite",
    }, reasons


def _impact(contacts: Contacts, rate: float, cutoff: float) -> Reason:
    """Choose whether samples whose filter sees a landing are left out."""
    share = landing_share(contacts, round(rate / cutoff))
    seen = f"the filter of {100.0 * share:.3g} % of the samples sees a landing"
    if share > _MOST_NEAR_LANDINGS:
        limit = f"more than {100.0 * _MOST_NEAR_LANDINGS:g} %"
        return Reason(field="impact_s", value=None, text=f"{seen}, {limit}: all are kept")
    return Reason(field="impact_s", value=0.0, text=f"{seen}, where positions jump: left out")


def _velocity(log: Recording, motion: float) -> tuple[str, str]:
    """Choose between the recorded velocity and the position's derivative."""
    limit = f"{RATE_OF_DIFFERENCES:g} Hz"
    if log.velocity is None:
        return "differentiated", "none was recorded"
    if log.rate_hz >= RATE_OF_DIFFERENCES:
        return "differentiated", f"sampled at {log.rate_hz:.6g} Hz, not below {limit}"
    wrong = disagreement(log, motion)
    if wrong is not None:
        return "differentiated", f"the recorded one is not used: {wrong}"
    return "measured", f"sampled at {log.rate_hz:.6g} Hz, below {limit}, and agrees with positions"
