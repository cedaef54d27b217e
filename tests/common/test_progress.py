"""A progress bar is drawn where it can be taken back, and nowhere else."""

import io

import pytest

from sdpid._common.progress import progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("variable", "value", "drawn"),
    [("TERM", "xterm", True), ("TERM", "dumb", False), ("JPY_PARENT_PID", "1", False)],
)
def test_a_bar_only_on_a_terminal_that_draws(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str, drawn: bool
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("JPY_PARENT_PID", raising=False)
    monkeypatch.setenv(variable, value)
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with progress(2.0, "working") as advance:
        advance(1.0)
    assert ("working" in terminal.getvalue()) is drawn
