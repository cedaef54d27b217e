"""Pictures of what was found: friction curves, forests, and the mass matrix along a motion."""

from dataclasses import dataclass

import numpy as np
import pytest

from sdpid.errors import DataError
from sdpid.plots import plot_forest, plot_friction_curve, plot_mass_matrix
from sdpid.plots.figures import envelope, figure_of, new_figure
from tests.helpers.pictures import svg_text
from tests.helpers.refusals import refuses

pytest.importorskip("matplotlib")


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
    axis = plot_friction_curve(curve(), cloud=cloud, driven=(-1.0, 0.5))
    assert labels(axis) == ["measured", "90 % band", "friction"]
    assert axis.get_xlim() == (-2.0, 2.0)
    assert axis.get_ylim()[1] < 33.0
    shaded = axis.collections[0].get_paths()[0].vertices[:, 0]
    assert set(shaded) - {0.0} == {-2.0, -1.0, 0.5, 2.0}  # zero where a path ends
    # One path holds every dot.
    assert svg_text(axis).count("<use") < 60
    bare = plot_friction_curve(Curve(np.array([1.0, 2.0]), np.ones(2), unit="N"))
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
    axis = plot_forest(names, values, lower=lower, upper=upper)
    assert [tick.get_text() for tick in axis.get_yticklabels()] == list(names)
    told = [text.get_text() for text in axis.texts]
    assert told == ["2.00 ± 0.10", "0.0010 ± 0.0020", "0"]
    # A limit cuts an interval off: its ends are written.
    cut = plot_forest(("Fs1",), {"this estimate": [0.0]}, lower=[0.0], upper=[0.048])
    assert [text.get_text() for text in cut.texts] == ["0.000 … 0.048"]
    lines = {line.get_label(): line for line in axis.lines}
    assert lines["this estimate"].get_xdata() == pytest.approx([2.0 / 2.1, 1.0 / 3.0, 0.0])
    # What is far out is an arrow at the edge.
    (arrow,) = [line for line in axis.lines if line.get_marker() == "<" and len(line.get_xdata())]
    assert arrow.get_xdata()[0] < -1.0
    own = new_figure(4.0, 3.0).subplots()
    assert plot_forest(names[:1], {"this estimate": [1.0]}, axes=own) is own
    refuses(DataError, "there are 3 names", plot_forest, names, {"this estimate": [1.0]})
    refuses(DataError, "at least one", plot_forest, (), {"this estimate": []})


@pytest.mark.parametrize("factor", [1.0, 1e4])
def test_eigenvalues_of_any_size_are_seen_beside_each_other(factor: float) -> None:
    t = np.linspace(0.0, 5.0, 50)
    own = 0.003 + 0.001 * np.sin(t)
    axis = plot_mass_matrix(
        t, {"least squares": -factor * own, "this estimate": own}, bound=0.0015, starts=(0, 20)
    )
    assert labels(axis) == ["least squares", "this estimate"]
    low, high = axis.get_ylim()
    place = axis.transData.transform([[0.0, x] for x in (low, 0.0, 0.003, high)])[:, 1]
    assert (place[2] - place[1]) > 0.1 * (place[3] - place[0])
    assert figure_of(axis).get_size_inches()[0] < 4.0
    refuses(DataError, "nothing to draw", plot_mass_matrix, t, {})
    refuses(DataError, "50", plot_mass_matrix, t, {"a": own[1:]})


def test_an_envelope_holds_its_band() -> None:
    x = np.arange(1001.0)
    middle = np.sin(x / 30.0)
    at, low, high = envelope(x, middle - 0.1, middle + 0.1, points=100)
    assert len(at) <= 100
    index = np.searchsorted(at, x, side="right") - 1
    assert np.all(low[index] <= middle - 0.1)
    assert np.all(high[index] >= middle + 0.1)
    gaps = np.where(x == 500.0, np.nan, middle)
    assert np.isnan(envelope(x, gaps, gaps, points=100)[1]).sum() == 1
