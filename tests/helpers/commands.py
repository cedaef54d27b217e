"""The command `sdpid`, as it ends well and as it is refused, and the stand-alone verifier."""

import json
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

from typer import testing
from typer.testing import CliRunner, Result

from sdpid import cli, verifier
from sdpid.cli.commands import Given, Table, rows_of
from tests.helpers.arm_files import write_arm

VERIFIER = Path(verifier.__file__).parent

# Typer would make all commands anew for each line.
testing._get_command = cache(testing._get_command)


def run(*arguments: Any) -> Result:
    """Return how a command ended, and what it printed."""
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


def given(*tables: Table, **values: Any) -> Given:
    """Return what a command with some options gets where only these are given."""
    return Given(rows_of(*tables), values)


def ran(*arguments: Any) -> Result:
    """Return the same of a command that must end well."""
    done = run(*arguments)
    assert done.exit_code == 0, done.output
    return done


def printed(*arguments: Any, status: int = 0) -> str:
    """Return what a command prints that ends with a status; of a failure, its error as well."""
    done = run(*arguments)
    assert done.exit_code == status, done.output
    return done.stdout if status == 0 else done.output


def told(*arguments: Any) -> Any:
    """Return what a command that ends well prints as JSON."""
    return json.loads(printed(*arguments, "--json"))


def refused(done: Result, status: int, *words: str) -> None:
    """Check an exit status and a message of one line, without a traceback."""
    assert done.exit_code == status, done.output
    assert done.stderr.startswith("sdpid: ")
    assert len(done.stderr.splitlines()) == 1
    assert "Traceback" not in done.output
    for word in words:
        assert word in done.stderr


def python(*arguments: Any, **options: Any) -> subprocess.CompletedProcess[str]:
    """Return how a fresh interpreter ended, and what it printed."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, **options)


def with_results(folder: Path) -> Path:
    """Write a robot, its log, and the results of a run into a folder, and return it."""
    write_arm(folder, joint_names=["a", "b"])
    given = (folder / "log.npz", "--robot", folder / "arm.urdf", "--out", folder / "results")
    ran("identify", *given, "--no-figures", "--no-intervals", "--effects", "none")
    return folder


def alone(path: Path, folder: Path = VERIFIER, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the verifier, or a copy, where nothing but the standard library can be imported."""
    return python("-I", "-S", folder, path, **options)
