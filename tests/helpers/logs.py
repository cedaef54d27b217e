"""Log files as other programs write them."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np


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
