"""Plots are drawn from arrays, without global state, and written whole."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("matplotlib")

from sdpid.errors import DataError, ExportError
from sdpid.estimation.estimate import Step
from sdpid.output.figures import POINTS, decimate, runs, spans, stretch
from sdpid.output.joint_plots import detail, plot_joint
from sdpid.output.plots import (
    plot_convergence,
    plot_filtering,
    plot_parameters,
    plot_reconstruction,
    save_figure,
)
from sdpid.output.vector import COLUMNS, Axis, Panel, picture

SIGNALS = ("position", "torque", "velocity", "acceleration")


def filtering(count: int = 400, **options: object) -> object:
    time = np.linspace(0.0, 4.0, count)
    rng = np.random.default_rng(0)
    after = {name: np.sin(time * (k + 1)) for k, name in enumerate(SIGNALS)}
    before = {name: y + 0.1 * rng.standard_normal(count) for name, y in after.items()}
    return plot_filtering(time, before, after, units={"position": "rad"}, **options)  # type: ignore[arg-type]


def reconstruction(count: int = 300, **options: object) -> object:
    time = np.linspace(0.0, 3.0, count)
    y = np.sin(np.outer(time, [1.0, 2.0]))
    return plot_reconstruction(time, y, y + 0.5, ["a", "b"], **options)  # type: ignore[arg-type]


def convergence(**options: object) -> object:
    good = [Step(0.0, 90.0, 0.0), Step(0.1, 20.0, 0.0), Step(0.5, 10.001, 0.0)]
    bad = [Step(0.0, 50.0, 1.0), Step(0.2, 8.0, 0.1)]
    return plot_convergence([good, bad, []], 10.0, {"SDP": (0.05, 10.0)}, **options)  # type: ignore[arg-type]


def parameters() -> object:
    return plot_parameters(
        ["xx1", "Fs1", "Fv1"], ["kg.m2", "N.m", "N.m.s/rad"],
        {"WLS": [1.0, 2.0, 3.0], "SDP": [1.1, 2.0, 2.9]},
        true=[1.0, 2.0, 3.0], errors={"WLS": [0.1, 0.1, 0.1]}, title="base",
    )  # fmt: skip


def iterations() -> object:
    return convergence(against="iterations", failed=1)


def long_reconstruction() -> object:
    time = np.linspace(0.0, 3.0, 9000)
    y = np.stack([-123456.0 * np.sin(time), 2e-4 * np.cos(time)], axis=1)
    mask = np.abs(y) > 1e-5
    return plot_reconstruction(time, y, 1.1 * y, ["a", "b"], mask=mask, title="heading")


FIGURES = [
    filtering,
    reconstruction,
    long_reconstruction,
    convergence,
    iterations,
    parameters,
]


@pytest.mark.parametrize("make", FIGURES)
@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_saved_whole_and_the_same_each_time(make: object, suffix: str, tmp_path: Path) -> None:
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    assert save_figure(make(), first, dpi=50.0) == first  # type: ignore[operator]
    save_figure(make(), second, dpi=50.0)  # type: ignore[operator]
    assert first.read_bytes() == second.read_bytes()
    assert first.stat().st_size > 1000
    assert sorted(p.name for p in tmp_path.iterdir()) == [first.name, second.name]


@pytest.mark.parametrize("make", FIGURES)
def test_no_text_runs_into_other_text(make: object) -> None:
    figure = make()  # type: ignore[operator]
    figure.draw_without_rendering()
    renderer = figure._get_renderer()
    boxes = []
    for axis in figure.axes:
        texts = [axis.title, axis._left_title, axis._right_title, axis.xaxis.label]
        texts.append(axis.yaxis.label)
        boxes += [t.get_window_extent(renderer) for t in texts if t.get_text()]
    boxes += [legend.get_window_extent(renderer) for legend in figure.legends]
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:i])
        assert box.x0 >= 0.0
        assert box.y0 >= 0.0


def test_pyplot_is_not_touched() -> None:
    filtering()
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or pyplot.get_fignums() == []


def test_unknown_format_and_missing_folder(tmp_path: Path) -> None:
    figure = convergence()
    with pytest.raises(ExportError, match=r"'\.bmp'"):
        save_figure(figure, tmp_path / "a.bmp")
    with pytest.raises(ExportError, match="cannot write"):
        save_figure(figure, tmp_path / "no" / "a.png")
    assert list(tmp_path.iterdir()) == []


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
    figure = filtering(200_000, window=(1.0, 2.0))
    lines = [line for axis in figure.axes for line in axis.get_lines()]  # type: ignore[attr-defined]
    assert max(len(line.get_xdata()) for line in lines) <= POINTS + 4
    assert figure.axes[0].get_xlim() == pytest.approx((1.0, 2.0), abs=1e-4)  # type: ignore[attr-defined]


def test_runs() -> None:
    assert runs([True, True, False, True]) == [(0, 2), (3, 4)]
    assert runs([False]) == []


def test_reconstruction_names_errors_and_shades() -> None:
    mask = np.ones((300, 2), dtype=bool)
    mask[50:80, 1] = False
    figure = reconstruction(mask=mask)
    titles = [axis.get_title(loc="left") for axis in figure.axes]  # type: ignore[attr-defined]
    assert titles[0] == "a"
    assert titles[1].startswith("RMSE 0.500 N·m")
    assert [len(axis.collections) for axis in figure.axes] == [0, 0, 1, 1]  # type: ignore[attr-defined]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]  # type: ignore[attr-defined]
    assert labels == ["measured", "predicted", "rows not used"]


def test_reconstruction_without_time_and_with_units() -> None:
    y = np.ones((5, 2))
    figure = plot_reconstruction(None, y, 0.0 * y, ["a", "b"], [1.0, 2.0], units=["N", "N·m"])
    assert figure.axes[-1].get_xlabel() == "sample"
    assert figure.axes[0].get_ylabel() == "effort [N]"


def test_convergence_counts_ends() -> None:
    figure = convergence(label="local")
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]  # type: ignore[attr-defined]
    assert "end of a start (1)" in labels
    assert "end, infeasible (1)" in labels
    assert any(label.startswith("SDP (gap 0.0e+00") for label in labels)


def test_convergence_over_iterations_with_failures() -> None:
    figure = convergence(against="iterations", failed=3)
    axis = figure.axes[0]  # type: ignore[attr-defined]
    assert axis.get_xlabel() == "iteration"
    assert axis.get_xscale() == "linear"
    assert max(line.get_xdata()[-1] for line in axis.get_lines() if len(line.get_xdata()) > 2) == 2
    labels = [text.get_text() for text in axis.get_legend().get_texts()]
    assert "failed, nothing to draw (3)" in labels
    assert any(label.startswith("proven lower bound") for label in labels)
    with pytest.raises(DataError, match="against is 'hours'"):
        convergence(against="hours")


def test_steps_far_outside_leave_the_picture() -> None:
    wild = [Step(0.0, 90.0, 0.0), Step(0.1, 1e15, 7.0), Step(0.5, 10.1, 0.0)]
    axis = plot_convergence([wild], 10.0).axes[0]
    assert axis.get_ylim()[1] < 100.0


def test_convergence_of_exact_data() -> None:
    figure = plot_convergence([[Step(0.0, 1.0, 0.0), Step(1.0, 1e-20, 0.0)]], 0.0)
    assert figure.axes[0].get_ylabel() == "cost − bound"


def test_bad_input_is_named() -> None:
    time = np.arange(5.0)
    with pytest.raises(DataError, match="the same names"):
        plot_filtering(time, {"position": time}, {"torque": time})
    with pytest.raises(DataError, match="position has 3 rows"):
        plot_filtering(time, {"position": time}, {"position": time[:3]})
    with pytest.raises(DataError, match="window 9 to 10 s"):
        plot_filtering(time, {"position": time}, {"position": time}, window=(9.0, 10.0))
    y = np.ones((5, 2))
    with pytest.raises(DataError, match="predicted has 4 rows"):
        plot_reconstruction(time, y, y[:4], ["a", "b"])
    with pytest.raises(DataError, match="joint_names has 1"):
        plot_reconstruction(time, y, y, ["a"])
    with pytest.raises(DataError, match="must agree"):
        plot_reconstruction(time, y, y, ["a", "b"], mask=np.ones((5, 1), dtype=bool))
    with pytest.raises(DataError, match="rmse has 1"):
        plot_reconstruction(time, y, y, ["a", "b"], [1.0])
    with pytest.raises(DataError, match="nothing to draw"):
        plot_convergence([], 1.0)
    with pytest.raises(DataError, match="nothing to draw"):
        plot_parameters([], [], {})
    with pytest.raises(DataError, match="SDP has 2 entries"):
        plot_parameters(["a"], ["kg"], {"SDP": [1.0, 2.0]})


@pytest.mark.parametrize("make", [reconstruction, long_reconstruction])
def test_numbers_do_not_run_into_labels(make: object) -> None:
    figure = make()  # type: ignore[operator]
    figure.draw_without_rendering()
    renderer = figure._get_renderer()
    texts = list(figure.texts)
    for axis in figure.axes:
        label = axis.yaxis.label.get_window_extent(renderer)
        for number in axis.get_yticklabels():
            assert not number.get_window_extent(renderer).overlaps(label)
        below = axis.xaxis.label
        if below.get_text():
            texts.append(below)
            for number in axis.get_xticklabels():
                extent = number.get_window_extent(renderer)
                assert not extent.overlaps(below.get_window_extent(renderer))
    boxes = [text.get_window_extent(renderer) for text in (*texts, *figure.legends)]
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:i])
        assert box.y0 >= 0.0


def test_thinning_is_said_in_the_figure() -> None:
    said = [t.get_text() for t in reconstruction(15_000).texts]  # type: ignore[attr-defined]
    assert said == [f"drawn: least and greatest value of each {stretch(15_000)} samples"]
    assert not reconstruction(POINTS).texts  # type: ignore[attr-defined]
    assert stretch(15_000) == 20


def test_a_png_is_drawn_once(tmp_path: Path) -> None:
    figure: Any = reconstruction()
    own, drawn = figure.draw, []
    figure.draw = lambda renderer: (drawn.append(1), own(renderer))
    save_figure(figure, tmp_path / "a.png")
    assert len(drawn) == 1
    assert figure.dpi == 100.0


def test_spans_are_cut_half_way_between_samples() -> None:
    x = np.arange(6.0)
    low, high = spans(x, [True, False, False, True, True, False])
    assert low.tolist() == [0.0, 2.5]
    assert high.tolist() == [0.5, 4.5]
    assert spans(x, np.zeros(6, dtype=bool))[0].shape == (0,)


@pytest.mark.parametrize(
    ("axis", "texts"),
    [
        (Axis(-0.55, 1.0), ["−0.5", "0.0", "0.5", "1.0"]),
        (Axis(0.0, 380.0), ["0", "100", "200", "300"]),
        (Axis(-2e-6, 2e-6), ["−2·10⁻⁶", "−1·10⁻⁶", "0", "1·10⁻⁶", "2·10⁻⁶"]),
        (Axis(0.0, 2.5e6), ["0", "0.5·10⁶", "1.0·10⁶", "1.5·10⁶", "2.0·10⁶", "2.5·10⁶"]),
        (Axis(0.05, 50.0, log=True), ["0.1", "1", "10"]),
        (Axis(1e-7, 1e-4, log=True), ["10⁻⁷", "10⁻⁶", "10⁻⁵", "10⁻⁴"]),
        (Axis(2.0, 9.0, log=True), ["2", "5"]),
    ],
)
def test_ticks(axis: Axis, texts: list[str]) -> None:
    assert [text for _, text in axis.ticks] == texts
    assert all(axis.low * 0.999 <= value <= axis.high * 1.001 for value, _ in axis.ticks[1:])


@settings(max_examples=200, deadline=None)
@given(
    low=st.floats(-1e12, 1e12),
    size=st.floats(1e-9, 1e12),
    count=st.integers(3, 8),
    log=st.booleans(),
)
def test_any_axis_has_a_few_ticks(low: float, size: float, count: int, log: bool) -> None:
    if log:
        low = abs(low) + 1e-9
    axis = Axis(low, low + size, log=log, count=count)
    values = np.array([value for value, _ in axis.ticks])
    assert len(values) <= 2 * count + 2
    slack = 1e-6 * (axis.high - axis.low)
    assert np.all((values >= axis.low - slack) & (values <= axis.high + slack))
    places = axis.at(values)
    assert np.all((places > -1e-6) & (places < 1.0 + 1e-6))
    assert len({text for _, text in axis.ticks}) == len(values) or size < 1e-9 * abs(low)


def drawn_points(panel: Panel) -> np.ndarray:
    """Return the points of the first line in a panel, in parts of a unit."""
    path = re.search(r'stroke-width="[^"]*" d="([^"]*)"', panel.drawn(0.0, 400.0))
    assert path
    parts = path[1].lstrip("M").split("M")
    points = []
    for part in parts:
        start, _, rest = part.partition("l")
        numbers = [int(n) for n in re.findall(r"-?\d+", rest)]
        first = [int(n) for n in re.findall(r"-?\d+", start.partition("h")[0])]
        steps = np.array([first, *np.reshape(numbers, (-1, 2)).tolist()])
        points.append(np.cumsum(steps, axis=0))
    return np.concatenate(points)


def test_a_line_is_where_it_should_be_and_peaks_stay() -> None:
    x = np.linspace(0.0, 10.0, 50_001)
    y = np.sin(x)
    y[31_234] = 7.0
    panel = Panel(Axis(0.0, 10.0), Axis(-3.0, 7.0), 100.0)
    panel.line(x, y, "#000", 1.0)
    points = drawn_points(panel)
    assert len(points) <= 2 * COLUMNS + 4
    assert points[0].tolist() == [0, 700]
    assert [round(400.0 * x[31_234]), 0] in points.tolist()
    wave = points[points[:, 1] > 100]
    expected = 1000.0 * (1.0 - (np.sin(wave[:, 0] / 400.0) + 3.0) / 10.0)
    assert np.abs(wave[:, 1] - expected).max() <= 1.5


def test_gaps_break_a_line() -> None:
    panel = Panel(Axis(0.0, 4.0), Axis(0.0, 1.0), 100.0)
    panel.line(np.arange(5.0), np.array([0.0, np.nan, 1.0, np.nan, 0.0]), "#000", 1.0)
    assert drawn_points(panel).tolist() == [[0, 1000], [2000, 0], [4000, 1000]]


def test_a_constant_or_nothing_can_be_drawn() -> None:
    nothing = np.full(4, np.nan)
    for y in (np.zeros(4), np.full(4, 3.0), nothing):
        panel = Panel(Axis.around("x", np.arange(4.0)), Axis.around("y", y), 50.0)
        panel.line(np.arange(4.0), y, "#000", 1.0, label="<y>")
        text = picture([panel], "<&>")
        assert "nan" not in text
        assert "&lt;y&gt;" in text
        assert 'aria-label="&lt;&amp;&gt;"' in text
        assert text == picture([panel], "<&>")


def test_the_stretch_about_the_largest_error_is_shown() -> None:
    error = np.zeros(4000)
    error[2000] = -1.0
    assert detail(error) == slice(2000 - COLUMNS // 2, 2000 + COLUMNS // 2)
    error[3999] = 2.0
    assert detail(error) == slice(4000 - COLUMNS, 4000)
    error[:] = np.nan
    assert detail(error) == slice(0, COLUMNS)
    y = np.zeros(4000)
    assert "about the largest error" in plot_joint(None, y, y, np.zeros(4000, dtype=bool))
    few = np.zeros(2 * COLUMNS)
    assert "largest" not in plot_joint(None, few, few, few == 0.0)
