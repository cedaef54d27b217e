"""The command ``sdpid payload``: what is mounted on the last link."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdpid.cli import options as opt


def payload(
    log: opt.Log,
    robot: opt.Robot,
    without: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG",
            help="Recording without the payload; without one the URDF's inertias are believed.",
        ),
    ] = None,
    frame: Annotated[
        str | None,
        typer.Option(help="Frame of the result, fixed to the link, such as tool0."),
    ] = None,
    link: Annotated[
        str | None, typer.Option(help="Link that carries it; by default the last one.")
    ] = None,
    strength: Annotated[
        float | None,
        typer.Option(
            metavar="NATS",
            help="How firmly the URDF's inertias are believed; without a recording without "
            "payload they count as exact by default.",
        ),
    ] = None,
    level: Annotated[float, typer.Option(help="Probability of the intervals.")] = 0.95,
    column: opt.Column = None,
    unit: opt.Unit = None,
    joint_names: opt.JointNames = None,
    effort_scale: opt.EffortScale = None,
    mapping: opt.Mapping = None,
    topic: opt.Topic = None,
    as_json: opt.Json = False,
) -> None:
    """Identify what is mounted on the last link: mass, centre of mass and inertia."""
    how = opt.reading(column, unit, joint_names, effort_scale, mapping, topic)
    from sdpid.assurance.payload.identify import identify_payload
    from sdpid.estimation.prior.prior import Prior
    from sdpid.experiment.readers.read import read_recording

    found = identify_payload(
        robot,
        read_recording(log, **how),
        None if without is None else read_recording(without, **how),
        frame=frame,
        link=link,
        prior=None if strength is None else Prior(strength=strength),
        level=level,
    )
    if as_json:
        opt.print_json(found.to_dict())
    else:
        opt.echo(found.describe())
