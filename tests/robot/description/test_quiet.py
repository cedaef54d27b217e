"""What a parser prints on file descriptor 2 is part of the error, and nowhere else."""

import os
import threading

import pytest

import sdpid
from sdpid.errors import ModelError
from sdpid.robot.description.quiet import caught_stderr
from tests.helpers.arm_files import ARM_URDF


def test_the_parser_of_urdf_is_quoted(capfd: pytest.CaptureFixture[str]) -> None:
    bad = ARM_URDF.replace('effort="100"', 'effort="many"')
    with pytest.raises(ModelError, match=r"joint \[a\]: effort value \(many\)") as caught:
        sdpid.load_robot(bad)
    assert "at line" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_text_is_caught_on_failure_and_passed_on_else(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="no"), caught_stderr() as said:  # noqa: PT012
        os.write(2, b"two\nlines \xff")
        raise ValueError("no")
    assert said.text == "two lines \ufffd"
    assert capfd.readouterr().err == ""
    with caught_stderr() as said:
        os.write(2, b"a warning\n")
    assert said.text == ""
    assert capfd.readouterr().err == "a warning\n"


def test_threads_take_turns(capfd: pytest.CaptureFixture[str]) -> None:
    found: dict[int, str] = {}

    def fail(number: int) -> None:
        try:
            with caught_stderr() as said:
                os.write(2, f"{number} ".encode() * 50)
                raise ValueError
        except ValueError:
            found[number] = said.text

    threads = [threading.Thread(target=fail, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {number: set(text.split()) for number, text in found.items()} == {
        number: {str(number)} for number in range(8)
    }
    assert capfd.readouterr().err == ""
