"""Files that were read are known by the SHA-256 of their bytes."""

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest

import sdpid
from sdpid._common.files import Source, load_toml, unchanged
from sdpid.assurance.tables.csv_table import read_base_table
from sdpid.errors import DataError, ModelError
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
from sdpid.robot.description.xml import read_description
from tests.helpers.refusals import refuses


def test_a_file_has_the_digest_of_its_bytes(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    file.write_bytes(b"t,q1\n" * 1000)
    found = Source.of(file)
    assert (found.name, found.size) == ("run.csv", 5000)
    assert found.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    assert found == Source.of_bytes(file.read_bytes(), "run.csv")


def test_a_folder_counts_the_names_and_bytes_of_its_files(tmp_path: Path) -> None:
    for number in range(2):
        folder = tmp_path / str(number)
        (folder / "deeper").mkdir(parents=True)
        (folder / "a.db3").write_bytes(b"1")
        (folder / "deeper" / "b.db3").write_bytes(b"23")
    first, second = (Source.of(tmp_path / name) for name in "01")
    assert first.sha256 == second.sha256
    assert first.size == 3
    (tmp_path / "1" / "a.db3").rename(tmp_path / "1" / "c.db3")
    assert Source.of(tmp_path / "1").sha256 != first.sha256


@pytest.mark.parametrize(
    ("read", "error"),
    [
        (load_toml, DataError),
        (sdpid.read_parameters, DataError),
        (read_base_table, DataError),
        (true_parameters, DataError),
        (WholeBodyMotion.from_csv, DataError),
        (read_description, ModelError),
    ],
)
def test_files_are_read_up_to_a_size_and_devices_not_at_all(
    tmp_path: Path, read: Callable[[Path], object], error: type[sdpid.errors.SdpidError]
) -> None:
    endless, large = tmp_path / "endless.json", tmp_path / "large.json"
    endless.symlink_to("/dev/zero")
    with large.open("wb") as file:
        file.truncate(2**28 + 2)
    if read is true_parameters:
        for name in ("endless", "large"):
            (tmp_path / name).mkdir()
            (tmp_path / name / "true_parameters.csv").symlink_to(tmp_path / f"{name}.json")
        endless, large = tmp_path / "endless", tmp_path / "large"
    refuses(error, "no regular file", read, endless)
    refuses(error, r"has more than .* bytes, which are read at most", read, large)


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    file.write_bytes(b"1")
    with unchanged(file):
        pass
    with pytest.raises(DataError, match=r"run\.csv: changed while it was read"), unchanged(file):
        file.write_bytes(b"12")
