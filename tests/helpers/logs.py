"""Log files as other programs write them."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from sdpid.experiment.recording.recording import Recording

T = 0.01 * np.arange(40)
Q, TAU, DQ = np.random.default_rng(5).standard_normal((3, 40, 2))


def write_csv(
    file: Path, names: Iterable[str], *tables: Any, mark: str = ",", decimal: str = "."
) -> Path:
    """Write columns of numbers to all digits under their names, if there are any."""
    rows = ([repr(float(x)).replace(".", decimal) for x in row] for row in np.column_stack(tables))
    lines = [mark.join(line) for line in (list(names), *rows) if line]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def write_npz(file: Path, **arrays: Any) -> Path:
    """Write the arrays that are not None."""
    np.savez(file, **{name: array for name, array in arrays.items() if array is not None})
    return file


def numbered(*templates: str, n: int = 2) -> list[str]:
    """Return names with the numbers from 1 to n."""
    return [template.format(j) for template in templates for j in range(1, n + 1)]


def close(log: Recording, *, velocity: bool = False, joints: Any = ()) -> None:
    """Check that a log holds T, Q, TAU and, if it is to have velocities, DQ."""
    np.testing.assert_allclose(log.time - log.time[0], T, atol=1e-9)
    np.testing.assert_allclose(log.position, Q, rtol=1e-13)
    np.testing.assert_allclose(log.effort, TAU, rtol=1e-13)
    assert (log.velocity is not None) == velocity
    if velocity:
        np.testing.assert_allclose(log.velocity, DQ, rtol=1e-13)
    assert joints == () or log.joint_names == joints
