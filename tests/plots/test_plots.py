"""Plots are drawn from arrays, without global state, and written whole."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")
from matplotlib.figure import Figure

import sdpid
from sdpid import plots
from sdpid.assurance.diagnostics.causes import JointErrors
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.errors import DataError, ExportError
from sdpid.estimation.estimate import Step
from sdpid.plots.figures import BLUE, figure_of
from sdpid.plots.joints import detail
from sdpid.plots.lines import POINTS, decimate, spans, stretch
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm

SIGNALS = ("position", "torque", "velocity", "acceleration")


def filtering(count: int = 400, **options: object) -> Any:
    time = np.linspace(0.0, 4.0, count)
    rng = np.random.default_rng(0)
    after = {name: np.sin(time * (k + 1)) for k, name in enumerate(SIGNALS)}
    before = {name: y + 0.1 * rng.standard_normal(count) for name, y in after.items()}
    return plots.plot_signals(time, before, after, units={"position": "rad"}, **options)  # type: ignore[arg-type]


def reconstruction(count: int = 300, **options: object) -> Any:
    time = np.linspace(0.0, 3.0, count)
    y = np.sin(np.outer(time, [1.0, 2.0]))
    return plots.plot_reconstruction(time, y, y + 0.5, ["a", "b"], **options)  # type: ignore[arg-type]


def convergence(**options: object) -> Any:
    good = [Step(0.0, 90.0, 0.0), Step(0.1, 20.0, 0.0), Step(0.5, 10.001, 0.0)]
    bad = [Step(0.0, 50.0, 1.0), Step(0.2, 8.0, 0.1)]
    return plots.plot_convergence([good, bad, []], 10.0, {"SDP": (0.05, 10.0)}, **options)  # type: ignore[arg-type]


def parameters() -> Any:
    return plots.plot_parameters(
        ["xx1", "Fs1", "Fv1"], ["kg.m2", "N.m", "N.m.s/rad"],
        {"WLS": [1.0, 2.0, 3.0], "SDP": [1.1, 2.0, 2.9]},
        true=[1.0, 2.0, 3.0], errors={"WLS": [0.1, 0.1, 0.1]}, title="base",
    )  # fmt: skip


def panels() -> Any:
    time = np.linspace(0.0, 3.0, 40)
    return plots.plot_against_limits(time, [("a", np.sin(time), -2.0, None), ("b", time, 0.0, 3.0)])


def iterations() -> Any:
    return convergence(against="iterations", failed=1)


def long_reconstruction() -> Any:
    time = np.linspace(0.0, 3.0, 9000)
    y = np.stack([-123456.0 * np.sin(time), 2e-4 * np.cos(time)], axis=1)
    mask = np.abs(y) > 1e-5
    return plots.plot_reconstruction(time, y, 1.1 * y, ["a", "b"], mask=mask, title="heading")


FIGURES = [
    filtering,
    reconstruction,
    long_reconstruction,
    convergence,
    iterations,
    parameters,
    panels,
]


# What writes a format knows nothing of what is drawn: each figure is written in one of them.
@pytest.mark.parametrize(
    ("make", "suffix"), [*zip(FIGURES, cycle((".png", ".svg", ".pdf")), strict=False)]
)
def test_saved_whole_and_the_same_each_time(make: Any, suffix: str, tmp_path: Path) -> None:
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    assert plots.save_figure(make(), first, dpi=50.0) == first
    plots.save_figure(make(), second, dpi=50.0)
    assert first.read_bytes() == second.read_bytes()
    assert first.stat().st_size > 1000
    assert sorted(p.name for p in tmp_path.iterdir()) == [first.name, second.name]


def apart(boxes: Sequence[Any]) -> bool:
    """Whether no box lies upon another one, or beside the figure."""
    beside = any(box.x0 < 0.0 or box.y0 < 0.0 for box in boxes)
    return not beside and not any(a.overlaps(b) for a, b in combinations(boxes, 2))


def drawn(axes: Any) -> tuple[Figure, Callable[[Any], Any]]:
    """Return a figure that was laid out, and what returns the place of a text in it."""
    figure = figure_of(axes)
    figure.draw_without_rendering()
    renderer = figure._get_renderer()
    return figure, lambda text: text.get_window_extent(renderer)


@pytest.mark.parametrize("make", FIGURES)
def test_no_text_runs_into_other_text(make: Any) -> None:
    figure, place = drawn(make())
    texts = [*figure.texts, *figure.legends]
    for axis in figure.axes:
        texts += [axis.title, axis._left_title, axis._right_title]
        for part in (axis.xaxis, axis.yaxis):
            texts.append(part.label)
            # Nor numbers into labels.
            numbers = part.get_ticklabels() if part.label.get_text() else []
            assert not any(place(each).overlaps(place(part.label)) for each in numbers)
    # A legend has no text of its own.
    assert apart([place(each) for each in texts if getattr(each, "get_text", lambda: " ")()])


TIME, ONES = np.arange(9.0), np.ones((9, 2))
ERRORS = JointErrors(
    joint="a", frequency=TIME, effort_density=TIME, error_density=TIME, lag=TIME,
    autocorrelation=TIME, independent=9.0, velocity=TIME, mean=TIME, low=TIME, high=TIME,
    share=0.0, with_sign=0.0, with_velocity=0.0,
)  # fmt: skip
INTO: dict[str, tuple[int, Any]] = {
    "convergence": (1, lambda a: convergence(axes=a[0], title="one")),
    "parameters": (
        2,
        lambda a: plots.plot_parameters(
            ["a", "b"], ["kg", "m"], {"x": [1.0, 2.0]}, axes=a, title="two"
        ),
    ),
    "efforts": (
        4,
        lambda a: plots.plot_reconstruction(TIME, ONES, ONES, ["a", "b"], axes=a, title="4"),
    ),
    "signals": (
        2,
        lambda a: plots.plot_signals(TIME, {"a": TIME}, {"a": TIME}, axes=a, title="two"),
    ),
    "joint": (2, lambda a: plots.plot_joint(TIME, TIME, TIME, TIME > 0.0, axes=list(a))),
    "errors": (3, lambda a: plots.plot_joint_errors(ERRORS, axes=a)),
    "limits": (1, lambda a: plots.plot_against_limits(TIME, [("a", TIME, None, 2.0)], axes=a[0])),
    "motion": (
        4,
        lambda a: plots.plot_motion(
            TIME, {"a": [("x", TIME, None, 2.0)] * 4}, axes=a, title="four"
        ),
    ),
}


@pytest.mark.parametrize("kind", INTO)
def test_figures_are_drawn_into_given_axes(kind: str) -> None:
    count, draw = INTO[kind]
    figure = Figure(figsize=(9.0, 9.0), layout="constrained")
    axes = figure.subplots(2, 2).ravel()[:count]
    drawn = np.atleast_1d(draw(axes)).ravel()
    assert list(drawn) == list(axes)
    assert all(axis.lines or axis.containers for axis in drawn)
    figure.draw_without_rendering()


def test_too_few_axes_are_refused() -> None:
    axes = Figure(figsize=(9.0, 9.0), layout="constrained").subplots(2, 2).ravel()
    refuses(DataError, "3 axes were given to draw in, 4 are needed", reconstruction, axes=axes[:3])
    given = ["a", "b"], ["kg", "m"], {"x": [1.0, 2.0]}
    words = "1 axes were given to draw in, 2 are needed"
    refuses(DataError, words, plots.plot_parameters, *given, axes=axes[0])


def test_axes_are_returned_and_lead_to_their_figure(tmp_path: Path) -> None:
    one, many = convergence(), reconstruction()
    assert one.figure is figure_of(one)
    assert many.shape == (2, 2)
    assert figure_of(many) is many[1, 1].figure
    whole = Figure(figsize=(4.0, 3.0))
    part = whole.subfigures(1, 2)[1].subplots()
    assert figure_of([[part]]) is whole
    assert figure_of(whole) is whole
    paths = [plots.save_figure(x, tmp_path / f"{k}.svg") for k, x in enumerate((many, many[0, 0]))]
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_unknown_format_and_missing_folder(tmp_path: Path) -> None:
    figure = convergence()
    refuses(ExportError, r"'\.bmp'", plots.save_figure, figure, tmp_path / "a.bmp")
    refuses(ExportError, "cannot write", plots.save_figure, figure, tmp_path / "no" / "a.png")
    assert list(tmp_path.iterdir()) == []
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or pyplot.get_fignums() == []


def test_decimation_keeps_the_extremes_and_the_ends() -> None:
    rng = np.random.default_rng(3)
    x = np.arange(380_003.0)
    y = rng.standard_normal(len(x))
    y[123_456], y[380_001] = 50.0, -50.0
    u, w = decimate(x, y)
    assert len(u) <= POINTS + 4
    assert np.all(np.diff(u) > 0.0)
    assert (u[0], u[-1]) == (x[0], x[-1])
    assert {50.0, -50.0} <= set(w)
    assert np.array_equal(y[u.astype(int)], w)
    assert decimate(x[:9], y[:9])[1] is not None
    assert len(decimate(x[:POINTS], y[:POINTS])[0]) == POINTS


def test_long_records_are_drawn_with_few_points() -> None:
    figure = figure_of(filtering(200_000, window=(1.0, 2.0)))
    lines = [line for axis in figure.axes for line in axis.get_lines()]
    assert max(len(line.get_xdata()) for line in lines) <= POINTS + 4
    assert figure.axes[0].get_xlim() == pytest.approx((1.0, 2.0), abs=1e-4)
    # It is said in the figure.
    said = [t.get_text() for t in figure_of(reconstruction(15_000)).texts]
    assert said == [f"drawn: least and greatest value of each {stretch(15_000)} samples"]
    assert not figure_of(reconstruction(POINTS)).texts
    assert stretch(15_000) == 20


def test_a_recording_and_a_fit_are_drawn() -> None:
    time = 0.01 * np.arange(4000)
    q = np.sin(np.outer(time, [1.0, 2.0]))
    noisy = q + 0.1 * np.random.default_rng(0).standard_normal(q.shape)
    log = sdpid.Recording(time=time, position=q, effort=noisy, joint_names=("a", "b"))
    stages, window = sdpid.Processing.paper().stages, (15.0, 25.0)
    figure = figure_of(stages(log, 1, window=window).plot())
    labels = [axis.get_ylabel() for axis in figure.axes[::2]]
    units = ("Position [rad]", "Torque [N·m]", "Velocity [rad/s]", "Acceleration [rad/s²]")
    assert labels == list(units)
    assert figure.axes[0].get_xlim() == pytest.approx(window, abs=0.02)
    refuses(DataError, "joint 2 does not exist", stages, log, 2, window=window)
    samples = sdpid.Samples(
        position=q, velocity=q, acceleration=q, effort=q, time=time, starts=(0, 1000, 3000)
    )
    fit = Validation.of_prediction(small_arm(2), samples, q + 0.5)
    axis = fit.plot(count=2000, title="two pieces")[0, 0]
    drawn = axis.get_lines()[0].get_ydata()
    assert np.isnan(drawn).sum() == 1
    assert np.nanmax(np.abs(drawn)) <= 1.0


def test_reconstruction_names_errors_and_shades() -> None:
    mask = np.ones((300, 2), dtype=bool)
    mask[50:80, 1] = False
    figure = figure_of(reconstruction(mask=mask))
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert titles[0] == "a"
    assert titles[1].startswith("RMSE 0.500 N·m")
    assert [len(axis.collections) for axis in figure.axes] == [0, 0, 1, 1]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["measured", "predicted", "rows not used"]


def test_names_are_not_read_as_formulas(tmp_path: Path) -> None:
    """A joint may be called anything; broken formulas end matplotlib's parser."""
    bad = "$\\undefined{$"
    y = np.ones((5, 2))
    time = np.arange(5.0)
    figures = [
        plots.plot_reconstruction(time, y, y, [bad, "$x^2$"], units=bad, title=bad),
        plots.plot_signals(time, {bad: time}, {bad: time}, units={bad: bad}, title=bad),
        plots.plot_parameters([bad], [bad], {bad: [1.0]}, title=bad),
        convergence(label=bad, title=bad),
        # No font of matplotlib has these.
        plots.plot_signals(time, {"关节一": time}, {"关节一": time}, title="关节一"),
    ]
    for k, figure in enumerate(figures):
        for suffix in (".png", ".svg"):
            plots.save_figure(figure, tmp_path / f"{k}{suffix}", dpi=40.0)


def test_reconstruction_without_time_and_with_units() -> None:
    y = np.ones((5, 2))
    axes = plots.plot_reconstruction(None, y, 0.0 * y, ["a", "b"], [1.0, 2.0], units=["N", "N·m"])
    assert axes[-1, 0].get_xlabel() == "sample"
    assert axes[0, 0].get_ylabel() == "effort [N]"


def test_convergence_counts_ends_and_failures() -> None:
    shown = " | ".join(labels(convergence(label="local")))
    for words in ("end of a start (1)", "end, infeasible (1)", "SDP (gap 0.0e+00"):
        assert words in shown
    axis = convergence(against="iterations", failed=3)
    assert axis.get_xlabel() == "iteration"
    assert axis.get_xscale() == "linear"
    assert max(line.get_xdata()[-1] for line in axis.get_lines() if len(line.get_xdata()) > 2) == 2
    shown = labels(axis)
    assert "failed, nothing to draw (3)" in shown
    assert any(label.startswith("proven lower bound") for label in shown)
    refuses(DataError, "against is 'hours'", convergence, against="hours")
    # Steps far outside leave the picture; of exact data it shows differences.
    wild = [Step(0.0, 90.0, 0.0), Step(0.1, 1e15, 7.0), Step(0.5, 10.1, 0.0)]
    assert plots.plot_convergence([wild], 10.0).get_ylim()[1] < 100.0
    axis = plots.plot_convergence([[Step(0.0, 1.0, 0.0), Step(1.0, 1e-20, 0.0)]], 0.0)
    assert axis.get_ylabel() == "cost − bound"


def test_bad_input_is_named() -> None:
    time, y, names = np.arange(5.0), np.ones((5, 2)), ["a", "b"]
    one = {"position": time}
    for words, call, *given in (
        ("the same names", plots.plot_signals, time, one, {"torque": time}),
        ("position has 3 rows", plots.plot_signals, time, one, {"position": time[:3]}),
        ("predicted has 4 rows", plots.plot_reconstruction, time, y, y[:4], names),
        ("joint_names has 1", plots.plot_reconstruction, time, y, y, ["a"]),
        ("rmse has 1", plots.plot_reconstruction, time, y, y, names, [1.0]),
        ("nothing to draw", plots.plot_convergence, [], 1.0),
        ("nothing to draw", plots.plot_parameters, [], [], {}),
        ("2 joints with", plots.plot_motion, time, {"a": [("x", time, None, None)], "b": []}),
        (r"SDP has shape \(2,\)", plots.plot_parameters, ["a"], ["kg"], {"SDP": [1.0, 2.0]}),
    ):
        refuses(DataError, words, call, *given)
    refuses(DataError, "window 9 to 10 s", plots.plot_signals, time, one, one, window=(9.0, 10.0))
    mask = np.ones((5, 1), dtype=bool)
    refuses(DataError, "must agree", plots.plot_reconstruction, time, y, y, names, mask=mask)


def test_a_png_is_drawn_once(tmp_path: Path) -> None:
    figure = figure_of(reconstruction())
    own, drawn = figure.draw, []
    figure.draw = lambda renderer: (drawn.append(1), own(renderer))
    plots.save_figure(figure, tmp_path / "a.png")
    assert len(drawn) == 1
    assert figure.dpi == 100.0


def test_spans_are_cut_half_way_between_samples() -> None:
    x = np.arange(6.0)
    low, high = spans(x, [True, False, False, True, True, False])
    assert low.tolist() == [0.0, 2.5]
    assert high.tolist() == [0.5, 4.5]
    assert spans(x, np.zeros(6, dtype=bool))[0].shape == (0,)


@pytest.mark.parametrize("pieces", [1, 3])
def test_panels_do_not_run_into_each_other(pieces: int) -> None:
    """The longest numbers and labels that there are."""
    y = -123456.0 * np.sin(np.arange(4000.0))
    time = 1e-3 * np.arange(4000.0)
    starts = tuple(range(0, 4000, 4000 // pieces))[:pieces]
    figure, place = drawn(plots.plot_joint(time, y, 1.1 * y, np.abs(y) > 1e3, starts=starts))
    texts = []
    for axis in figure.axes:
        texts += [axis.xaxis.label, axis.yaxis.label, axis.yaxis.offsetText]
        texts += [axis.legend_] if axis.legend_ else []
        for part in (axis.xaxis, axis.yaxis):
            # Those in view.
            ticks = part._update_ticks()
            texts += [tick.label1 for tick in ticks if tick.label1.get_visible()]
    boxes = [place(t) for t in texts if not hasattr(t, "get_text") or t.get_text()]
    wide, high = 100.0 * figure.get_size_inches()
    assert apart(boxes)
    assert all(box.x1 <= wide and box.y1 <= high for box in boxes)


def test_gaps_break_a_line() -> None:
    y = np.zeros(9)
    line, _ = plots.plot_joint(None, y, y, y == 0.0, starts=(0, 4))[0].get_lines()
    assert line.get_color() == BLUE
    assert np.flatnonzero(np.isnan(line.get_ydata())).tolist() == [4]


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("bins", [0, 5])
def test_errors_without_anything_in_them_are_drawn(timed: bool, bins: int) -> None:
    none = {name: np.zeros(bins) for name in ("velocity", "mean", "low", "high")}
    none["velocity"] = np.arange(float(bins))
    for length in (1, 2, 50):
        flat = {"error_density": np.zeros(length), "effort_density": np.zeros(length)}
        lags = {"lag": np.zeros(1), "autocorrelation": np.ones(1), "independent": 1.0}
        errors = replace(ERRORS, frequency=np.arange(float(length)), **flat, **lags, **none)
        figure_of(plots.plot_joint_errors(errors, timed=timed)).draw_without_rendering()


def test_the_stretch_about_the_largest_error_is_shown() -> None:
    error = np.zeros(4000)
    error[2000] = -1.0
    assert detail(error) == slice(1800, 2200)
    error[3999] = 2.0
    assert detail(error) == slice(3600, 4000)
    error[:] = np.nan
    assert detail(error) == slice(0, 400)
    y = np.zeros(4000)
    assert len(plots.plot_joint(None, y, y, np.zeros(4000, dtype=bool))) == 3
    few = np.zeros(800)
    assert len(plots.plot_joint(None, few, few, few == 0.0)) == 2


@dataclass
class Curve:
    velocity: np.ndarray
    effort: np.ndarray
    unit: str = "N·m"
    lower: np.ndarray | None = None
    upper: np.ndarray | None = None
    level: float | None = None


def curve(**fields: object) -> Curve:
    v = np.linspace(-2.0, 2.0, 41)
    effort = np.tanh(5.0 * v)
    return Curve(v, effort, lower=effort - 0.2, upper=effort + 0.3, level=0.9, **fields)


def labels(axis: object) -> list[str]:
    return [text.get_text() for text in axis.get_legend().get_texts()]


def test_a_friction_curve_shows_its_band_and_what_was_driven() -> None:
    cloud = np.array([-1.0, 0.5, 0.5]), np.array([-1.1, 0.9, 30.0])
    axis = plots.plot_friction_curve(curve(), cloud=cloud, driven=(-1.0, 0.5))
    assert labels(axis) == ["measured", "90 % band", "friction"]
    assert axis.get_xlim() == (-2.0, 2.0)
    assert axis.get_ylim()[1] < 33.0
    shaded = [(span.get_x(), span.get_x() + span.get_width()) for span in axis.patches]
    assert shaded == [(-2.0, -1.0), (0.5, 2.0)]
    bare = plots.plot_friction_curve(Curve(np.array([1.0, 2.0]), np.ones(2), unit="N"))
    assert labels(bare) == ["friction"]
    assert bare.get_xlabel() == "velocity [m/s]"


def test_a_forest_has_a_scale_for_each_row() -> None:
    names = ("m1", "xx2", "Fv3")
    values = {
        "description": [1.0, np.nan, np.nan],
        "least squares": [1.5, -90.0, 0.1],
        "this estimate": [2.0, 1e-3, 0.0],
    }
    lower, upper = [1.9, -1e-3, 0.0], [2.1, 3e-3, np.inf]
    axis = plots.plot_forest(names, values, lower=lower, upper=upper)
    assert [tick.get_text() for tick in axis.get_yticklabels()] == list(names)
    told = [text.get_text() for text in axis.texts]
    assert told == ["2.00 ± 0.10", "0.0010 ± 0.0020", "0"]
    # A limit cuts an interval off: its ends are written.
    cut = plots.plot_forest(("Fs1",), {"this estimate": [0.0]}, lower=[0.0], upper=[0.048])
    assert [text.get_text() for text in cut.texts] == ["0.000 … 0.048"]
    lines = {line.get_label(): line for line in axis.lines}
    assert lines["this estimate"].get_xdata() == pytest.approx([2.0 / 2.1, 1.0 / 3.0, 0.0])
    # What is far out is an arrow at the edge.
    (arrow,) = [
        line for line in axis.lines if line.get_marker() == "<" and any(line.get_xdata() < 0)
    ]
    assert arrow.get_ydata()[arrow.get_xdata() < -1.0].tolist() == [1.0]
    own = Figure().subplots()
    assert plots.plot_forest(names[:1], {"this estimate": [1.0]}, axes=own) is own
    refuses(DataError, "there are 3 names", plots.plot_forest, names, {"this estimate": [1.0]})
    refuses(DataError, "at least one", plots.plot_forest, (), {"this estimate": []})


@pytest.mark.parametrize("factor", [1.0, 1e4])
def test_eigenvalues_of_any_size_are_seen_beside_each_other(factor: float) -> None:
    t = np.linspace(0.0, 5.0, 50)
    own = 0.003 + 0.001 * np.sin(t)
    axis = plots.plot_mass_matrix(
        t, {"least squares": -factor * own, "this estimate": own}, bound=0.0015, starts=(0, 20)
    )
    assert labels(axis) == ["least squares", "this estimate"]
    low, high = axis.get_ylim()
    place = axis.transData.transform([[0.0, x] for x in (low, 0.0, 0.003, high)])[:, 1]
    assert (place[2] - place[1]) > 0.1 * (place[3] - place[0])
    refuses(DataError, "nothing to draw", plots.plot_mass_matrix, t, {})
    refuses(DataError, "50", plots.plot_mass_matrix, t, {"a": own[1:]})
