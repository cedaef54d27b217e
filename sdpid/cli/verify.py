"""The command ``sdpid verify``: a proof, checked from its file alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdpid._common.text import printable
from sdpid.cli.endings import OURS
from sdpid.cli.printing import Printing


def verify(
    certificate: Annotated[
        Path, typer.Argument(metavar="FILE", help="Certificate that `sdpid identify` wrote.")
    ],
    printing: Printing,
) -> None:
    """Check a certificate in exact arithmetic, from its own numbers.

    Ends with status 1 when the proof does not hold.
    """
    from sdpid.workflow.verify import verify as run

    verification = run(certificate)
    lines = map(printable, verification.lines)
    printing.show(verification, "\n".join(lines))
    if not verification.passed:
        reasons = "; ".join(verification.problems)
        text = f"sdpid: {certificate}: the proof does not hold: {reasons}."
        typer.echo(printable(text), err=True)
        raise typer.Exit(OURS)
