"""Logs of positions and commands, as robots without torque sensors leave them."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sdpid.errors import DataError
from sdpid.experiment.readers.formats.ros_bag import register
from sdpid.experiment.readers.read import read_recording
from tests.helpers.logs import DQ, TAU, Q, T, write_csv
from tests.helpers.refusals import refuses
from tests.helpers.torch_files import Stored, write_torch

N, JOINTS = len(T), ("up", "down")
TOLD = Q + 0.01
KD = 1.5


def recorded(folder: Path, messages: Any, *, mcap: bool = True) -> Path:
    """Write a bag of topics, kinds and messages, (N,) or fewer each: with definitions, or not."""
    from rosbags import typesys
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    register(typesys, store)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(folder / "bag", version=9, storage_plugin=plugin) as out:
        for topic, kind, late, made in messages:
            where = out.add_connection(topic, kind, typestore=store)
            for k in range(N):
                message = made(store, k)
                when = round(1e9 * (T[k] + late)) + 10**18
                if message is not None:
                    out.write(where, when, store.serialize_cdr(message, kind))
    if not mcap:
        # As recorders before 2023 left it.
        import sqlite3

        file = next((folder / "bag").glob("*.db3"))
        with sqlite3.connect(file) as data:
            data.execute("DELETE FROM message_definitions")
    return folder / "bag"


def filled(store: Any, kind: str, **given: Any) -> Any:
    """Return a message whose fields are zero or empty but for those given."""

    def value(told: Any) -> Any:
        what, of = told
        if what == 1:
            return {"string": "", "bool": False}.get(of[0], 0)
        if what == 2:
            return filled(store, of)
        inner, count = of
        if inner[0] == 2:
            return [filled(store, inner[1]) for _ in range(count)]
        return [] if inner[1][0] == "string" else np.zeros(count, inner[1][0])

    fields = store.fielddefs[kind][1]
    return store.types[kind](**{n: given[n] if n in given else value(t) for n, t in fields})


def point(store: Any, **given: Any) -> Any:
    return filled(store, "trajectory_msgs/msg/JointTrajectoryPoint", **given)


CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
DYNAMIC = "control_msgs/msg/DynamicJointState"


def controller(store: Any, k: int) -> Any:
    measured = point(store, positions=Q[k], velocities=DQ[k])
    return filled(
        store,
        CONTROLLER,
        joint_names=list(JOINTS),
        reference=point(store, positions=TOLD[k]),
        feedback=measured,
        output=point(store, effort=TAU[k]),
    )


def dynamic(store: Any, k: int) -> Any:
    def values(**of: float) -> Any:
        kind = store.types["control_msgs/msg/InterfaceValue"]
        return kind(interface_names=list(of), values=np.array([*of.values()]))

    rows = [values(velocity=DQ[k, j], position=Q[k, j], effort=TAU[k, j]) for j in range(2)]
    names = [*JOINTS, "wrist_sensor"]
    return filled(store, DYNAMIC, joint_names=names, interface_values=[*rows, values(force=1.0)])


def motors(store: Any, kind: str, k: int, count: int) -> Any:
    """Return states or commands of motors, of which the first two are used."""
    package, name = kind.split("/msg/Low")
    rows = {"q": Q, "dq": DQ, "tau_est": TAU}
    if name == "Cmd":
        # A commanded velocity adds kd times it to the effort beside the law's.
        rows = {"q": TOLD, "dq": DQ, "kd": np.full_like(Q, KD), "tau": TAU}
    made = [
        filled(store, f"{package}/msg/Motor{name}", **{n: row[k, j] for n, row in rows.items()})
        if j < 2
        else filled(store, f"{package}/msg/Motor{name}")
        for j in range(count)
    ]
    return filled(store, kind, **{f"motor_{name.lower()}": made})


def low(package: str, count: int, topic: str = "/lowstate") -> list[Any]:
    """Return states, and commands of every second sample from the third on, 1 ms before."""
    state, command = (f"{package}/msg/Low{name}" for name in ("State", "Cmd"))

    def told(store: Any, k: int) -> Any:
        return motors(store, command, k, count) if k >= 2 and k % 2 == 0 else None

    return [
        (topic, state, 0.0, lambda store, k: motors(store, state, k, count)),
        ("/lowcmd", command, -1e-3, told),
    ]


@pytest.mark.parametrize("mcap", [True, False])
@pytest.mark.parametrize(("kind", "made"), [(CONTROLLER, controller), (DYNAMIC, dynamic)])
def test_states_of_controllers(tmp_path: Path, kind: str, made: Any, mcap: bool):
    log = read_recording(recorded(tmp_path, [("/arm/state", kind, 0.0, made)], mcap=mcap))
    assert log.joint_names == JOINTS
    for found, truth in ((log.position, Q), (log.velocity, DQ), (log.effort, TAU)):
        np.testing.assert_array_equal(found, truth)
    if kind == CONTROLLER:
        np.testing.assert_array_equal(log.reference, TOLD)
    else:
        assert log.reference is None


@pytest.mark.parametrize("mcap", [True, False])
@pytest.mark.parametrize(("package", "count"), [("unitree_go", 20), ("unitree_hg", 35)])
def test_states_and_commands_of_motors(tmp_path: Path, package: str, count: int, mcap: bool):
    slow = ("/lf/lowstate", f"{package}/msg/LowState", 0.0, lambda store, k: None)
    bag = recorded(tmp_path, [slow, *low(package, count)], mcap=mcap)
    log = read_recording(bag, joint_names=JOINTS)
    rows = np.arange(2, N)
    assert log.joint_names == JOINTS
    np.testing.assert_allclose(log.time - log.time[0], T[rows] - T[2], atol=1e-8)
    for found, truth in ((log.position, Q), (log.velocity, DQ), (log.effort, TAU)):
        np.testing.assert_allclose(found, truth[rows], rtol=1e-6)
    # Each command holds until the next.
    at = 2 * (rows // 2)
    np.testing.assert_allclose(log.reference, TOLD[at], rtol=1e-6)
    np.testing.assert_allclose(log.feedforward, (TAU + KD * DQ)[at], rtol=1e-5, atol=1e-6)


def test_motors_of_quadrupeds_have_names(tmp_path: Path):
    bag = recorded(tmp_path, low("unitree_go", 20)[:1])
    log = read_recording(bag)
    assert log.joint_names[:4] == (
        "FR_hip_joint",
        "FR_thigh_joint",
        "FR_calf_joint",
        "FL_hip_joint",
    )
    assert log.n == 12
    turned = read_recording(bag, joint_names=["FR_thigh_joint", "FR_hip_joint"])
    np.testing.assert_allclose(turned.position, Q[:, ::-1], rtol=1e-6)
    assert turned.reference is None


def test_topic_picks_among_messages(tmp_path: Path):
    topics = [("/arm/state", CONTROLLER, 0.0, controller), *low("unitree_hg", 35)]
    bag = recorded(tmp_path, topics)
    assert read_recording(bag).joint_names == JOINTS
    assert read_recording(bag, topic="/lowstate").n == 35
    refuses(DataError, "no topic /arm with sensor_msgs", read_recording, bag, topic="/arm")


@pytest.mark.parametrize(
    "columns",
    [
        ("/lowstate/motor_state[{}]/q", ".tau_est", ".dq", "/lowcmd/motor_cmd[{}]/q", ".tau"),
        ("motor_state_{}_q", "_tau_est", "_dq", "motor_cmd_{}_q", "_tau"),
        ("motor_state.{}.q", ".tau_est", ".dq", "motor_cmd.{}.q", ".tau"),
    ],
)
def test_columns_of_motors(tmp_path: Path, columns: tuple[str, ...]):
    state, command = columns[0].removesuffix("q")[:-1], columns[3].removesuffix("q")[:-1]
    mark = columns[0].removesuffix("q")[-1]
    named = [(state, "ddq"), (state, "q"), (state, "q_raw"), (state, "tau_est"), (state, "dq")]
    named += [(command, "dq"), (command, "kp"), (command, "q"), (command, "tau")]
    names = [f"{whole.format(j)}{mark}{part}" for whole, part in named for j in range(2)]
    tables = (TAU, Q, 7.0 * DQ, TAU, DQ, 0.0 * Q, 20.0 + 0.0 * Q, TOLD, 2.0 * TAU)
    log = read_recording(write_csv(tmp_path / "log.csv", ["__time", *names], T, *tables))
    truths = (Q, TAU, DQ, TOLD, 2.0 * TAU)
    every = (log.position, log.effort, log.velocity, log.reference, log.feedforward)
    for found, truth in zip(every, truths, strict=True):
        np.testing.assert_array_equal(found, truth)


@pytest.mark.parametrize("newer", [True, False])
def test_columns_of_controllers(tmp_path: Path, newer: bool):
    told, measured = ("reference", "feedback") if newer else ("desired", "actual")
    rows = {f"{told}/positions": TOLD, f"{told}/velocities": 0.0 * Q, f"{measured}/positions": Q}
    rows |= {f"{measured}/velocities": DQ, "error/positions": TOLD - Q, "output/effort": TAU}
    names = [f"/arm_controller/state/{name}[{j}]" for name in rows for j in range(2)]
    file = write_csv(tmp_path / "log.csv", ["__time", *names], T, *rows.values())
    log = read_recording(file)
    every = (log.position, log.effort, log.velocity, log.reference)
    for found, truth in zip(every, (Q, TAU, DQ, TOLD), strict=True):
        np.testing.assert_array_equal(found, truth)
    # Names that are given win.
    where = [name for name in names if f"{told}/velocities" in name]
    other = read_recording(file, columns={"effort": where})
    np.testing.assert_array_equal(other.effort, 0.0 * Q)


def test_a_column_commanded_is_the_reference(tmp_path: Path):
    names = ["t", *(f"{name}_{j}" for name in ("q", "commanded") for j in (1, 2))]
    log = read_recording(write_csv(tmp_path / "log.csv", names, T, Q, TOLD))
    np.testing.assert_array_equal(log.reference, TOLD)
    assert log.effort is None


def pace(**changes: Any) -> dict[str, Any]:
    """Return what PACE logs."""
    single = {"time": T, "dof_pos": Q, "des_dof_pos": TOLD}
    stored = {n: Stored(x.astype("f4"), "FloatStorage") for n, x in single.items()}
    return {**stored, **changes}


def test_a_file_of_pace(tmp_path: Path):
    log = read_recording(write_torch(tmp_path / "chirp.pt", pace(), byteorder=b"little"))
    np.testing.assert_allclose(log.time, T, atol=1e-6)
    np.testing.assert_array_equal(log.position, Q.astype("f4"))
    np.testing.assert_array_equal(log.reference, TOLD.astype("f4"))
    assert log.effort is None


def test_tensors_of_other_kinds(tmp_path: Path):
    content = pace(
        dof_pos=Stored(np.asfortranarray(Q), "DoubleStorage"),
        dof_vel=Stored(DQ.astype("f2"), "HalfStorage"),
        joint_names=list(JOINTS),
        single=["one"],
        effort=Stored(TAU, "DoubleStorage"),
        more=OrderedDict(note="a log", rate=100.0),
    )
    content["more"]["itself"] = content
    log = read_recording(write_torch(tmp_path / "log.pt", content))
    assert log.joint_names == JOINTS
    np.testing.assert_array_equal(log.position, Q)
    np.testing.assert_array_equal(log.velocity, DQ.astype("f2"))
    np.testing.assert_array_equal(log.effort, TAU)


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return pytest.fail, ("a pickle was executed",)


@pytest.mark.parametrize(
    ("content", "extra", "words"),
    [
        (pace(more=Bomb()), {}, r"holds _pytest.*, which is never run"),
        (pace(more=np.zeros(2)), {}, r"holds numpy.*_reconstruct, which is never run"),
        (pace(more={1, 2}), {}, r"holds __builtin__\.set, which is never run"),
        (pace(time=Stored(T, "BFloat16Storage")), {}, r"holds torch\.BFloat16Storage"),
        (pace(), {"byteorder": b"big"}, "big-endian"),
        (pace(time=Stored(T, "DoubleStorage", offset=1)), {}, "'time' claims more numbers than"),
        (pace(time=Stored(T, "DoubleStorage", size=(-1,))), {}, r"a tensor of the size \(-1,\)"),
        (pace(time=Stored(T, "DoubleStorage", size=(10**12,))), {}, "claims"),
        ({"a": None}, {}, "holds no tensors"),
        (b"\x80\x02}(u.", {}, "holds no tensors"),
        (b"\x80\x02(.", {}, "not a readable PyTorch file"),
        (b"\x80\x02h\x07.", {}, "not a readable PyTorch file"),
        (b"\x80\x02}(K\x01K\x02u.", {}, "an? int in place of a name"),
        (b"cos\nsystem\n(S'true'\ntR.", {}, r"holds os\.system, which is never run"),
        (b"\x80\x02X\x01\x00\x00\x00a)R.", {}, "a call with other arguments"),
    ],
)
def test_what_is_refused_of_torch(tmp_path: Path, content: Any, extra: Any, words: str):
    refuses(DataError, words, read_recording, write_torch(tmp_path / "log.pt", content, **extra))
