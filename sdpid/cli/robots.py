"""The command ``sdpid robots``: the names that stand for a robot's description."""

from __future__ import annotations

from typing import Annotated

import typer

from sdpid.cli.printing import Printing, listed


def robots(
    printing: Printing,
    word: Annotated[
        str, typer.Argument(metavar="WORD", help="Only names that hold this word.")
    ] = "",
) -> None:
    """List the names that may be given in place of a URDF or MJCF file."""
    from sdpid.robot.description.catalog import (
        bundled_robots,
        downloadable_robots,
        example_robots,
    )

    sources = {
        "bundled": bundled_robots(),
        "example-robot-data": tuple(example_robots()),
        "robot_descriptions, downloaded at first use": downloadable_robots(),
    }
    held = {
        source: [name for name in names if word.lower() in name.lower()]
        for source, names in sources.items()
    }
    shown = [listed(source, names) for source, names in held.items() if names]
    printing.show(held, "\n".join(shown) or f"no name holds {word!r}")
