"""How the command ends: errors in a line, signals without leftovers, exit statuses."""

from __future__ import annotations

import errno
import shlex
import signal
import sys
import traceback
from typing import Any

import typer
from typer.core import TyperGroup

from sdpid._files import end_by, end_if_told
from sdpid.errors import IdentifiabilityError, InfeasibleError, SdpidError, SolverError

# Exit statuses.
OURS, BAD_INPUT, NO_ANSWER, INTERRUPTED = 1, 2, 3, 130
# Characters of a message; more do not help.
_LONGEST = 4000

# Arguments of the library that messages name, as options.
_OPTIONS = {
    "columns": "--column QUANTITY=NAME",
    "units": "--unit QUANTITY=UNIT",
    "joint_names": "--joint-names A,B,...",
    "mapping": "--mapping FILE (none: ignore the one beside the log)",
    "topic": "--topic NAME",
}

# Where a context keeps its arguments.
_ARGUMENTS = "sdpid.arguments"


class Commands(TyperGroup):
    """The commands, with one way out for every error."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Keep the arguments as they were given, for `command_line`."""
        ctx.meta[_ARGUMENTS] = list(args)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run a command; turn an error into one line on stderr and an exit status."""
        try:
            done = super().invoke(ctx)
            end_if_told()
            return done
        except KeyboardInterrupt:
            raise typer.Exit(INTERRUPTED) from None
        except Exception as error:
            end_if_told()  # what a signal interrupts may turn it into an error of its own
            # Typer's own (usage, exit, abort) are Typer's to show; so is a closed pipe.
            own = type(error).__module__.split(".")[0] in ("typer", "click")
            if own or (isinstance(error, OSError) and error.errno == errno.EPIPE):
                raise
            if ctx.params.get("debug"):
                traceback.print_exception(error)
            typer.echo(f"sdpid: {_one_line(message(error))}", err=True)
            raise typer.Exit(exit_status(error)) from None


def _one_line(text: str) -> str:
    """Return a message without what damaged files bring into it: ends of lines, escapes, reams."""
    shown = "".join(c if c.isprintable() or c.isspace() else "\ufffd" for c in text)
    shown = " ".join(shown.split())
    return shown if len(shown) <= _LONGEST else f"{shown[:_LONGEST]} ..."


def clean_up_when_ended() -> None:
    """Let signals that end a program raise SystemExit, so that unfinished files are removed.

    Ctrl-C does so too: where a KeyboardInterrupt came amid the import of an extension module, the
    interpreter was now and then seen to end by the signal itself, with another exit status.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        # What the caller had ignored (nohup) stays so; Windows has no SIGHUP.
        number = getattr(signal, name, None)
        usual = (signal.SIG_DFL, signal.default_int_handler)
        if number is not None and signal.getsignal(number) in usual:
            signal.signal(number, end_by)
    usual_hook = sys.unraisablehook

    def hook(found: Any) -> None:
        # What ends the program cannot leave a callback that it came amid, such as those of the
        # import system; `end_if_told` ends the program then, and there is nothing to say.
        if not issubclass(found.exc_type, SystemExit):
            usual_hook(found)

    sys.unraisablehook = hook


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
    """Return what is said about an error."""
    if isinstance(error, SdpidError):
        text = str(error)
        # Messages speak Python; say how the same is said here.
        hints = [option for argument, option in _OPTIONS.items() if f"{argument}=" in text]
        return f"{text} On the command line: {', '.join(hints)}." if hints else text
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}."
    return (
        f"unexpected {type(error).__name__}: {error}. Please report this, with the traceback that "
        "`sdpid --debug ...` prints."
    )
