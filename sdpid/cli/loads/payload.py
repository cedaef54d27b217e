"""The command ``sdpid payload``: what is mounted on the last link."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import sdpid.cli.options as opt
from sdpid.cli.printing import Printing


def payload(
    log: opt.Log,
    robot: opt.Robot,
    reading: opt.Reading,
    acceptance: opt.Acceptance,
    printing: Printing,
    without: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG",
            help="Recording without the payload. Default: rely on the URDF's inertias, whose "
            "errors end up in the payload.",
        ),
    ] = None,
    frame: Annotated[
        str | None,
        typer.Option(help="Frame of the result, fixed to the link, such as tool0."),
    ] = None,
    link: Annotated[
        str | None, typer.Option(help="Link that carries the payload. Default: the last one.")
    ] = None,
    strength: Annotated[
        float | None,
        typer.Option(
            metavar="NATS",
            help="Strength of the regularization towards the URDF's inertias. Default: they are "
            "taken as they are where there is no recording without the payload.",
        ),
    ] = None,
    separate: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TERM",
            help="Friction term that may differ between the recordings, such as coulomb; repeat "
            "for several. Default: all but friction of the load.",
        ),
    ] = None,
    level: Annotated[float, typer.Option(help="Probability of the intervals.")] = 0.95,
    without_effort: opt.WithoutEffort = None,
) -> None:
    """Identify what is mounted on the last link: mass, center of mass and inertia."""
    from sdpid.assurance.payload.identify import SEPARATE, identify_payload
    from sdpid.estimation.prior.prior import Prior
    from sdpid.experiment.preparation.prepare import columns_without
    from sdpid.robot.model.load import load_robot

    model = load_robot(robot)
    joints = opt.joints(without_effort)
    absent = columns_without(model, joints)
    result = identify_payload(
        model,
        reading.read(log, without_effort=absent),
        None if without is None else reading.read(without, without_effort=absent),
        frame=frame,
        link=link,
        prior=None if strength is None else Prior(strength=strength),
        separate=SEPARATE if separate is None else separate,
        level=level,
        without_effort=joints,
        **acceptance.arguments(),
    )
    printing.show(result.to_dict(), result.describe())
