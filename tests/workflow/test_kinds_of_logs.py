"""Logs as data frames, joints without effort, and arguments of another kind."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

import sdpid
from sdpid.errors import DataError
from sdpid.workflow.formulate import formulate
from tests.helpers.refusals import refuses
from tests.helpers.runs import arm, recorded


def frame_of(log: sdpid.Recording) -> pd.DataFrame:
    columns = {"time": log.time}
    for quantity in ("position", "effort"):
        table = getattr(log, quantity)
        columns |= {f"{quantity}_{name}": table[:, j] for j, name in enumerate(log.names)}
    return pd.DataFrame(columns)


@pytest.fixture(scope="module")
def log() -> sdpid.Recording:
    return recorded(1)


def test_a_data_frame_is_one_log(log: sdpid.Recording) -> None:
    frame = frame_of(log)
    plain = formulate(arm(), log).samples
    for given in (frame, [frame]):
        np.testing.assert_array_equal(formulate(arm(), given).samples.effort, plain.effort)


def test_a_joint_left_out_may_lack_every_effort(log: sdpid.Recording) -> None:
    last = log.names[-1]
    frame = frame_of(log)
    frame[f"effort_{last}"] = np.nan
    with pytest.raises(DataError, match=r"no value in any row; leave .* with without_effort="):
        sdpid.read_recording(frame)
    with pytest.raises(DataError, match="no value in any row"):
        formulate(arm(), frame, without_effort=[log.names[0]])
    problem = formulate(arm(), frame, without_effort=[last])
    expected = formulate(arm(), log, without_effort=[last])
    assert not problem.samples.mask[:, -1].any()
    np.testing.assert_array_equal(problem.samples.effort[:, :-1], expected.samples.effort[:, :-1])
    read = sdpid.read_recording(frame, without_effort=[last])
    assert not read.effort[:, -1].any()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("constraints", 3),
        ("prior", "yes"),
        ("validation", 3),
        ("log", 3),
        ("log", None),
        ("without_effort", 3),
    ],
)
def test_arguments_of_another_kind_are_refused_by_name(
    log: sdpid.Recording, name: str, value: Any
) -> None:
    arguments: dict[str, Any] = {"log": log, name: value}
    refuses(DataError, f"^{name}: is ", sdpid.identify, arm(), **arguments)


def test_process_takes_recordings_only() -> None:
    given: Any = "base.csv"
    refuses(DataError, r"log: is 'base.csv'.*read_recording", sdpid.process, given)


def test_seeds_are_checked() -> None:
    robot = sdpid.load_robot("denso_vp6242")
    refuses(DataError, "seed: is -1", sdpid.simulate, robot, seed=-1)
    refuses(DataError, "seed: is -1", sdpid.paper_excitation, "denso_vp6242", -1)
