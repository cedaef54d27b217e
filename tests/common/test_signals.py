"""Interrupts: noted where an exception would be lost, raised where it is caught."""

import os
import signal
import subprocess
import sys

import pytest

from sdpid._common.signals import Interrupts, noted_interrupts

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


def test_a_signal_that_an_import_swallows_ends_the_program_later() -> None:
    code = """
import os, signal
from sdpid._common.signals import clean_up_when_ended, end_if_signaled
clean_up_when_ended()
try:
    os.kill(os.getpid(), signal.SIGTERM)
except BaseException:
    print("swallowed", flush=True)
end_if_signaled()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout) == (128 + signal.SIGTERM, "swallowed\n")
