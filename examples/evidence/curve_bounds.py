"""How much larger the bounds of a curve are than what it reaches between the samples.

Random closed splines of 36 intervals over 20 s, at rest at their ends, and Fourier series of ten
random harmonics: the largest control point of each derivative after its knots were halved some
times, and the bound of `enclose` over short cells, beside the largest value on a fine grid.

    python examples/evidence/curve_bounds.py --out results
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from study import Rows, Study

from sdpid.experiment.trajectory.curve import Curve, Spline
from sdpid.experiment.trajectory.fourier import FourierSeries

DURATION, FREE, JOINTS, HARMONICS = 20.0, 35, 3, 10
DERIVATIVES = ("position", "velocity", "acceleration", "jerk")
ORDERS = range(len(DERIVATIVES))
TIME = np.linspace(0.0, DURATION, 20_001)


def random_spline(rng: np.random.Generator) -> Spline:
    """Return a spline that is at rest at its ends, which are the same."""
    return Spline.from_free(rng.uniform(-1.0, 1.0, (FREE, JOINTS)), DURATION)


def random_series(rng: np.random.Generator) -> FourierSeries:
    """Return a series whose harmonics move equally fast in the mean."""
    harmonics = np.tile(np.arange(1, HARMONICS + 1), (JOINTS, 1))
    return FourierSeries(
        period=DURATION,
        center=np.zeros(JOINTS),
        harmonics=harmonics,
        amplitudes=rng.uniform(0.0, 1.0, harmonics.shape) / harmonics,
        phases=rng.uniform(0.0, 2.0 * np.pi, harmonics.shape),
    )


def enclosed(curve: Curve, order: int, cell: float) -> np.ndarray:
    """Return the bound (n,) of a derivative's size over all cells."""
    edges = np.linspace(0.0, DURATION, round(DURATION / cell) + 1)
    lower, upper = curve.enclose(edges, derivative=order)
    return np.asarray(np.maximum(-lower, upper).max(axis=0))


def controlled(curve: Spline, order: int, halvings: int) -> np.ndarray:
    """Return the size (n,) of the largest control point of a derivative."""
    matrix = Spline.control_matrix(len(curve.control_points), DURATION, order, halvings)
    return np.asarray(np.abs(matrix @ curve.control_points).max(axis=0))


WAYS: dict[str, tuple[Callable[..., Curve], Callable[..., np.ndarray], float]] = {
    "control points, one halving": (random_spline, controlled, 1),
    "two halvings": (random_spline, controlled, 2),
    "three halvings": (random_spline, controlled, 3),
    "enclose, cells of 0.1 s": (random_spline, enclosed, 0.1),
    "enclose, cells of 0.02 s": (random_spline, enclosed, 0.02),
    "enclose of a Fourier series, cells of 0.1 s": (random_series, enclosed, 0.1),
}


def excess(name: str, seed: int) -> Rows:
    """Yield by how much the bounds of a curve exceed what it reaches, %."""
    make, bound, size = WAYS[name]
    curve = make(np.random.default_rng(seed))
    reached = [np.abs(curve.evaluate(TIME, derivative=k)).max(axis=0) for k in ORDERS]
    shares = np.array([bound(curve, k, size) for k in ORDERS]) / np.array(reached) - 1.0
    yield 100.0 * shares.mean(axis=1)


def main() -> None:
    """Measure and write the table."""
    study = Study(__doc__, quick={"curves": 2}, curves=20)
    title = "excess over the true extreme, %"
    header = (title, "curve", *DERIVATIVES)
    found = study.rows("curves.csv", header, excess, WAYS, range(study.curves))
    columns = {name: f"mean {name}" for name in DERIVATIVES}
    study.summary("curve_bounds.csv", found, (title,), columns)


if __name__ == "__main__":
    main()
