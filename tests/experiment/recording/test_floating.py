"""What a recording has of a floating base: checked when made, kept wherever rows are."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sdpid
from sdpid.assurance.log_proof.inputs import recording_digest
from sdpid.assurance.rollouts import setting
from sdpid.errors import DataError
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.recording import Recording, rows_of
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.refusals import refuses

N = 40


def base(**changes: Any) -> sdpid.BaseMotion:
    turns = Rotation.from_rotvec(np.linspace(0.0, 7.0, N)[:, None] * [0.2, 0.5, -0.8])
    rng = np.random.default_rng(0)
    given = {
        "orientation": turns.as_quat(canonical=True),
        "position": rng.standard_normal((N, 3)),
        "angular_velocity": rng.standard_normal((N, 3)),
        "velocity_frame": "world",
        "imu": sdpid.Imu(accelerometer=rng.standard_normal((N, 3)), translation=(0.1, 0.0, 0.0)),
    }
    return sdpid.BaseMotion(**{**given, **changes})


def contacts(**changes: Any) -> sdpid.Contacts:
    rng = np.random.default_rng(1)
    given = {
        "frames": ("left", "right"),
        "down": rng.random((N, 2)) > 0.5,
        "forces": rng.standard_normal((N, 2, 3)),
        "offset": (0.0, 0.0, -0.02),
    }
    return sdpid.Contacts(**{**given, **changes})


def log(**changes: Any) -> Recording:
    rng = np.random.default_rng(2)
    given = {
        "time": 0.01 * np.arange(N),
        "position": np.sin(0.05 * np.arange(N)[:, None] + [0.0, 1.0]),
        "effort": rng.standard_normal((N, 2)),
        "base": base(),
        "contacts": contacts(),
    }
    return Recording(**{**given, **changes})


def test_orientations_are_unit_quaternions_without_changes_of_sign() -> None:
    given = Rotation.from_rotvec(np.linspace(0.0, 7.0, N)[:, None] * [0.2, 0.5, -0.8])
    rounded = np.round(given.as_quat(canonical=True), 4)
    found = base(orientation=rounded)
    assert np.abs(np.linalg.norm(found.orientation, axis=1) - 1.0).max() < 1e-15
    assert np.einsum("ki,ki->k", found.orientation[1:], found.orientation[:-1]).min() > 0.9
    assert found.rotations == pytest.approx(given.as_matrix(), abs=2e-4)
    assert not found.orientation.flags.writeable


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: base(orientation=np.ones((N, 4))), "sample 1 has the norm 2.*off 1 by 1, limit"),
        (lambda: base(orientation=np.ones((N, 3))), r"\(40, 3\), expected \(N, 4\)"),
        (lambda: base(position=np.zeros((N - 1, 3))), "orientation 40, position 39"),
        (lambda: base(velocity_frame=None), "'world' or 'base': the axes of angular_velocity"),
        (lambda: base(angular_velocity=None), "without a velocity"),
        (lambda: base(imu=sdpid.Imu(gyroscope=np.zeros((3, 3)))), "base.imu: has 3 samples"),
        (lambda: sdpid.Imu(), "neither gyroscope nor accelerometer"),
        (lambda: sdpid.Imu(gyroscope=np.zeros((3, 3)), rotation=-np.eye(3)), "determinant is -1"),
        (lambda: contacts(frames=("a", "a")), "a is there more than once"),
        (lambda: contacts(kind="blob"), "'blob' is not known; known are point, line, plane"),
        (lambda: contacts(down=np.full((N, 2), 0.5)), "holds 0.5, expected True or False"),
        (lambda: contacts(forces=np.zeros((N, 2, 6))), r"expected \(N, 2, 3\)"),
        (lambda: contacts(wrenches=np.zeros((N, 2, 6))), "not both"),
        (lambda: contacts(down=None, forces=None), "nothing is known of contacts"),
        (lambda: contacts(offset=np.zeros((3, 3))), r"expected \(3,\) or \(2, 3\)"),
        (lambda: log(base=None), "contacts: are given without a base"),
        (lambda: log(contacts=contacts().rows(slice(5))), "contacts: has 5 samples"),
        (lambda: log(base=5), "base: is int, expected sdpid.BaseMotion"),
    ],
)
def test_what_cannot_be_is_refused(make: Any, message: str) -> None:
    refuses(DataError, message, make)


def test_one_kind_and_one_offset_are_those_of_all_contacts() -> None:
    assert contacts().kind == ("point", "point")
    assert contacts().offset.tolist() == [[0.0, 0.0, -0.02]] * 2
    assert repr(contacts(kind=("point", "plane"))) == (
        "Contacts(40 samples, 1 point, 1 plane, flags, forces)"
    )
    assert repr(log()).endswith("floating base with IMU, 2 contacts)")


def test_rows_of_a_recording_keep_base_and_contacts() -> None:
    whole = log()
    part = rows_of(whole, slice(10, 30))
    assert part.base.orientation.tobytes() == whole.base.orientation[10:30].tobytes()
    assert part.base.imu.translation.tolist() == [0.1, 0.0, 0.0]
    assert (part.contacts.down == whole.contacts.down[10:30]).all()
    late = whole.time + np.where(np.arange(N) < 20, 0.0, 1.0)
    pieces, _ = continuous(replace(whole, time=late))
    assert [piece.base.n_samples for piece in pieces] == [20, 20]


def test_the_digest_counts_base_and_contacts() -> None:
    digests = {
        recording_digest(log(**changes))
        for changes in (
            {},
            {"contacts": None},
            {"contacts": contacts(kind="plane")},
            {"base": base(position=None)},
            {"base": base(imu=None)},
        )
    }
    assert len(digests) == 5
    assert recording_digest(log()) in digests


def test_columns_in_files_carry_the_frame_of_velocities(tmp_path: Path) -> None:
    log().to_csv(tmp_path / "run.csv")
    header = (tmp_path / "run.csv").read_text().split("\n")[0].split(",")
    assert "base_angular_velocity_world_x" in header
    assert {"base_orientation_w", "accelerometer_z", "contact_left"} < set(header)
    assert "contact_force_right_z" in header


def commanded() -> Recording:
    return log(reference=np.zeros((N, 2)), joint_names=("a", "b"))


ARM = sdpid.load_robot(ARM_URDF)


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda: sdpid.controllers.fit_controller(commanded(), "pd"), "fit_controller"),
        (lambda: sdpid.identify_payload(ARM, commanded()), "payload"),
        (lambda: sdpid.identify_drive_gains(ARM, log(currents=True)), "gains"),
        (lambda: Twin.of(ARM, commanded()), "simulated motion"),
        (lambda: setting._prepared(ARM, commanded(), None), "rollout"),
    ],
)
def test_what_knows_fixed_robots_only_refuses_a_floating_base(call: Any, what: str) -> None:
    refuses(DataError, f"{what}.*this recording has a floating base", call)
