"""The command ``sdpid compare-runs``: two results folders against each other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdpid.cli.printing import Printing


def compare_runs(
    first: Annotated[
        Path, typer.Argument(metavar="FIRST", help="Folder that `sdpid identify` wrote.")
    ],
    other: Annotated[Path, typer.Argument(metavar="OTHER", help="Another, of the same robot.")],
    printing: Printing,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Print what is the same and all parameters too."),
    ] = False,
) -> None:
    """Compare two results folders from their files: inputs, options, errors, parameters, proofs.

    Nothing is computed anew, and nothing is proven: `sdpid verify` checks a folder.
    """
    from sdpid.workflow.runs import compare_runs as run

    found = run(first, other)
    more = "" if verbose else "\nWhat is the same, and all parameters: -v."
    printing.show(found.to_dict(), found.text(full=verbose) + more)
