"""Files of parameters read back as they were written, by us and by other libraries."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sdpid.errors import DataError, ExportError, MissingExtraError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import build_problem
from sdpid.output.tables.parameters_file import read_parameters, write_parameters
from sdpid.robot.model.load import load_robot
from tests.helpers.data import make_samples, random_theta
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE

HEAD = '{"format": "sdpid parameters", "version": 1'


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    robot, rng = load_robot(TREE), np.random.default_rng(3)
    theta = random_theta(robot, rng)
    samples = make_samples(robot, theta, rng, count=200, noise=0.01, block=10)
    problem = build_problem(robot, samples, weighting="residual")
    theta[3] = 1e-17  # a number that YAML writes with an exponent
    return Estimate.of_theta(problem, theta, method="sdp", status="optimal")


@pytest.mark.parametrize("suffix", [".json", ".yaml", ".yml"])
def test_round_trip(tmp_path: Path, estimate: Estimate, suffix: str) -> None:
    path = write_parameters(estimate, tmp_path / f"p{suffix}")
    assert read_parameters(path) == estimate.named_theta()
    assert list(read_parameters(path)) == list(estimate.problem.base.theta_names)
    # Of base parameters only, too.
    write_parameters(replace(estimate, theta=None, method="wls"), path)
    assert read_parameters(path) == estimate.named()


def test_what_stands_in_it(tmp_path: Path, estimate: Estimate) -> None:
    base = estimate.problem.base
    name = base.theta_names[-1]
    assert name in base.names
    ends = {"lower": np.array([-np.inf, 1.0]), "upper": np.array([2.0, 3.0])}
    given = SimpleNamespace(
        names=(base.names[0], name), kind=("base", "base"), method="profile", level=0.9, **ends
    )
    content = json.loads(
        write_parameters(estimate, tmp_path / "p.json", intervals=given).read_text()
    )
    assert content["robot"] == "tree"
    assert content["links"]["1"] == "column"
    assert content["interval_level"] == 0.9
    first = content["base"][base.names[0]]
    assert first["interval"] == [None, 2.0]
    assert first["unit"] == base.units[0]
    assert first["standard_error"] == estimate.standard_errors[0]
    assert content["standard"][name]["interval"] == [1.0, 3.0]
    mass = content["standard"]["m_1"]
    assert mass["interval"] is None
    assert sum(mass["shares"].values()) == pytest.approx(1.0)
    yaml = pytest.importorskip("yaml")
    same = write_parameters(estimate, tmp_path / "p.yaml", intervals=given)
    assert yaml.safe_load(same.read_text()) == content


def test_intervals_without_kinds_and_errors_without_rows(
    tmp_path: Path, estimate: Estimate
) -> None:
    given = SimpleNamespace(names=("m_1",), lower=np.array([1.0]), upper=np.array([2.0]))
    sent = replace(estimate, problem=estimate.problem.without_rows())
    content = json.loads(write_parameters(sent, tmp_path / "p.json", intervals=given).read_text())
    assert content["standard"]["m_1"]["interval"] == [1.0, 2.0]
    assert content["interval_method"] is None
    assert {entry["standard_error"] for entry in content["base"].values()} == {None}


def test_numbers_written_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(
        "format: sdpid parameters\nversion: 1\nstandard:\n  m_1: {value: 1e-5}\n  mx_1: 2\n"
    )
    assert read_parameters(path) == {"m_1": 1e-5, "mx_1": 2.0}


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("[1", "not JSON"),
        ("[" * 100000, "not JSON"),
        ("[]", "no file of parameters"),
        ('{"format": "sdpid parameters", "version": 2}', "version 2"),
        (HEAD + "}", "'base' holds no parameters"),
        (HEAD + ', "standard": {"m_1": {"value": "x"}}}', "standard, m_1: the value is 'x'"),
        (HEAD + ', "standard": {"m_1": {"value": NaN}}}', "m_1: the value is nan"),
        (HEAD + ', "base": {"b": null}}', "value is None"),
    ],
)
def test_files_that_are_none(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "p.json"
    path.write_text(text)
    refuses(DataError, match, read_parameters, path)


def test_other_refusals(
    tmp_path: Path, estimate: Estimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    words, lacking = r"\.json, \.yaml or \.yml", r"pip install .*\[yaml\]'"
    refuses(ExportError, words, write_parameters, estimate, tmp_path / "p.toml")
    refuses(DataError, r"cannot read .*absent", read_parameters, tmp_path / "absent.json")
    (tmp_path / "p.yaml").write_text("a: [1\nb: }")
    refuses(DataError, "not YAML", read_parameters, tmp_path / "p.yaml")
    monkeypatch.setitem(sys.modules, "yaml", None)
    refuses(MissingExtraError, lacking, write_parameters, estimate, tmp_path / "q.yaml")
    assert not (tmp_path / "q.yaml").exists()
