"""Proofs of tables as files: what is changed is refused, named, or still true."""

import copy
import json
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from fractions import Fraction
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid import load_robot
from sdpid.assurance.tables.csv_table import read_base_table
from sdpid.assurance.tables.witness import Question
from sdpid.assurance.tables.witness_search import Search
from sdpid.cli.judge.audit import _write_proof
from sdpid.errors import CertificateError, ExportError
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import margin_shift, matrix_of
from sdpid.robot.model.base_parameters import characteristic_length, structural_base
from sdpid.verifier.decimals import decimal_text
from sdpid.verifier.reading import MalformedError, digest
from sdpid.verifier.realizable import Realization, Refutation
from sdpid.verifier.tables import answer_of, check, inequality, require_form
from tests.helpers.commands import alone, ran
from tests.helpers.refusals import refuses

TABLE_IV = bundled_folder("denso_vp6242") / "table_iv.csv"

# Few numbers, so that a proof is made in a moment: link 6 of the Denso arm, with friction.
IMPOSSIBLE = {"zz6": "0.00", "xxr6": "-0.07", "Fs1": "1"}
POSSIBLE = {"zz6": "0.05", "xxr6": "0.01", "mx6": "0.2", "Fs1": "1"}


@cache
def stored(kind: str) -> str:
    """Return the text of a proof file."""
    robot = load_robot("denso_vp6242")
    if kind == "paper":
        table = read_base_table(TABLE_IV, value="cwls")
        options = {"consistency": "spatial_inertia", "margin": "0.005", "table": table.file}
        found = sdpid.audit_base_parameters(robot, table.values, table.halfwidths, **options)
    else:
        found = sdpid.audit_base_parameters(
            robot, IMPOSSIBLE if kind == "refutation" else POSSIBLE, "0.005"
        )
    return json.dumps(found.certificate.to_dict())


def proof(kind: str) -> dict[str, Any]:
    return dict(json.loads(stored(kind)))


def sealed(data: dict[str, Any]) -> dict[str, Any]:
    return {**data, "sha256": digest(data)}


def holds(data: dict[str, Any]) -> bool:
    """Return whether everything in a changed proof holds, its digest made anew."""
    return check(require_form(sealed(data))).passed


@pytest.mark.parametrize("kind", ["refutation", "realization", "paper"])
def test_proofs_are_checked_by_the_folder_alone(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "proof.json"
    path.write_text(stored(kind), encoding="utf-8")
    done = alone(path)
    assert done.returncode == 0, done.stderr
    said = done.stdout
    assert "robot 'denso_vp6242' (6 links" in said
    assert said.splitlines()[-1].startswith("PROVEN")
    assert "not checked: that the coefficients are those of robot 'denso_vp6242'" in said
    if kind == "paper":
        assert "'table_iv.csv'" in said
        assert "48 parameters" in said
        assert "a margin of at least 0.005 kg.m2" in said
        assert "needs the links' consistency and the margin" in said
    changed = proof(kind)
    changed["parameters"][0]["value"] = "17"
    path.write_text(json.dumps(changed), encoding="utf-8")
    done = alone(path)
    assert done.returncode == 1
    assert "NOT PROVEN: the digest is another" in done.stdout
    path.write_text("{}", encoding="utf-8")
    done = alone(path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_wrong_weights_prove_nothing() -> None:
    data = proof("paper")
    weights = data["refutation"]["weights"]
    for name in weights:
        for factor in (-1, 0, Fraction(1, 2)):
            changed = copy.deepcopy(data)
            changed["refutation"]["weights"][name] = str(factor * Fraction(weights[name]))
            assert not holds(changed), (name, factor)
    changed = copy.deepcopy(data)
    changed["refutation"]["weights"] = {name: str(-Fraction(w)) for name, w in weights.items()}
    assert not holds(changed)
    changed["refutation"]["weights"] = {}
    assert not holds(changed)


def test_another_table_is_not_refuted() -> None:
    data = proof("paper")
    weights = data["refutation"]["weights"]
    for k, one in enumerate(data["parameters"]):
        if one["name"] not in weights:
            continue
        sign = 1 if Fraction(weights[one["name"]]) > 0 else -1
        changed = copy.deepcopy(data)
        changed["parameters"][k]["value"] = str(Fraction(one["value"]) + sign)
        assert not holds(changed)
        changed["parameters"][k].update(value=one["value"], halfwidth="1")
        assert not holds(changed)
    changed = copy.deepcopy(data)
    changed["constraints"]["margin"] = "0"
    assert not holds(changed)


def test_negative_multipliers_prove_nothing() -> None:
    for part in ("masses", "slack"):
        changed = proof("paper")
        changed["refutation"][part] = {"0": "-1"}
        assert not holds(changed)


def test_other_bodies_are_named() -> None:
    data = proof("realization")
    for j, value in ((50, "0"), (50, "100.1"), (59, "10000.1"), (59, "-1"), (60, "-1")):
        changed = copy.deepcopy(data)
        changed["realization"]["theta"][j] = value
        problems = check(require_form(sealed(changed))).problems
        assert problems, (j, value)
    changed = copy.deepcopy(data)
    changed["realization"]["margins"][0] = "1000"
    assert "claimed" in check(require_form(sealed(changed))).problems[0]
    changed = copy.deepcopy(data)
    changed["constraints"]["margin"] = "1"
    assert not holds(changed)


HOSTILE: list[Callable[[dict[str, Any]], Any]] = [
    lambda p: p.update(schema="other"),
    lambda p: p.update(schema=["sdpid-refutation"]),
    lambda p: p.update(version=1),
    lambda p: p.update(version=2.0),
    lambda p: p.update(version=True),
    lambda p: p.update(extra=1),
    lambda p: p.update(robot={"name": "arm"}),
    lambda p: p["robot"].update(links=[]),
    lambda p: p["robot"].update(links=["a"] * 6),
    lambda p: p["robot"].update(links=list("abcdefgh")),
    lambda p: p["robot"].update(name=1),
    lambda p: p["table"].update(file=3),
    lambda p: p["constraints"].update(consistency="none"),
    lambda p: p["constraints"].update(consistency=[]),
    lambda p: p["constraints"].update(margin="-1"),
    lambda p: p["constraints"].update(margin=0),
    lambda p: p["constraints"].update(margin="1/0"),
    lambda p: p["constraints"].update(margin="1e400"),
    lambda p: p["constraints"].update(margin="1e999999999"),
    lambda p: p["constraints"].update(margin="Infinity"),
    lambda p: p["constraints"].update(margin="nan"),
    lambda p: p["constraints"].update(margin="9" * 5000),
    lambda p: p["constraints"].update(margin="١"),
    lambda p: p["constraints"].update(mass_max="0"),
    lambda p: p["constraints"].update(theta_max="1"),
    lambda p: p["constraints"].update(mass_min="0"),
    lambda p: p["constraints"].update(nonnegative=[0]),
    lambda p: p["constraints"].update(nonnegative=[999]),
    lambda p: p["constraints"].update(nonnegative=[60.0]),
    lambda p: p.update(theta_names=p["theta_names"][:59]),
    lambda p: p.update(theta_names=[*p["theta_names"][:-1], "m_1"]),
    lambda p: p.update(parameters=[]),
    lambda p: p["parameters"][0].pop("value"),
    lambda p: p["parameters"][0].update(halfwidth="-1"),
    lambda p: p["parameters"][0].update(halfwidth=float("inf")),
    lambda p: p["parameters"][0]["coefficients"].update({"-1": "1"}),
    lambda p: p["parameters"][0]["coefficients"].update({"007": "1"}),
    lambda p: p["parameters"][0]["coefficients"].update({"9999": "1"}),
    lambda p: p["parameters"].append(p["parameters"][0]),
    lambda p: (
        [one.update(value=f"1/{7**400 + 2 * k}") for k, one in enumerate(p["parameters"])] * 30
        and p["parameters"][0]["coefficients"].update(
            {str(k): f"1/{7**400 + 2 * k + 1}" for k in range(60)}
        )
    ),
]


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        *product(("refutation", "realization"), HOSTILE),
        ("refutation", lambda p: p["refutation"].update(weights={"zz5": "1"})),
        ("refutation", lambda p: p["refutation"].update(weights=[])),
        ("refutation", lambda p: p["refutation"].update(masses={"6": "1"})),
        ("refutation", lambda p: p["refutation"].pop("slack")),
        ("realization", lambda p: p["realization"]["theta"].pop()),
        ("realization", lambda p: p["realization"]["margins"].append("0")),
        ("realization", lambda p: p["realization"].update(theta="0")),
        ("realization", lambda p: p.update(schema="sdpid-refutation")),
    ],
)
def test_what_is_no_proof_or_answer_is_refused(
    kind: str, change: Callable[[dict[str, Any]], Any]
) -> None:
    changed = proof(kind)
    change(changed)
    with pytest.raises(MalformedError):
        answer_of(require_form(changed))


def test_names_are_printed_escaped_and_in_quotes() -> None:
    text = stored("refutation").replace("denso_vp6242", r"\u001b[2J")
    text = text.replace("xxr6", r"x\u202e\nPROVEN.").replace("zz6", "m_1 >= 9 for links. No links")
    said = check(require_form(sealed(json.loads(text)))).lines
    assert said[-1].startswith("PROVEN")
    assert all(line.isprintable() for line in said)
    assert any("'m_1 >= 9 for links. No links' + " in line for line in said)


def test_numbers_are_printed_exactly_or_marked() -> None:
    assert decimal_text(Fraction("100.0000001")) == "100.0000001"
    assert decimal_text(Fraction(2, 3)) == "~0.666667"
    changed = proof("realization")
    changed["realization"]["theta"] = ["-1"] * len(changed["theta_names"])
    problems = check(require_form(sealed(changed))).problems
    assert len(problems) < 20
    assert problems[-1].endswith("more")


def test_long_inequalities_are_cut() -> None:
    answer = answer_of(require_form(proof("refutation")))
    assert isinstance(answer, Refutation)
    weights = {f"p{k}": Fraction(1) for k in range(300)}
    same = {name: getattr(answer.question, name) for name in vars(answer.question)}
    count = len(weights)
    rows, halves = ({},) * count, (Fraction(0),) * count
    question = type(answer.question)(
        **{**same, "names": tuple(weights), "rows": rows, "values": halves, "halfwidths": halves}
    )
    text = inequality(Refutation(question=question, weights=weights))
    assert "p199 and 100 more terms >= 0" in text
    assert "p200" not in text


# -------------------------------------------------------------------- the robot


def verified(tmp_path: Path, data: dict[str, Any], robot: str = "denso_vp6242") -> Any:
    path = tmp_path / "proof.json"
    path.write_text(json.dumps(sealed(data)), encoding="utf-8")
    return sdpid.verify(path, robot=robot)


@pytest.mark.parametrize("kind", ["refutation", "realization", "paper"])
def test_coefficients_are_those_of_the_robot(kind: str, tmp_path: Path) -> None:
    found = verified(tmp_path, proof(kind))
    assert found.passed
    assert "are those of robot 'denso_vp6242', computed anew" in found.statements[-1]
    assert not any("coefficients" in each for each in found.unchecked)
    ran("verify", tmp_path / "proof.json", "--robot", "denso_vp6242")


def test_other_coefficients_are_named(tmp_path: Path) -> None:
    data = proof("paper")
    row = data["parameters"][4]["coefficients"]
    last = list(row)[-1]
    row[last] = str(Fraction(row[last]) + Fraction(1, 10**9))
    assert holds(data)
    found = verified(tmp_path, data)
    assert found.problems == (
        f"the coefficients of {data['parameters'][4]['name']} are other ones",
    )
    data = proof("paper")
    data["parameters"][0]["name"] = "zz99"
    assert "has no parameter 'zz99'" in verified(tmp_path, data).problems[0]
    data = proof("realization")
    data["theta_names"][0] = "m_9"
    assert "theta is not that" in verified(tmp_path, data).problems[0]
    assert "the links are not those" in verified(tmp_path, proof("paper"), "ur5_robot").problems[0]


def test_signs_that_physics_does_not_give_are_named(tmp_path: Path) -> None:
    robot = load_robot("denso_vp6242")
    made = sdpid.audit_base_parameters(robot, {"zz6": "0.05", "Fo1": "1"}, "0.005")
    data = made.certificate.to_dict()
    assert data["constraints"]["nonnegative"] == []
    data["constraints"]["nonnegative"] = [data["theta_names"].index("Fo1")]
    assert verified(tmp_path, data).problems == ("Fo1 may be negative",)


# -------------------------------------------------------------------- mutations


def paths(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield where every value within a JSON value stands."""
    inner = value.items() if isinstance(value, dict) else enumerate(value)
    for key, item in inner:
        yield (*at, key)
        if isinstance(item, (dict, list)):
            yield from paths(item, (*at, key))


NUMBERS = st.sampled_from(
    ["0", "1", "-1", "0.005", "-0.07", "1000", "1/3", "-2/7", "0.000001", "100", "1e3", "1/0", ""]
)
ODD = st.one_of(
    NUMBERS, st.none(), st.integers(-3, 99), st.just([]), st.just({}), st.text(max_size=4)
)


def mutated(data: dict[str, Any], choose: st.DataObject) -> dict[str, Any]:
    """Return a proof with one to three values changed, taken away or doubled."""
    for _ in range(choose.draw(st.integers(1, 3))):
        at = choose.draw(st.sampled_from(list(paths(data))))
        where: Any = data
        for key in at[:-1]:
            where = where[key]
        old, how = where[at[-1]], choose.draw(st.sampled_from("rrrnsd"))
        if how == "d":
            del where[at[-1]]
        elif how == "s" and isinstance(old, str):
            where[at[-1]] = old[1:] if old.startswith("-") else f"-{old}"
        elif how == "n" or not isinstance(old, str):
            where[at[-1]] = choose.draw(ODD)
        else:
            where[at[-1]] = choose.draw(NUMBERS)
    return data


def really_realized(answer: Realization) -> bool:
    """Judge bodies in floating point, by other code."""
    q, theta = answer.question, np.array([float(x) for x in answer.theta])
    for row, value, half in zip(q.rows, q.values, q.halfwidths, strict=True):
        had = sum(float(x) * theta[j] for j, x in row.items())
        if abs(had - float(value)) > float(half) + 1e-9 * (1 + abs(had)):
            return False
    shift = margin_shift(q.consistency)
    for link in range(q.n_links):
        body = theta[10 * link : 10 * link + 10]
        least = max(float(q.margin), float(answer.margins[link]))
        matrix = matrix_of(body, q.consistency) - least * shift
        if np.linalg.eigvalsh(matrix)[0] < -1e-9 * (1 + np.abs(matrix).max()):
            return False
        if not float(q.mass_min) - 1e-12 <= body[0] <= float(q.mass_max) + 1e-9:
            return False
    low = [0 if j in q.nonnegative else -float(q.theta_max) for j in range(len(theta))]
    return bool(np.all(theta >= low) and np.all(theta <= float(q.theta_max)))


def really_refuted(answer: Refutation) -> bool:
    """Return whether a cone program finds no bodies that have the table."""
    q = answer.question
    values = {field.name: getattr(q, field.name) for field in fields(q)}
    question = Question(**values, leading=(None,) * len(q.names))
    search = Search.of(question, characteristic_length(load_robot("denso_vp6242")))
    theta = search.most_interior()
    return theta is None or not question.is_witness(search.made_exact(theta))


@pytest.mark.parametrize("kind", ["refutation", "realization"])
@settings(max_examples=300, deadline=None)
@given(choose=st.data())
def test_mutations_are_refused_or_still_true(kind: str, choose: st.DataObject) -> None:
    before = proof(kind)
    data = mutated(copy.deepcopy(before), choose)
    try:
        result = check(require_form(data))
    except (MalformedError, KeyError):
        return
    if {**data, "metadata": 0} != {**before, "metadata": 0}:
        assert any("digest" in problem for problem in result.problems)
    if not holds(data):
        return
    answer = answer_of(data)
    judge = really_realized if isinstance(answer, Realization) else really_refuted
    assert judge(answer)  # type: ignore[operator]


# -------------------------------------------------------------------- writing


def test_files_appear_whole_or_not_at_all(tmp_path: Path) -> None:
    robot = load_robot("denso_vp6242")
    found = sdpid.audit_base_parameters(robot, {"zz6": "0.05"}, "0.005")
    with pytest.raises(ExportError):
        found.certificate.to_json(tmp_path / "missing" / "proof.json")
    found.certificate.to_json(tmp_path / "proof.json")
    assert [path.name for path in tmp_path.iterdir()] == ["proof.json"]


def test_undecided_writes_nothing_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = sdpid.audit_base_parameters(load_robot("denso_vp6242"), {"zz6": "0.05"}, "0.005")
    _write_proof(tmp_path / "proof.json", replace(found, verdict="undecided", certificate=None))
    assert "not written: undecided, so there is no proof" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_numbers_too_long_for_the_checker_are_not_written(tmp_path: Path) -> None:
    robot = load_robot("denso_vp6242")
    no_friction = FrictionModel.from_terms((), robot.joint_names)
    names = [name for name in structural_base(robot, no_friction).names if name != "zz6"]
    odd = {name: Fraction(1, 10**380 + 2 * k + 1) for k, name in enumerate(names)}
    found = sdpid.audit_base_parameters(robot, {**odd, "zz6": -1}, "0.005")
    proof_ = found.certificate
    assert proof_.holds
    refuses(CertificateError, "fewer digits", proof_.to_json, tmp_path / "proof.json")
    assert not list(tmp_path.iterdir())
