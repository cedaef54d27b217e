"""A results folder, checked by what lies in it: its seal, its proof, and the numbers beside it."""

import itertools
import json
import math
import re
import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import sdpid
from sdpid.robot.inertia import CONSISTENCIES, margin, matrix_of
from sdpid.verifier import bodies, exact
from sdpid.verifier.command import check_path
from sdpid.verifier.manifest import sealed
from sdpid.verifier.reading import MalformedError
from sdpid.verifier.result import Result
from tests.helpers import world
from tests.helpers.commands import VERIFIER, alone
from tests.helpers.forged import edit_json, reseal
from tests.helpers.refusals import refuses


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return world.folder(tmp_path_factory.mktemp("runs")) / "results"


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def verified(path: Path) -> Result:
    """Return what the stand-alone checker says."""
    return check_path(path)[0]


@pytest.mark.parametrize("sizes", [{"report.html": 2**29}, {"report.html": 2**28, "b": 2**28}])
def test_files_of_any_size_are_not_hashed(copy: Path, sizes: dict[str, int]) -> None:
    data = json.loads((copy / "manifest.json").read_text())
    for name, size in sizes.items():
        with (copy / name).open("wb") as file:
            file.truncate(size)
        data["files"][name] = {"bytes": size, "sha256": "0" * 64}
    (copy / "manifest.json").write_text(json.dumps(sealed(data)))
    refuses(MalformedError, r"bytes, and less than|not an integer from 0", verified, copy)


def test_what_was_written_holds(folder: Path) -> None:
    found = sdpid.verify(folder)
    assert found.passed
    assert found.verdict == "PROVEN, but for what was not checked."
    assert found.sha256 == json.loads((folder / "manifest.json").read_text())["sha256"]
    assert found.cost == json.loads((folder / "result.json").read_text())["cost_at_most"]
    files = "result.json, parameters.json, parameters.csv, base_parameters.csv"
    assert f"{files}: the numbers are the certificate's, to the last digit" in found.statements
    # What follows from the log is not called proven, and is told.
    assert found.made_again == ()
    for words in ("the log", "a digest is no signature", "'identified.urdf', 'identified.xml'"):
        assert any(words in said for said in found.unchecked)
    assert any("compared with nothing here" in said for said in verified(folder).unchecked)


def test_the_copied_checker_says_the_same(folder: Path, tmp_path: Path) -> None:
    """With the standard library alone, wherever it lies and whatever it is called."""
    there = tmp_path / "checker-1"
    shutil.copytree(VERIFIER, there, ignore=shutil.ignore_patterns("*.pyc"))
    done = alone(folder, there, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == list(verified(folder).lines)


@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_any_digit_of_any_file(folder: Path, tmp_path_factory: Any, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(path.name for path in folder.iterdir())))
    text = (folder / name).read_bytes()
    # The name of the software, at the manifest's head, is not sealed.
    start = text.index(b"inputs") if name == "manifest.json" else 0
    digits = [m.start() for m in re.finditer(rb"\d", text) if m.start() > start]
    assume(digits)
    at = data.draw(st.sampled_from(digits))
    new = data.draw(st.sampled_from(sorted({*b"0123456789"} - {text[at]})))
    path = Path(shutil.copytree(folder, tmp_path_factory.mktemp("digit") / "copy"))
    changed = text[:at] + bytes([new]) + text[at + 1 :]
    (path / name).write_bytes(changed)
    try:
        # The last of seventeen digits may be another of the same number, and so of the same seal.
        assume(name != "manifest.json" or json.loads(changed) != json.loads(text))
        problems = verified(path).problems
    except (MalformedError, json.JSONDecodeError):  # no JSON has numbers such as 02
        assert name in ("manifest.json", "certificate.json")
        return
    assert any(name in problem for problem in problems)


@pytest.mark.parametrize("name", ["identified.urdf", "parameters.csv", "report.html"])
def test_a_file_that_is_gone(copy: Path, name: str) -> None:
    (copy / name).unlink()
    assert any(f"'{name}' is missing" in problem for problem in verified(copy).problems)
    reseal(copy)
    problems = sdpid.verify(copy).problems
    # Of a robot and of tables it is known that they were written.
    assert any("and not sealed" in each for each in problems) == (name != "report.html")


def test_files_of_others_are_told(copy: Path) -> None:
    (copy / "notes\x1b[2J.txt").write_text("mine")
    result = verified(copy)
    assert result.passed
    assert any("'notes\\x1b[2J.txt': not of this run" in said for said in result.unchecked)


def test_a_certificate_that_does_not_hold(copy: Path) -> None:
    path = copy / "certificate.json"
    edit_json(path, lambda data: data["claims"].update(lower_bound=data["claims"]["cost"]))
    reseal(copy)
    problems = verified(copy).problems
    assert any(problem.startswith("certificate.json: ") for problem in problems)
    assert any("it says 'certified'" in problem for problem in sdpid.verify(copy).problems)


NO_FILES = ("../x", "../run.csv", "/etc/passwd", "a\\b", "", ".", "manifest.json")


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.update(version=1.0),
        lambda data: data.update(version=True),
        lambda data: data.update(more=1),
        lambda data: data.pop("inputs"),
        *(
            lambda data, name=name: data["files"].update({name: {"bytes": 0, "sha256": "0" * 64}})
            for name in NO_FILES
        ),
        lambda data: data["files"].update({"x": {"bytes": -1, "sha256": "0" * 64}}),
        lambda data: data["files"].update({"x": {"bytes": 0, "sha256": "0" * 63}}),
        lambda data: data["files"].pop("certificate.json"),
        lambda data: data["inputs"].append({}),
        lambda data: data["inputs"][0].update(role="friend"),
        lambda data: data.update(recipe=1),
        lambda data: data.update(certificate=1),
    ],
)
def test_a_manifest_that_is_none(copy: Path, change: Callable[[Any], Any]) -> None:
    edit_json(copy / "manifest.json", change)
    with pytest.raises(MalformedError):
        verified(copy)


def test_a_folder_without_a_manifest(tmp_path: Path) -> None:
    refuses(sdpid.errors.CertificateError, r"no manifest\.json", sdpid.verify, tmp_path)


# The arithmetic of the stand-alone checker, against floating point and exact identities.


SMALL = st.integers(-9, 9)
SHARES = st.fractions(0, 1, max_denominator=10**6).filter(bool)
POSITIVE = st.fractions(min_value=Fraction(1, 10**40), max_value=10**40)


def determinant(matrix: list[list[Fraction]]) -> Fraction:
    """Return the determinant by its definition."""
    size = len(matrix)
    total = Fraction(0)
    for order in itertools.permutations(range(size)):
        swaps = sum(order[i] > order[j] for j in range(size) for i in range(j))
        terms = (matrix[i][order[i]] for i in range(size))
        total += (-1) ** swaps * math.prod(terms, start=Fraction(1))
    return total


@st.composite
def grams(draw: st.DrawFn) -> list[list[Fraction]]:
    """Draw V·V^T of any rank, with zero rows now and then."""
    size, rank = draw(st.integers(1, 5)), draw(st.integers(0, 5))
    unit = draw(SHARES)
    V = draw(st.lists(st.lists(SMALL, min_size=rank, max_size=rank), min_size=size, max_size=size))
    return [[unit * sum(map(int.__mul__, a, b)) for b in V] for a in V]


@given(grams())
def test_squares_are_positive_semidefinite(matrix: list[list[Fraction]]) -> None:
    found, det = exact.factorize(matrix)
    assert found
    assert det == determinant(matrix)


@given(grams(), st.data())
def test_the_slightest_negative_direction_is_found(
    matrix: list[list[Fraction]], data: st.DataObject
) -> None:
    """With x^T·M·x = 0 for some x, M less any multiple of the identity is not ⪰ 0."""
    assume(determinant(matrix) == 0)
    share = data.draw(SHARES) / 10**30
    less = [[x - share * (i == j) for j, x in enumerate(row)] for i, row in enumerate(matrix)]
    assert not exact.positive_semidefinite(less)
    more = [[x + share * (i == j) for j, x in enumerate(row)] for i, row in enumerate(matrix)]
    assert exact.positive_semidefinite(more)


def test_other_matrices() -> None:
    assert exact.positive_semidefinite([])
    assert exact.positive_semidefinite([[0, 0], [0, 0.5]])
    assert not exact.positive_semidefinite([[0, 1], [1, 1]])
    assert not exact.positive_semidefinite([[1, 0], [1, 1]])
    assert not exact.positive_semidefinite([[1, 0]])
    # A tenth is not what the double of that name is.
    tenth = Fraction(1, 10)
    assert exact.positive_semidefinite([[tenth, 1], [1, 10]])
    assert exact.positive_semidefinite([[0.1, 1], [1, 10]]) == (Fraction(0.1) >= tenth)
    assert not exact.positive_semidefinite([[math.nextafter(0.1, 0.0), 1], [1, 10]])


@given(POSITIVE, POSITIVE)
def test_logarithms_are_enclosed(a: Fraction, b: Fraction) -> None:
    (low_a, high_a), (low_b, high_b), (low, high) = map(exact.log_bounds, (a, b, a * b))
    for value, ends in ((a, (low_a, high_a)), (b, (low_b, high_b))):
        assert ends[0] < ends[1] < ends[0] + Fraction(1, 2**52)
        nearest = math.log(value.numerator) - math.log(value.denominator)
        slack = 1e-13
        assert ends[0] - slack <= nearest <= ends[1] + slack
    # ln(a·b) = ln a + ln b lies in both intervals.
    assert low <= high_a + high_b
    assert high >= low_a + low_b


def test_logarithms_known_otherwise() -> None:
    """The digits of ln 2 and ln 10 are known from tables."""
    for value, digits in (
        (2, "0.69314718055994530941723212"),
        (10, "2.30258509299404568401799145"),
    ):
        low, high = exact.log_bounds(Fraction(value))
        assert low < Fraction(digits) + Fraction(1, 10**26)
        assert high > Fraction(digits)
        assert high - low < Fraction(1, 10**17)
    low, high = exact.log_bounds(Fraction(1))
    assert low <= 0 <= high


@given(st.fractions(0, 10**6))
def test_roots_are_from_above(value: Fraction) -> None:
    root = exact.root_above(value)
    assert value < root * root
    assert (root - Fraction(1, 2**78)) ** 2 <= value or root < Fraction(1, 2**77)


@given(st.lists(st.lists(st.floats(-1e9, 1e9), min_size=3, max_size=3), min_size=1, max_size=4))
def test_products(matrix: list[list[float]]) -> None:
    x = [1.5, -1e-200, 1e5]
    for row, found in zip(matrix, exact.product(matrix, x), strict=True):
        assert found == sum(Fraction(a) * Fraction(b) for a, b in zip(row, x, strict=True))


@pytest.mark.parametrize("consistency", CONSISTENCIES[:2])
def test_bodies(consistency: str) -> None:
    rng = np.random.default_rng(0)
    body = rng.standard_normal(10)
    body[0] = 1.0
    matrix = matrix_of(body, consistency)  # type: ignore[arg-type]
    found = bodies.link_matrix(body.tolist(), consistency)
    np.testing.assert_allclose(np.array(found, dtype=float), matrix, rtol=1e-15)
    Z = rng.standard_normal(matrix.shape)
    slopes = bodies.adjoint(Z.tolist(), consistency)
    assert float(exact.dot(slopes, body.tolist())) == pytest.approx(float(np.sum(Z * matrix)))
    largest = float(margin(body, consistency))  # type: ignore[arg-type]
    assert bodies.has_margin(body.tolist(), largest - 1e-9, consistency)
    assert not bodies.has_margin(body.tolist(), largest + 1e-9, consistency)
