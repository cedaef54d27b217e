"""Interrupts: noted where an exception would be lost, raised where it is caught."""

import os
import signal

import pytest

from sdpid._common.signals import Interrupts, end_by, keyboard_interrupts, noted_interrupts

pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="sends signals"),
    pytest.mark.usefixtures("interruptible"),
]


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def test_the_first_is_noted_and_the_second_raises() -> None:
    noted = Interrupts()
    with noted_interrupts(noted):
        assert not noted.came
        interrupt()
        assert noted.came
        with pytest.raises(KeyboardInterrupt):
            interrupt()
    with pytest.raises(KeyboardInterrupt):
        interrupt()


def test_the_command_raises_where_work_can_be_stopped() -> None:
    signal.signal(signal.SIGINT, end_by)
    with pytest.raises(KeyboardInterrupt), keyboard_interrupts():
        interrupt()
    assert signal.getsignal(signal.SIGINT) is end_by
    noted = Interrupts()
    with noted_interrupts(noted):  # not ours to change
        assert signal.getsignal(signal.SIGINT) is end_by
