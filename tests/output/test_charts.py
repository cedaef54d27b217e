"""Charts of a page: what it holds of arrays, and the library that draws them."""

import hashlib
import json
import re
from importlib.resources import files

import numpy as np
import pytest

from sdpid.output.charts.charts import Charts, scripts, style
from sdpid.output.charts.packed import packed
from tests.helpers.scenes import unpacked

X = np.linspace(0.0, 4.0, 50)


def column(charts: Charts, k: int) -> np.ndarray:
    return unpacked(json.loads(charts.data)["columns"][k]).ravel()


def test_columns_are_what_was_given_and_are_held_once() -> None:
    charts, y = Charts(), np.where(X > 3.0, np.nan, np.sin(X))
    assert charts.add(x=X, effort=y, half=0.0 * X + 0.1, nothing=None, range=(0.0, 1.0)) == 0
    assert charts.add(x=X, error=y, shaded=np.array([[1.0, 2.00000001]])) == 1
    content = json.loads(charts.data)
    first, second = content["charts"]
    assert len(content["columns"]) == 3
    assert (first["x"], first["effort"]) == (second["x"], second["error"])
    assert "nothing" not in first
    assert first["range"] == [0.0, 1.0]
    assert second["shaded"] == [[1.0, 2.0]]
    assert column(charts, first["x"]) == pytest.approx(X, abs=1e-4)
    assert column(charts, first["effort"]) == pytest.approx(y, abs=2e-5, nan_ok=True)
    assert column(charts, first["half"]) == pytest.approx(0.1)


def test_what_is_missing_is_told_apart() -> None:
    values = np.array([[1.0, np.nan], [np.inf, np.nan], [-3.0, -np.inf]])
    found = packed(values)
    assert found["low"] == [-3.0, 0.0]
    expected = np.where(np.isfinite(values), values, np.nan)
    assert unpacked(found) == pytest.approx(expected, nan_ok=True)


def test_no_name_leaves_its_place() -> None:
    charts, evil = Charts(), '</script><script>"alert(1)'
    charts.add(x=X, **{evil: X})
    assert "<" not in charts.data
    assert evil in json.loads(charts.data)["charts"][0]


def test_the_library_is_the_released_one_with_its_licence() -> None:
    """By the digests of the files in the package uplot 1.6.32 of npm's registry."""
    folder = files("sdpid.output.charts").joinpath("uplot")
    lines = folder.joinpath("SHA256SUMS").read_text().splitlines()
    listed = {name: digest for digest, name in map(str.split, lines)}
    assert set(listed) == {"uPlot.iife.min.js", "uPlot.min.css", "LICENSE"}
    for name, digest in listed.items():
        assert hashlib.sha256(folder.joinpath(name).read_bytes()).hexdigest() == digest
    library, _ = scripts()
    assert "The MIT License (MIT)" in library
    assert "uPlot (v1.6.32)" in library
    # Under a page's policy nothing is fetched, and no text is run.
    fetching = r"\beval\(|new Function|fetch\(|XMLHttpRequest|import\("
    assert not re.search(fetching, "".join(scripts()))
    assert "url(" not in style()
