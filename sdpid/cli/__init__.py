"""The command ``sdpid``: from a robot and a log file to files one can use.

Heavy libraries are imported inside the commands, so that ``sdpid --help`` answers at once.
"""

from __future__ import annotations

import gc
import os
from typing import Annotated

import typer

from sdpid._common.signals import clean_up_when_ended
from sdpid.cli.endings import Command, Commands
from sdpid.cli.excite import excite
from sdpid.cli.identify import certify, compare, identify, validate
from sdpid.cli.info import info, robots
from sdpid.cli.judge import audit, compare_runs, verify
from sdpid.cli.loads import gains, payload
from sdpid.cli.sample import sample
from sdpid.cli.simulate import simulate

# New objects after which cycles of them are looked for; the default is 700.
_NEW_OBJECTS = 100_000

app = typer.Typer(
    cls=Commands,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    help="Robot dynamics identification: physically consistent, globally optimal, and proven so.",
    epilog="Exit status: 0 done, 2 bad input, 3 infeasible, not identifiable or not realisable, "
    "1 our failure or a proof that does not hold.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from sdpid import __version__

        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def common(
    debug: Annotated[
        bool, typer.Option("--debug", envvar="SDPID_DEBUG", help="Print tracebacks of errors.")
    ] = False,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """Declare the options that stand before a command."""


for command in (
    *(identify, excite, info, robots, validate, compare, compare_runs, simulate, gains, payload),
    *(audit, certify, verify, sample),
):
    app.command(cls=Command)(command)


def main() -> None:
    """Run the command."""
    clean_up_when_ended()
    # While libraries load, the default looks for cycles hundreds of times, and finds none: a
    # twentieth of a run.
    gc.set_threshold(_NEW_OBJECTS)
    # Nothing is drawn by MuJoCo here. Else it imports glfw, which asks child processes for
    # versions; they print a traceback where a signal ends this process before it has asked.
    os.environ["MUJOCO_GL"] = "disable"
    app(prog_name="sdpid")
