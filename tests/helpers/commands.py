"""The command `sdpid`, run in this process, as it ends well and as it is refused."""

from typing import Any

from typer.testing import CliRunner, Result

from sdpid import cli


def run(*arguments: Any) -> Result:
    """Return how a command ended, and what it printed."""
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


def ran(*arguments: Any) -> Result:
    """Return the same of a command that must end well."""
    done = run(*arguments)
    assert done.exit_code == 0, done.output
    return done


def refused(done: Result, status: int, *words: str) -> None:
    """Check an exit status and a message of one line, without a traceback."""
    assert done.exit_code == status, done.output
    assert done.stderr.startswith("sdpid: ")
    assert len(done.stderr.splitlines()) == 1
    assert "Traceback" not in done.output
    for word in words:
        assert word in done.stderr
