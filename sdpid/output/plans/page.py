"""The page of a plan: what to run, its limits, what it will buy, and the moving arm.

One HTML file that loads nothing; of scripts only the player runs, by its digest.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from itertools import cycle
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.excitation.expected.expected import NORMAL, Expected
from sdpid.excitation.plan.limited import limited_quantities
from sdpid.excitation.plan.plan import Plan
from sdpid.experiment.trajectory.played import Played, played
from sdpid.output.plans.scene import scene_of
from sdpid.output.plans.words import sentences, tiles
from sdpid.output.report.page import page
from sdpid.output.scene.motion import FRAME_RATE
from sdpid.plots.in_pages import image_source
from sdpid.plots.motion import (
    COLORS,
    nearest_pairs,
    plot_against_limits,
    plot_distances,
    plot_over_duration,
    plot_spectrum,
)

# What falls by less than this share over all durations is no curve to look at.
_FALLS = 0.8

# Samples a second of the pictures.
_RATE_HZ = 200.0


def plan_html(
    plan: Plan,
    *,
    command: str | None = None,
    figures: bool | None = None,
    names: Sequence[str] = (),
) -> str:
    """Return the page of a plan.

    Parameters
    ----------
    plan : Plan
        From `design_excitation`.
    command : str, optional
        The command line that made it.
    figures : bool, optional
        Draw plots; by default where matplotlib is installed.
    names : sequence of str, optional
        Files beside the page.

    Raises
    ------
    MissingExtraError
        When jinja2 is not installed (extra ``report``), or matplotlib is not and figures are
        asked for (extra ``plot``).
    """
    drawable = importlib.util.find_spec("matplotlib") is not None
    if figures:
        require("matplotlib", extra="plot")
    draw = drawable if figures is None else figures
    clearance = plan.joint_limits.clearance or 0.0
    scene = scene_of(plan.robot, played(plan.trajectory, FRAME_RATE), plan.collision, clearance)
    motion = played(plan.trajectory, _RATE_HZ)
    return page(
        "sdpid.output.plans",
        "plan.html.j2",
        plan=plan,
        robot=plan.robot,
        subtitle=_subtitle(plan),
        tiles=list(tiles(plan)),
        sentences=list(sentences(plan)),
        rows=plan.limits.rows,
        distances=_distances(plan, motion) if draw else None,
        joints=list(_joints(plan, motion)) if draw else [],
        spectrum=image_source(plot_spectrum(motion)) if draw else None,
        colors=list(zip(plan.robot.joint_names, cycle(COLORS), strict=False)),
        drawable=drawable,
        **_expected(plan, draw),
        notes=list(dict.fromkeys([*plan.notes, *plan.limits.notes, *plan.expected.notes])),
        left_out=plan.limits.left_out,
        files=names,
        command=command,
        scene=scene,
        scripts=(scene.script,),
    )


def _subtitle(plan: Plan) -> str:
    """Return in a line what kind of motion it is."""
    moving = plan.trajectory
    kinds = {"spline": "a B-spline", "fourier": "a Fourier series", "postures": "postures"}
    joints = f"{moving.n} joint{'' if moving.n == 1 else 's'}"
    kind = kinds.get(plan.motion, "one joint at a time")
    purpose = "all parameters" if plan.purpose == "all" else plan.purpose
    return f"Motion of {joints} for {moving.duration:.4g} s ({kind}), for {purpose}"


def _joints(plan: Plan, motion: Played) -> Iterator[dict[str, Any]]:
    """Yield the picture of each joint against its limits."""
    for name, rows in limited_quantities(plan.robot, plan.joint_limits, motion):
        yield {"name": name, "source": image_source(plot_against_limits(motion.time, rows))}


def _distances(plan: Plan, motion: Played) -> dict[str, Any] | None:
    """Return the picture of the distances, and the pairs in it with what is asked of each."""
    collision = plan.collision
    if collision is None or not collision.pairs:
        return None
    step = max(round(motion.rate_hz / FRAME_RATE), 1)
    asked = collision.clearances(plan.joint_limits.clearance or 0.0)
    room = collision.distances(motion.position[::step]) - asked
    picture = plot_distances(motion.time[::step], room)
    pairs = [
        (color, f"{collision.pairs[k].first} – {collision.pairs[k].second}", float(asked[k]))
        for color, k in nearest_pairs(room)
    ]
    return {"source": image_source(picture), "pairs": pairs}


def _expected(plan: Plan, draw: bool) -> dict[str, Any]:
    """Return what the run will buy: tables and a picture."""
    expected = plan.expected
    curves = list(_curves(expected))[: len(COLORS)]
    seconds = np.array([each.seconds for each in expected.durations])
    shown = draw and len(seconds) > 1 and bool(curves)
    return {
        "expected": expected,
        "open": _open(expected),
        "parameters": list(_parameters(expected)),
        "durations": [
            (each.seconds, each.repetitions, [share[k] for _, share in curves])
            for k, each in enumerate(expected.durations)
        ],
        "curves": list(zip((name for name, _ in curves), COLORS, strict=False)),
        "over_duration": (
            image_source(plot_over_duration(seconds, [share for _, share in curves]))
            if shown
            else None
        ),
    }


def _curves(expected: Expected) -> Iterator[tuple[str, Array]]:
    """Yield what falls with the duration: half widths of 95 % intervals as shares, (D,)."""
    durations = expected.durations
    for k, band in enumerate(expected.bands):
        yield f"efforts on {band.motion}", np.array([each.bands[k] for each in durations])
    masses = expected.theta[: 10 * len(expected.link_names) : 10]
    words = [f"mass of {name}" for name in expected.link_names]
    yield from _falling(words, masses, np.array([each.masses for each in durations]))
    errors = np.array([each.standard_errors for each in durations])
    yield from _falling(expected.names, expected.values, errors)


def _falling(names: Sequence[str], values: Array, errors: Array) -> Iterator[tuple[str, Array]]:
    """Yield those of some numbers that the run tells, and longer runs tell better; worst first.

    Parameters
    ----------
    names : sequence of str
        Of k numbers.
    values : ndarray, shape (k,)
        Of the numbers.
    errors : ndarray, shape (D, k)
        Their standard errors after some durations.
    """
    shares = NORMAL * errors / np.where(values == 0.0, np.nan, np.abs(values))
    told = (shares[0] < 1.0) & (shares[-1] < _FALLS * shares[0])
    for k in np.argsort(-np.nan_to_num(shares[0])):
        if told[k]:
            yield names[k], shares[:, k]


def _open(expected: Expected) -> list[tuple[str, list[str]]]:
    """Return what stays open, by what would help."""
    found: dict[str, list[str]] = {}
    for each in expected.open_directions:
        found.setdefault(each.reason, []).append(", ".join(each.parameters))
    return list(found.items())


def _parameters(expected: Expected) -> Iterator[dict[str, Any]]:
    """Yield the expected interval of every base parameter."""
    for k, name in enumerate(expected.names):
        value, half = float(expected.values[k]), float(expected.half_widths[k])
        before = NORMAL * float(expected.before[k])
        yield {
            "name": name,
            "unit": expected.units[k],
            "value": value,
            "half": half,
            "share": half / abs(value) if value else None,
            "before": before if np.isfinite(before) else None,
            "prior": float(expected.prior_share[k]),
        }
