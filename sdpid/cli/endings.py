"""How the command ends: errors in a line, signals without leftovers, exit statuses."""

from __future__ import annotations

import errno
import shlex
import traceback
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from sdpid._common.files import printable
from sdpid._common.signals import end_if_signaled
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
    "missing": "--missing drop|interpolate",
    "without_effort": "--without-effort A,B,...",
    "accept": "--accept KIND",
}

# Stands in help texts for the names of all friction terms.
TERMS = "{terms}"

# Where a context keeps its arguments.
_ARGUMENTS = "sdpid.arguments"


class Command(TyperCommand):
    """A command; its help names the friction terms, which ``sdpid --help`` need not load."""

    def make_context(self, *args: Any, **more: Any) -> Any:
        """Put the names into the help of the options that take friction terms."""
        for each in self.params:
            text = getattr(each, "help", None) or ""
            if TERMS in text:
                from sdpid.robot.friction.terms import BY_NAME

                each.help = text.replace(TERMS, ", ".join(BY_NAME))  # type: ignore[attr-defined]
        return super().make_context(*args, **more)


class Commands(TyperGroup):
    """The group of commands: turns every error into a line on stderr and an exit status."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Keep the arguments as they were given, for `command_line`."""
        ctx.meta[_ARGUMENTS] = list(args)
        return super().parse_args(ctx, args)

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
            complain(" ".join(message(error).split()))
            raise typer.Exit(exit_status(error)) from None


def complain(text: str) -> None:
    """Print one line on stderr, without what damaged files bring into it: escapes, reams."""
    shown = printable(text)
    typer.echo(f"sdpid: {shown[:_LONGEST]}{' ...' * (len(shown) > _LONGEST)}", err=True)


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
