"""Plots are drawn from arrays, without global state, and written whole."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from sdpid.errors import DataError, ExportError
from sdpid.estimation.estimate import Step
from sdpid.output.figures import POINTS, decimate, runs
from sdpid.output.plots import (
    plot_convergence,
    plot_filtering,
    plot_parameters,
    plot_reconstruction,
    save_figure,
)

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


FIGURES = [filtering, reconstruction, convergence, iterations, parameters]


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
