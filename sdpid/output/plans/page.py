"""The page of a plan: what it is for, what it will show, its limits, and the arm that moves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any, TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.expected.expected import NORMAL, Expected
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.geometry.obstacles import Mesh, Plane
from sdpid.excitation.geometry.solids import Solid
from sdpid.excitation.limits.check import LimitCheck, LimitRow
from sdpid.excitation.plan.plan import Plan, limited_quantities
from sdpid.experiment.trajectory.trajectory import Played, played
from sdpid.output.charts.page import Charts, number
from sdpid.output.scene.scene import (
    FRAME_RATE,
    Group,
    Line,
    Scene,
    ShownMotion,
    Surface,
    described_surfaces,
    grid,
    robot_scene,
    surface_of,
)
from sdpid.robot.model.model import RobotModel

# Half width of what is drawn of a plane, in reaches of the arm.
_WIDE = 1.5

# Digits of a distance after the point, m.
_DIGITS = 4

# Colors of links in turn: the base is gray.
_COLORS = ("#8d99a6", "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")

_GROUPS = (
    Group("obstacles", "", "#b8a888"),
    Group("links", "", _COLORS[0]),
    Group("planes", "", "#a08c6e", 0.2),
)


def scene_of(
    robot: RobotModel, motion: Played, collision: CollisionModel | None, clearance: float
) -> Scene:
    """Return the arm that moves through a plan.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    motion : Played
        At about the rate at which it is shown.
    collision : CollisionModel or None
        The shapes that were checked; without them those of the description are drawn.
    clearance : float
        Least distance that is asked, m.
    """
    shown, lines, distances = ShownMotion(motion.rate_hz, motion.position), [], None
    if collision is None:
        surfaces, notes = described_surfaces(robot)
        notes = (*notes, "Shapes are those of the description: no collisions were checked.")
    else:
        half, surfaces = _WIDE * max(robot.reach, 0.1), []
        names = {each.name for each in collision.obstacles}
        planes = [each.shape for each in collision.solids if isinstance(each.shape, Plane)]
        for each in collision.solids:
            if not isinstance(each.shape, Plane):
                surfaces.append(_surface(each, "obstacles" if each.body in names else "links"))
        surfaces += [_sheet(plane, half) for plane in planes]
        lines = [grid(*_sides(plane, half)) for plane in planes]
        notes = ("Shapes are those that were checked for collisions.",)
        distances = _nearest(collision, motion, clearance)
    return robot_scene(
        robot,
        shown,
        _GROUPS,
        [_colored(each) for each in surfaces],
        label=f"The arm of {robot.name} along the motion, and what is around it",
        lines=[*lines, *_traces(robot, shown)],
        distances=distances,
        notes=notes,
    )


def _surface(solid: Solid, group: str) -> Surface:
    """Return what is drawn of a solid that is no plane."""
    link = solid.joint - 1
    assert not isinstance(solid.shape, Plane)
    if isinstance(solid.shape, Mesh):
        points = solid.shape.triangles().reshape(-1, 3)
        return Surface(link, points, np.arange(len(points)).reshape(-1, 3), group)
    return replace(surface_of(solid.shape, link), group=group)


def _colored(surface: Surface) -> Surface:
    """Return a link's surface in the link's color."""
    own = _COLORS[(surface.link + 1) % len(_COLORS)]
    return replace(surface, color=own) if surface.group == "links" else surface


def _traces(robot: RobotModel, motion: ShownMotion) -> Iterator[Line]:
    """Yield where the links without followers go."""
    followed = {int(parent) - 1 for parent in list(robot.pin_model.parents)[1:]}
    origins = motion.placements(robot)[:, :, :3, 3]
    for link in sorted(set(range(robot.n_links)) - followed):
        yield Line(origins[:, link])


def _nearest(collision: CollisionModel, motion: Played, clearance: float) -> dict[str, Any] | None:
    """Return which pair has the least room at each time, and its distance, but for close ones."""
    if not collision.pairs:
        return None
    distances = collision.distances(motion.position)
    asked = collision.clearances(clearance)
    # Pairs that are always close are asked for less, and would be the nearest most of the time.
    usual = asked >= clearance if np.any(asked >= clearance) else np.ones_like(asked, dtype=bool)
    nearest = np.where(usual, distances - asked, np.inf).argmin(axis=1)
    values = distances[np.arange(len(nearest)), nearest].round(_DIGITS)
    names = [f"{pair.first} – {pair.second}" for pair in collision.pairs]
    used, index = np.unique(nearest, return_inverse=True)
    frames = list(zip(index.tolist(), values.tolist(), strict=True))
    return {"pairs": [names[k] for k in used], "frames": frames}


def _sides(plane: Plane, half: float) -> tuple[Array, Array]:
    """Return the middle of a square part of a plane, and its half sides as rows (2, 3)."""
    n = np.asarray(plane.normal) / np.linalg.norm(plane.normal)
    across = np.cross(n, np.eye(3)[np.abs(n).argmin()])
    across /= np.linalg.norm(across)
    return n * float(np.asarray(plane.point) @ n), half * np.stack([across, np.cross(n, across)])


def _sheet(plane: Plane, half: float) -> Surface:
    """Return a square part of a plane, below or beside the robot's base."""
    middle, sides = _sides(plane, half)
    corners = middle + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ sides
    return Surface(-1, corners, np.array([[0, 1, 2], [0, 2, 3]]), "planes")


def tiles(plan: Plan) -> Iterator[tuple[str, str, str]]:
    """Yield the numbers at the head of the page: what it is, the number, and its level."""
    yield "to run", f"{plan.trajectory.duration:.4g} s", ""
    held, level = ("held", "good") if plan.limits.ok else ("not held", "bad")
    yield "every limit, at every instant", held, level
    yield "condition number", number(plan.condition_number), ""
    yield "log det of the information", number(plan.log_det), ""
    yield "base parameters", str(len(plan.names)), ""


def sentences(plan: Plan) -> Iterator[tuple[str, str, str]]:
    """Yield the plan in short: a level, a title and a sentence each."""
    yield "good", "Run", run_sentence(plan)
    yield "good" if plan.limits.ok else "bad", "Safe", safe_sentence(plan.limits)
    told = plan.expected.sentences()
    # One band of efforts stands for all; then parameters, friction, and what stays open.
    for text in (*told[:1], *told[len(plan.expected.bands) :]):
        yield "good", "What it will buy", text
    if assumed := len(plan.limits.notes):
        yield (
            "caution",
            "Careful",
            f"{assumed} thing{' was' if assumed == 1 else 's were'} assumed about limits, torques "
            "and shapes: read them before the run.",
        )


def run_sentence(plan: Plan) -> str:
    """Return what to run, and for how long."""
    motion = plan.trajectory
    lasts = f"{motion.duration:.4g} s at {motion.rate_hz:g} samples a second"
    if motion.periods > 1:
        lasts += f", {motion.periods} times the same {motion.period:.4g} s"
    repeat = (
        "it ends where it starts, at rest, so that it can be repeated and averaged"
        if motion.closed
        else "it ends at rest in another position than it starts from"
    )
    return f"trajectory.csv, {lasts}, from rest; {repeat}. Log positions and efforts meanwhile."


def safe_sentence(check: LimitCheck) -> str:
    """Return whether the limits hold, with the least slack of each kind."""
    if not check.ok:
        return f"Not every limit is proven to hold: {' '.join(check.sentences()[:_FEW])}"
    # Distances are checked last, and told first.
    least = "; ".join(map(_slack, check.nearest[::-1]))
    return f"Every limit holds at every instant: {least}.{_closer(check)}"


def _slack(row: LimitRow) -> str:
    """Return who comes nearest to a limit, and what is left to it."""
    if row.kind != "distance":
        limit = "the end of its range" if row.kind == "position" else f"its {row.kind} limit"
        return f"{row.subject} stays {row.slack:.3g} {row.unit} from {limit}"
    first, _, second = row.subject.partition(" – ")
    the = "the " * second.startswith(("table", "wall"))
    return (
        f"{1e3 * row.worst:.3g} mm kept everywhere, nearest {first} to {the}{second}, "
        f"{1e3 * row.limit:.3g} mm asked for"
    )


def _closer(check: LimitCheck) -> str:
    """Return how many pairs were asked for less than the clearance, as words to add."""
    asked = [row.limit for row in check.rows if row.kind == "distance"]
    less = sum(limit < max(asked) for limit in asked)
    if not less:
        return ""
    pairs = "1 pair is" if less == 1 else f"{less} pairs are"
    return f" {pairs} built too close for {1e3 * max(asked):.3g} mm and asked for less."


# Limits that are not held, of which a sentence tells.
_FEW = 4


# What falls by less than this share over all durations is no curve to look at.
_FALLS = 0.8

# Samples a second of the charts.
_RATE_HZ = 50.0

# A limit beyond so many times the motion is not drawn: the motion would be a flat line.
_FAR = 4.0

# Amplitudes below this share of the highest are not shown.
_FLOOR = 1e-3

# Of lines in a chart, by their names in charts.css; red is left to limits.
BLUE, RED, DASHED = "blue", "red", "dashed"
COLORS = (BLUE, "green", "orange", "purple", "sky", "gray", "ink")

# What a template draws: columns with their colors.
Lines: TypeAlias = list[tuple[str, str]]


def plan_html(plan: Plan, *, command: str | None = None, names: Sequence[str] = ()) -> str:
    """Return the page of a plan.

    Parameters
    ----------
    plan : Plan
        From `design_excitation`.
    command : str, optional
        The command line that made it.
    names : sequence of str, optional
        Files beside the page.

    Raises
    ------
    MissingExtraError
        When jinja2 is not installed (extra ``report``).
    """
    clearance, charts = plan.joint_limits.clearance or 0.0, Charts()
    scene = scene_of(plan.robot, played(plan.trajectory, FRAME_RATE), plan.collision, clearance)
    motion = played(plan.trajectory, _RATE_HZ)
    return charts.page(
        "sdpid.output.plans",
        "plan.html.j2",
        plan=plan,
        robot=plan.robot,
        subtitle=_subtitle(plan),
        tiles=list(tiles(plan)),
        sentences=list(sentences(plan)),
        rows=plan.limits.rows,
        distances=_distances(plan, motion, charts),
        joints=list(_joints(plan, motion, charts)),
        spectrum=_spectrum(plan, motion, charts),
        **_expected(plan, charts),
        notes=list(dict.fromkeys([*plan.notes, *plan.limits.notes, *plan.expected.notes])),
        left_out=plan.limits.left_out,
        files=names,
        command=command,
        scene=scene,
    )


def _subtitle(plan: Plan) -> str:
    """Return in a line what kind of motion it is."""
    moving = plan.trajectory
    kinds = {"spline": "a B-spline", "fourier": "a Fourier series", "postures": "postures"}
    joints = f"{moving.n} joint{'' if moving.n == 1 else 's'}"
    kind = kinds.get(plan.motion, "one joint at a time")
    purpose = "all parameters" if plan.purpose == "all" else plan.purpose
    return f"Motion of {joints} for {moving.duration:.4g} s ({kind}), for {purpose}"


def _joints(plan: Plan, motion: Played, charts: Charts) -> Iterator[dict[str, Any]]:
    """Yield the charts of each joint: its quantities and, where they are near, their limits."""
    ends = ("lower limit", "upper limit")
    for name, rows in limited_quantities(plan.robot, plan.joint_limits, motion):
        shown = []
        for label, values, *limits in rows:
            far = _FAR * (float(np.abs(values).max()) or 1.0)
            columns = {"motion": values} | {
                what: np.full(len(values), limit)
                for what, limit in zip(ends, limits, strict=True)
                if limit is not None and abs(limit) <= far
            }
            lines = [(each, RED, DASHED) if each in ends else (each, BLUE) for each in columns]
            shown.append((charts.add(x=motion.time, **columns), label, lines))
        yield {"name": name, "charts": shown}


def _distances(plan: Plan, motion: Played, charts: Charts) -> tuple[int, Lines] | None:
    """Return the chart of the room that the nearest pairs leave, mm."""
    collision = plan.collision
    if collision is None or not collision.pairs:
        return None
    step = max(round(motion.rate_hz / FRAME_RATE), 1)
    asked = collision.clearances(plan.joint_limits.clearance or 0.0)
    room = 1e3 * (collision.distances(motion.position[::step]) - asked)
    nearest = np.argsort(room.min(axis=0))[: len(COLORS)]
    names = [
        f"{pair.first} – {pair.second} ({1e3 * least:.2g} mm asked)"
        for pair, least in ((collision.pairs[k], asked[k]) for k in nearest)
    ]
    return _together(charts, motion.time[::step], names, room[:, nearest].T)


def _spectrum(plan: Plan, motion: Played, charts: Charts) -> tuple[int, Lines]:
    """Return the chart of the amplitudes of accelerations over frequency."""
    count = len(motion.time)
    frequency = np.fft.rfftfreq(count, 1.0 / motion.rate_hz)[1:]
    amplitude = 2.0 / count * np.abs(np.fft.rfft(motion.acceleration, axis=0))[1:]
    least = _FLOOR * (float(amplitude.max()) or 1.0)
    powers = np.log10(np.maximum(amplitude, least))
    names = [f"of {name}" for name in plan.robot.joint_names]
    return _together(charts, np.log10(frequency), names, powers.T)


def _expected(plan: Plan, charts: Charts) -> dict[str, Any]:
    """Return what the run will buy: tables and a chart."""
    expected = plan.expected
    curves = dict(list(_curves(expected))[: len(COLORS)])
    seconds = np.array([each.seconds for each in expected.durations])
    chart = None
    if len(seconds) > 1 and curves:
        shares = [2.0 + np.log10(share) for share in curves.values()]
        chart = _together(charts, np.log10(seconds), list(curves), shares)
    still: dict[str, list[str]] = {}
    for each in expected.open_directions:
        still.setdefault(each.reason, []).append(", ".join(each.parameters))
    return {
        "expected": expected,
        "open": list(still.items()),
        "parameters": list(_parameters(expected)),
        "durations": [
            (each.seconds, each.repetitions, [share[k] for share in curves.values()])
            for k, each in enumerate(expected.durations)
        ],
        "curves": list(curves),
        "over_duration": chart,
    }


def _together(
    charts: Charts, x: Array, names: Sequence[str], columns: Iterable[Array]
) -> tuple[int, Lines]:
    """Return a chart of columns under their names, and its lines."""
    lines = list(zip(names, cycle(COLORS), strict=False))
    return charts.add(x=x, **dict(zip(names, columns, strict=True))), lines


def _curves(expected: Expected) -> Iterator[tuple[str, Array]]:
    """Yield what falls with the duration: half widths of 95 % intervals as shares, (D,)."""
    durations = expected.durations
    for k, band in enumerate(expected.bands):
        yield f"efforts on {band.motion}", np.array([each.bands[k] for each in durations])
    masses = expected.theta[: 10 * len(expected.robot.link_names) : 10]
    words = [f"mass of {name}" for name in expected.robot.link_names]
    yield from _falling(words, masses, np.array([each.masses for each in durations]))
    errors = np.array([each.standard_errors for each in durations])
    yield from _falling(expected.base.names, expected.values, errors)


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


def _parameters(expected: Expected) -> Iterator[dict[str, Any]]:
    """Yield the expected interval of every base parameter."""
    for k, name in enumerate(expected.base.names):
        value, half = float(expected.values[k]), float(expected.half_widths[k])
        before = NORMAL * float(expected.before[k])
        yield {
            "name": name,
            "unit": expected.base.units[k],
            "value": value,
            "half": half,
            "share": half / abs(value) if value else None,
            "before": before if np.isfinite(before) else None,
            "prior": float(expected.prior_share[k]),
        }
