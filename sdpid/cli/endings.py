"""How the command ends: errors in a line, signals without leftovers, exit statuses."""

from __future__ import annotations

import contextlib
import errno
import os
import shlex
import sys
import traceback
from typing import Any

import typer
from typer.core import TyperGroup

from sdpid._common.signals import end_if_signaled
from sdpid._common.text import printable
from sdpid.errors import IdentifiabilityError, InfeasibleError, SdpidError, SolverError

# Exit statuses.
OURS, BAD_INPUT, NO_ANSWER, INTERRUPTED = 1, 2, 3, 130
# Errors of a disk that takes no more.
_FULL = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC), errno.EFBIG, errno.EIO)
# Characters of a message; more do not help.
_LONGEST = 4000

# Arguments of the library that messages name, as options.
_OPTIONS = {
    "columns": "--column QUANTITY=NAME",
    "units": "--unit QUANTITY=UNIT",
    "joint_names": "--joint-names A,B,...",
    "mapping": "--mapping FILE (none: ignore the one beside the log)",
    "topic": "--topic NAME",
    "missing": "--missing drop|interpolate",
    "accept": "--accept KIND",
}

# Where a context keeps its arguments.
_ARGUMENTS = "sdpid.arguments"


class Commands(TyperGroup):
    """The group of commands: turns every error into a line on stderr and an exit status."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Keep the arguments as they were given, for `command_line`."""
        ctx.meta[_ARGUMENTS] = list(args)
        try:
            return super().parse_args(ctx, args)
        except OSError as error:  # of --help and --version, which print at once
            if error.errno == errno.EPIPE:
                raise
            _drop_output()
            _say(_lost(error))
            raise typer.Exit(OURS) from None

    def invoke(self, ctx: Any) -> Any:
        """Run a command; turn an error into one line on stderr and an exit status."""
        try:
            done = super().invoke(ctx)
            end_if_signaled()
            return done
        except KeyboardInterrupt:
            raise typer.Exit(INTERRUPTED) from None
        except Exception as error:
            end_if_signaled()  # what a signal interrupts may turn it into an error of its own
            # Typer shows usage errors and handles exits, aborts and a closed pipe itself.
            from_typer = type(error).__module__.split(".")[0] in ("typer", "click")
            if from_typer or (isinstance(error, OSError) and error.errno == errno.EPIPE):
                raise
            if ctx.params.get("debug"):
                traceback.print_exception(error)
            if isinstance(error, OSError) and _is_output_full(error):
                _drop_output()
                _say(_lost(error))
                raise typer.Exit(OURS) from None
            _say(message(error))
            raise typer.Exit(exit_status(error)) from None


def _say(text: str) -> None:
    """Print one line on stderr."""
    typer.echo(f"sdpid: {_one_line(text)}", err=True)


def _lost(error: OSError) -> str:
    return (
        f"cannot write to standard output: {error.strerror or error}; make room, or send it "
        "elsewhere."
    )


def _is_output_full(error: OSError) -> bool:
    """Return whether an error is of standard output: of no file, and one more line fails too."""
    if error.filename is not None or error.errno not in _FULL:
        return False
    try:
        sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError:
        return True
    return False


def _drop_output() -> None:
    """Drop what waits for standard output: else Python tries again when it ends."""
    with contextlib.suppress(OSError):  # no file, as in tests
        number = sys.stdout.fileno()
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, number)
        os.close(null)


def _one_line(text: str) -> str:
    """Return a message without what damaged files bring into it: ends of lines, escapes, reams."""
    shown = printable(" ".join(text.split()))
    return shown if len(shown) <= _LONGEST else f"{shown[:_LONGEST]} ..."


def open_standard_streams() -> None:
    """Open the null device in place of every standard stream that is closed, as for daemons.

    Else the next file that is opened becomes standard error, and whatever a library prints goes
    into it.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            # Opening takes the lowest number that is free: this one.
            os.open(os.devnull, os.O_RDWR)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115


def command_line(ctx: typer.Context) -> str:
    """Return the command as it was given, for a shell."""
    return shlex.join(["sdpid", *ctx.meta.get(_ARGUMENTS, ())])


def exit_status(error: Exception) -> int:
    """Return the exit status of an error."""
    if isinstance(error, (InfeasibleError, IdentifiabilityError)):
        return NO_ANSWER
    if isinstance(error, SolverError):
        return OURS
    return BAD_INPUT if isinstance(error, (SdpidError, OSError)) else OURS


def message(error: Exception) -> str:
    """Return the message of an error for the command line."""
    if isinstance(error, SdpidError):
        text = str(error)
        # Messages name arguments of the library; add the options that set them, where the message
        # does not.
        hints = [
            option
            for argument, option in _OPTIONS.items()
            if f"{argument}=" in text and f"{option.split()[0]} " not in text
        ]
        return f"{text} On the command line: {', '.join(hints)}." if hints else text
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}."
    return (
        f"unexpected {type(error).__name__}: {error}. Please report this, with the traceback that "
        "`sdpid --debug ...` prints."
    )
