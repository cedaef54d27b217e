"""Proofs and folders of results, checked by what lies in them, and what a hostile file can do."""

import copy
import itertools
import json
import math
import re
import shutil
import tracemalloc
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from itertools import product
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import sdpid
from sdpid.constraints import CenterOfMassInEllipsoid, Fixed
from sdpid.robot.inertia import CONSISTENCIES, margin, matrix_of
from sdpid.verifier import bodies, bound, exact
from sdpid.verifier import certificate as checker
from sdpid.verifier.command import check_path, main
from sdpid.verifier.manifest import sealed
from sdpid.verifier.reading import MAX_BYTES, MalformedError
from sdpid.verifier.result import Result
from tests.helpers import world
from tests.helpers.arm import BODIES, LAST, LIGHT, arm_problem
from tests.helpers.commands import VERIFIER, alone
from tests.helpers.forged import at, edit_json, paths, reseal, set_to, with_row, written
from tests.helpers.refusals import refuses
from tests.helpers.studies import study

Data = dict[str, Any]
JUDGE = study("certificate_judge").Judge()
MUTATIONS = study("certificate_mutations")
FORGERIES = study("forgeries")
ENTROPIC = sdpid.Prior(kind="entropic", bodies=BODIES)


@cache
def made() -> Data:
    """Return a certificate with rows, a cone, an equation."""
    cone = CenterOfMassInEllipsoid(LAST, (0, 0.01, 0), (0.02, 0.05, 0.03))
    data = sdpid.certify(sdpid.solve_sdp(arm_problem(LIGHT, cone, Fixed({"Fv1": 0.5})))).to_dict()
    assert checked(data).passed
    return data


@pytest.fixture
def forged() -> Data:
    """A copy of that certificate."""
    return copy.deepcopy(made())


def checked(data: Data) -> Result:
    """Check data as a file's content, with a right digest."""
    return checker.check(checker.load(json.dumps(sealed(data)).encode()))


# ---- Rows and cones in another unit -------------------------------------------------------------


@given(st.integers(-60, 60), st.floats(-1e-6, 1e-6), st.booleans())
def test_units_do_not_matter(exponent: int, short: float, is_cone: bool) -> None:
    """A row or a cone times a power of two is the same condition, and judged the same."""
    found = []
    for factor in (1.0, 2.0**exponent):
        forged = copy.deepcopy(made())
        if is_cone:
            cone = forged["problem"]["cones"][0]
            cone["axis"][0] -= short
            cone["axis"] = [factor * x for x in cone["axis"]]
            cone["vectors"] = [[factor * x for x in row] for row in cone["vectors"]]
            z = forged["multipliers"]["Z"][-1]
            forged["multipliers"]["Z"][-1] = [[x / factor for x in row] for row in z]
        else:
            mass = forged["theta"][0]
            forged = with_row(forged, factor * mass * (1.0 + short), 1e-3 / factor, m_1=factor)
        found.append(checker.Proof(forged))
    assert found[0].violation == pytest.approx(found[1].violation, rel=1e-9, abs=1e-20)
    assert found[0].lower_bound == pytest.approx(found[1].lower_bound, rel=1e-9)


# ---- Another cost -------------------------------------------------------------------------------


def test_the_text_never_calls_a_rewritten_cost_that_of_the_log(forged: Data) -> None:
    """A cost whose optimum are the forger's parameters: true of the file, not of any log."""
    problem, claims = forged["problem"], forged["claims"]
    theta = np.array(forged["theta"]) * np.repeat([1.5, 1.0], [20, 4])
    rhs = np.array(problem["A"]) @ (np.array(problem["base_matrix"]) @ theta)
    problem.update(rhs=rhs.tolist(), floor=45.0, rows=[], cones=[])
    forged["theta"] = theta.tolist()
    Z = np.zeros((2, 4, 4)).tolist()
    forged["multipliers"] = {"y": [0.0] * len(rhs), "Z": Z, "rows": [], "W": None}
    claims.update(lower_bound=44.99, cost=45.1, gap=0.01, violation=0.0)
    result = checked(forged)
    assert result.passed
    assert JUDGE.claim(forged, "gap")[0] == "true"
    # What is told of the log is told as not checked, and nothing else speaks of it.
    assert any("log" in said for said in result.unchecked)
    assert not any("log" in said or "record" in said for said in result.statements)


# ---- Another question ---------------------------------------------------------------------------


def heavier() -> Data:
    """Return a certificate of links that are 1.3 times as heavy, which nobody wants."""
    forged = copy.deepcopy(made())
    forged["theta"][:20] = [1.3 * x for x in forged["theta"][:20]]
    forged["problem"].update(rows=[], cones=[])
    forged["multipliers"].update(Z=np.zeros((2, 4, 4)).tolist(), rows=[])
    forged["claims"]["margins"] = [0.0, 0.0]
    forged["problem"]["margin"] = 0.0
    return forged


def residual(data: Data) -> list[float]:
    """Return A·B·theta − rhs."""
    A, B, rhs = (np.array(data["problem"][key]) for key in ("A", "base_matrix", "rhs"))
    found: list[float] = (A @ (B @ np.array(data["theta"])) - rhs).tolist()
    return found


def test_a_box_of_one_point_is_told() -> None:
    """Where bounds leave nothing free, anything is optimal: the text says how much they fix."""
    forged = heavier()
    forged["problem"]["lower"] = forged["problem"]["upper"] = list(forged["theta"])
    forged["multipliers"]["y"] = residual(forged)
    assert FORGERIES.fit(forged)
    result = checked(forged)
    assert result.passed
    assert "24 fixed by them" in result.statements[1]
    assert " 0 fixed by them" in checked(made()).statements[1]
    # And that the box is anybody's choice is not left out.
    assert any("bounds" in said and "prior" in said for said in result.unchecked)


def shares(result: Result) -> list[float]:
    """Return the costs on the data and of the prior that a text tells apart, and the least."""
    said = next(said for said in result.statements if said.startswith("Of it at most "))
    found = re.fullmatch(
        r"Of it at most (\S+) is on the data and (\S+) for the prior; "
        r".* cost less than (\S+) on the data.",
        said,
    )
    return [float(number) for number in found.groups()]


def test_a_prior_that_holds_bad_parameters_is_told_apart() -> None:
    """A prior of a million nats makes any parameters optimal; their cost on the data is told."""
    forged = heavier()
    problem, y = forged["problem"], residual(forged)
    A, B = np.array(problem["A"]), np.array(problem["base_matrix"])
    problem["prior_matrix"] = (1e6 * np.eye(24)).tolist()
    problem["prior_rhs"] = [1e6 * x for x in forged["theta"]]
    of_prior = -(B.T @ (A.T @ np.array(y))) / 1e6
    forged["multipliers"]["y"] = [*y, *of_prior.tolist()]
    assert FORGERIES.fit(forged)
    result = checked(forged)
    assert result.passed
    # All of the cost is that on the data, far above what any numbers cost: the fit is bad.
    data_cost, prior_cost, least = shares(result)
    assert prior_cost < 1e-6 * data_cost
    assert least <= problem["floor"] < 0.9 * data_cost
    assert "a prior of 24 rows" in result.statements[1]
    assert any("prior" in said for said in result.unchecked)


def test_a_prior_of_nothing_does_not_dilute_the_gap() -> None:
    """A row of zeros with a large right-hand side costs the same everywhere: it is told apart."""
    forged = heavier()
    forged["problem"].update(prior_matrix=[[0.0] * 24], prior_rhs=[3e6])
    forged["multipliers"]["y"] = [*made()["multipliers"]["y"], -3e6]
    assert FORGERIES.fit(forged)
    data_cost, prior_cost, least = shares(checked(forged))
    assert prior_cost == 9e12
    assert least <= data_cost < 1e-6 * prior_cost


# ---- What is left out, and what is put in -------------------------------------------------------


def test_dropped_links_are_seen_in_the_text(forged: Data) -> None:
    told = checked(made()).statements
    assert "2 links" in told[0]
    assert "2 rows and 1 cones" in told[1]
    forged["problem"]["rows"], forged["multipliers"]["rows"] = [], []
    assert checked(forged).statements[1] != told[1]
    assert MUTATIONS.forget_links(Random(0), forged, {})
    forged["problem"]["cones"], forged["multipliers"]["Z"] = [], forged["multipliers"]["Z"][:1]
    assert checked(forged).statements[0] != told[0]


def test_a_massless_body_has_no_margin(forged: Data) -> None:
    forged["problem"].update(rows=[], cones=[])
    forged["multipliers"].update(rows=[], Z=np.zeros((2, 4, 4)).tolist())
    forged["multipliers"]["y"] = [0.0] * len(forged["multipliers"]["y"])
    forged["problem"]["lower"][0] = 0.0
    forged["theta"][:4] = [0.0] * 4
    claims = forged["claims"]
    claims.update(violation=0.0, lower_bound=-1e9, cost=1e9, gap=2.0)
    assert any("mass" in problem for problem in checked(forged).problems)
    claims["margins"][0] = None
    assert checked(forged).passed
    # And whoever has a mass has a margin.
    claims["margins"] = [None, None]
    assert any("mass" in problem for problem in checked(forged).problems)


HOSTILE = ("\x1b[2K\x1b[1A", "a\nPROVEN.", "\u202eNEVORP", "\x9b1A", "a\rb", "\ud800", "n" * 10**5,
           "arm': 7 links. They cost at most 0.0. '")  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_no_name_reaches_the_terminal_as_it_is(name: str, forged: Data, tmp_path: Path) -> None:
    forged["origin"]["robot"] = forged["origin"]["links"][0] = name
    forged["problem"]["rows"][0]["name"] = name
    forged["problem"]["rows"][0]["upper"] = -1.0  # so that it is named
    done = alone(written(sealed(forged), tmp_path))
    assert done.returncode == 1
    lines = done.stdout.split("\n")[:-1]
    assert all(line.isprintable() and len(line) < 3000 for line in lines)
    # Nor does it leave its quotes.
    assert name not in done.stdout
    assert [line for line in lines if line.startswith("PROVEN")] == []
    assert lines[-1].startswith("NOT PROVEN")


def test_files_of_before_are_read() -> None:
    """What they say beside the proof is not used: of the compression, of contacts, of pairs."""
    old = {**made(), "version": 4, "compression": {"relative": 0.5, "absolute": 1e-9}}
    assert checked(old).passed
    old["compression"], old["version"] = None, 5
    old["origin"] = {**old["origin"], "contacts": {"frames": ["foot"]}}
    old["problem"] = {**old["problem"], "alike": []}
    assert checked(old).passed
    assert checked(old).statements == checked(made()).statements
    assert not checked({**old, "theta": [1.1 * x for x in old["theta"]]}).passed


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *product(["version"], [3, 4, 5, 6.0, True, "6", None, 7]),
        *product(["rows", "cones", "prior_matrix", "A"], [{}, "", None, 0]),
        ("margin", -1.0),
    ],
)
def test_values_that_make_no_sense_are_refused(key: str, value: Any, forged: Data) -> None:
    (forged if key in forged else forged["problem"])[key] = value
    refuses(MalformedError, ".", checked, forged)


@pytest.mark.parametrize(("origin", "said"), [(None, "no object"), ({}, "missing .*'links'")])
def test_an_origin_that_is_none_is_named(origin: Any, said: str, forged: Data) -> None:
    refuses(MalformedError, f"origin .*{said}", checked, {**forged, "origin": origin})


def test_keys_at_any_level_are_known_and_there(forged: Data) -> None:
    every = (forged, *(at(forged, path) for path in paths(forged)))
    found = [each for each in every if isinstance(each, dict) and each]
    assert len(found) > 8
    for each in found:
        each["approved"] = True
        refuses(MalformedError, ".", checked, forged)
        del each["approved"]
        key = next(iter(each))
        kept = each.pop(key)
        refuses((MalformedError, KeyError), ".", checked, forged)
        each[key] = kept
    assert checked(forged).passed


def test_a_stated_share_is_not_rounded_down() -> None:
    """The violation that is printed is at least the one that there is."""
    forged = with_row(made(), made()["theta"][0] * (1 + 1.4e-10), 0.0, m_1=1.0)
    forged["claims"]["violation"] = violation = float(checker.Proof(forged).violation) * (1 + 1e-15)
    result = checked(forged)
    assert result.passed
    words = " ".join(result.statements).split("rows and cones to within ")[1].split()[0]
    assert float(words) >= violation


# ---- How little a hostile file can cost ---------------------------------------------------------


def test_a_large_file_is_not_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "large.json"
    with path.open("wb") as file:
        file.truncate(4 * MAX_BYTES)
    tracemalloc.start()
    try:
        assert main([str(path)]) == 2
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()
    assert "bytes" in capsys.readouterr().err


@pytest.mark.parametrize(
    "content",
    [
        b"[" * 10**6,
        b'{"a":' * 10**5,
        b'{"schema": ' + b"9" * 10**6 + b"}",
        b'{"schema": 1e' + b"9" * 10**6 + b"}",
        b'{"schema": 0.' + b"0" * 10**6 + b"1}",
        b"\xff\xfe{}",
        b"",
        None,
    ],
    ids=["depth", "objects", "integer", "exponent", "decimals", "encoding", "empty", "a pipe"],
)
def test_odd_json_and_a_pipe_are_refused(content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "odd.json"
    path.write_bytes(content or b"")
    done = alone(Path("/dev/stdin") if content is None else path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert len(done.stderr) < 1000


def test_a_link_has_one_prior() -> None:
    """A prior that is repeated a thousand times once took the script half a minute."""
    forged = sdpid.certify(sdpid.solve_sdp(arm_problem(prior=ENTROPIC, margin=0.0))).to_dict()
    assert checked(forged).passed
    assert MUTATIONS.repeat_link(Random(1), forged, {})
    refuses(MalformedError, ".", checked, forged)


# The campaign of forgeries finds errors that are planted in the verifier, and none otherwise.


ZOO = study("certificate_zoo")
SMALL = ("pendulum", "small log-det", "local", "big floor")


@cache
def zoo() -> dict[str, Any]:
    """Return small certificates of every kind."""
    names = ZOO.sdpid.load_robot("double_pendulum").link_names
    cone = ZOO.of.CenterOfMassInEllipsoid(names[1], (0.0, 0.0, 0.2), (0.05, 0.05, 0.1))
    others = (ZOO.of.TotalMass(1.2, tolerance=0.1), cone)
    made = {name: ZOO.ZOO[name]() for name in SMALL}
    made["rows"] = ZOO.certified(ZOO.problem("double_pendulum", *others, seed=21))
    spatial = ZOO.problem("double_pendulum", seed=22, consistency="spatial_inertia")
    made["spatial"] = ZOO.certified(spatial)
    return made


def false(count: int, *kinds: str) -> list[Any]:
    """Return the forgeries of which something false was said."""
    found = FORGERIES.some(range(count), 0, zoo(), kinds or tuple(sorted(FORGERIES.MUTATIONS)))
    return [each for each in found if each.false]


def after(name: str, how: Callable[[Any], None]) -> tuple[Any, str, Any]:
    """Return a method of the verifier's proof after which something more is done."""
    kept = getattr(checker.Proof, name)

    def method(self: Any, *arguments: Any) -> None:
        kept(self, *arguments)
        how(self)

    return checker.Proof, name, method


def no_violation(proof: Any) -> None:
    proof.violation = Fraction(0)


def higher_bound(proof: Any) -> None:
    proof.lower_bound += abs(proof.lower_bound) / 1000


def lower_cost(proof: Any) -> None:
    proof.data_cost *= Fraction(999, 1000)


def without_bounds(*given: Any, found: Any = checker.infeasible) -> list[str]:
    return [each for each in found(*given) if "outside" not in each]


# What is replaced in the verifier, and the forgeries that it lets through.
PLANTED: dict[str, tuple[tuple[Any, str, Any], tuple[str, ...]]] = {
    "Z may be anything": ((bound, "positive_semidefinite", lambda _: True), ("bent multipliers",)),
    "links may be anything": (
        (checker, "_wrong_margins", lambda *_: []),
        ("parameters", "claim"),
    ),
    "bounds on theta are not looked at": ((checker, "infeasible", without_bounds), ("bounds",)),
    "a large tolerance": ((checker, "TOLERANCE", Fraction(10)), ("added row",)),
    "rows are not looked at": (after("_rows", no_violation), ("added row",)),
    "a bound that is too high": (after("__init__", higher_bound), ("last digits",)),
    "a cost that is too low": (after("__init__", lower_cost), ("last digits",)),
}


def test_nothing_false_is_said() -> None:
    assert false(30) == []


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_error_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    replaced, kinds = PLANTED[name]
    monkeypatch.setattr(*replaced)
    assert false(16, *kinds)


# ---- A folder of results, checked by what lies in it: its seal, its proof, the numbers beside it.


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return world.folder(tmp_path_factory.mktemp("runs")) / "results"


@pytest.fixture
def own(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def verified(path: Path) -> Result:
    """Return what the stand-alone checker says."""
    return check_path(path)[0]


@pytest.mark.parametrize("sizes", [{"report.html": 2**29}, {"report.html": 2**28, "b": 2**28}])
def test_files_of_any_size_are_not_hashed(own: Path, sizes: dict[str, int]) -> None:
    data = json.loads((own / "manifest.json").read_text())
    for name, size in sizes.items():
        with (own / name).open("wb") as file:
            file.truncate(size)
        data["files"][name] = {"bytes": size, "sha256": "0" * 64}
    (own / "manifest.json").write_text(json.dumps(sealed(data)))
    refuses(MalformedError, r"bytes, and less than|not an integer from 0", verified, own)


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
    """With the standard library alone, wherever it lies, and not by a `json.py` beside it."""
    there = tmp_path / "checker-4.0 (1)"
    shutil.copytree(VERIFIER, there, ignore=shutil.ignore_patterns("*.pyc"))
    for name in ("json", "hashlib", "fractions", "certificate", "urdf"):
        (tmp_path / f"{name}.py").write_text("print('PROVEN.'); raise SystemExit(0)\n")
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
def test_a_file_that_is_gone(own: Path, name: str) -> None:
    (own / name).unlink()
    assert any(f"'{name}' is missing" in problem for problem in verified(own).problems)
    reseal(own)
    problems = sdpid.verify(own).problems
    # Of a robot and of tables it is known that they were written.
    assert any("and not sealed" in each for each in problems) == (name != "report.html")


def test_files_of_others_are_told(own: Path) -> None:
    (own / "notes\x1b[2J.txt").write_text("mine")
    result = verified(own)
    assert result.passed
    assert any("'notes\\x1b[2J.txt': not of this run" in said for said in result.unchecked)


def test_a_certificate_that_does_not_hold(own: Path) -> None:
    path = own / "certificate.json"
    edit_json(path, lambda data: data["claims"].update(lower_bound=data["claims"]["cost"]))
    reseal(own)
    problems = verified(own).problems
    assert any(problem.startswith("certificate.json: ") for problem in problems)
    assert any("it says 'certified'" in problem for problem in sdpid.verify(own).problems)


NO_FILES = ("../x", "../run.csv", "/etc/passwd", "a\\b", "", ".", "manifest.json")


@pytest.mark.parametrize(
    "change",
    [
        *(set_to(value, "version") for value in (1.0, True)),
        *(set_to(1, key) for key in ("more", "recipe", "certificate")),
        lambda data: data.pop("inputs"),
        *(set_to({"bytes": 0, "sha256": "0" * 64}, "files", name) for name in NO_FILES),
        set_to({"bytes": -1, "sha256": "0" * 64}, "files", "x"),
        set_to({"bytes": 0, "sha256": "0" * 63}, "files", "x"),
        lambda data: data["files"].pop("certificate.json"),
        lambda data: data["inputs"].append({}),
        set_to("friend", "inputs", 0, "role"),
    ],
)
def test_a_manifest_that_is_none(own: Path, change: Callable[[Any], Any]) -> None:
    edit_json(own / "manifest.json", change)
    refuses(MalformedError, ".", verified, own)


def test_a_folder_without_a_manifest(tmp_path: Path) -> None:
    refuses(sdpid.errors.CertificateError, r"no manifest\.json", sdpid.verify, tmp_path)


# The arithmetic of the stand-alone checker, against floating point and exact identities.


DIGITS = st.integers(-9, 9)
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
    V = draw(st.lists(st.lists(DIGITS, min_size=rank, max_size=rank), min_size=size, max_size=size))
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
