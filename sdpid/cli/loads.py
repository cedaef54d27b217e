"""Commands about what an arm carries: payloads, and gains from a known load."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

import sdpid.cli.logs as logs
from sdpid.cli.commands import Given, command
from sdpid.cli.endings import OURS, complain

if TYPE_CHECKING:
    from sdpid.assurance.drive_gains.load import Load


@command(
    logs.ROBOT,
    {
        "--without LOG ... = required": "Currents without the load, A. May be repeated.",
        "--with LOG ...": "Currents with the load, A. May be repeated.",
        "--load KG ...": "Mass of the load; repeat it for one of each recording with load.",
        "--load-error KG": "Standard error of that mass. Default: 0.",
        "--load-com X,Y,Z": "Center of mass of the load in the frame, m. Default: it is estimated.",
        "--load-inertia XX,XY,XZ,YY,YZ,ZZ": "Inertia of the load about its center of mass, "
        "kg.m2, beside --load-com. Default: it is estimated.",
        "--link LINK": "Link that carries the load. Default: the last one.",
        "--frame FRAME": "Frame of --load-com, fixed to the link, such as tool0.",
        "--known JOINT=X ...": "A gain that is known, N.m/A. May be repeated.",
        "--description-error X": "Believe the URDF's inertias, each to this relative standard "
        "deviation, such as 0.1. Default: nothing is taken from them.",
        "--effects auto|none|A,B,... = auto": "Effects beside friction, as for 'sdpid identify'.",
        "--level X = 0.95": "Probability of the intervals.",
        "--out FILE = gains.toml": "File for the gains.",
    },
    logs.READING,
    logs.PROCESSING,
    logs.ACCEPTANCE,
)
def gains(given: Given) -> None:
    """Identify drive gains, N.m/A, from motor currents without and with a known load."""
    from sdpid._common.arrays import require_probability
    from sdpid.assurance.drive_gains.identify import identify_drive_gains
    from sdpid.robot.model.load import load_robot

    require_probability(given.level, "level")
    given.require_file("out")
    model, loads = load_robot(given.robot), _loads(given)
    result = identify_drive_gains(
        model,
        [logs.read(given, log, currents=True) for log in given.without],
        [logs.read(given, log, currents=True) for log in given.with_] or None,
        load=loads or None,
        known=given.known or None,
        processing=logs.processing(given),
        **given.chosen("link frame description_error effects accept"),
    )
    if result.status != "optimal":
        complain(f"{given.out} is not written: {result.status}")
        raise typer.Exit(OURS)
    result.gains.to_toml(given.out)
    text = f"{result.describe(given.level)}\nwritten to {given.out}: --gains {given.out} uses them"
    given.show({**result.to_dict(), "file": str(given.out)}, text)


def _loads(given: Given) -> list[Load]:
    """Return what is known of the loads.

    Raises
    ------
    DataError
        When something is said of a load without mass.
    """
    from sdpid.assurance.drive_gains.load import Load

    if not given.load:
        given.refuse("load_error load_com load_inertia", "of a load without a mass; give --load.")
    tensor: Any = None
    if given.load_inertia is not None:
        xx, xy, xz, yy, yz, zz = given.load_inertia
        tensor = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    error = given.load_error or 0.0
    return [
        Load(mass=mass, mass_error=error, com=given.load_com, inertia=tensor) for mass in given.load
    ]


@command(
    logs.LOG,
    logs.ROBOT,
    {
        "--without LOG": "Recording without the payload. Default: rely on the URDF's inertias, "
        "whose errors end up in the payload.",
        "--frame FRAME": "Frame of the result, fixed to the link, such as tool0.",
        "--link LINK": "Link that carries the payload. Default: the last one.",
        "--strength NATS": "Strength of the regularization towards the URDF's inertias. "
        "Default: they are taken as they are where there is no recording without the payload.",
        "--separate TERM ...": "Friction term that may differ between the recordings, such as "
        "coulomb; repeat for several. Default: all but friction of the load.",
        "--level X = 0.95": "Probability of the intervals.",
    },
    logs.READING,
    logs.ACCEPTANCE,
    logs.WITHOUT_EFFORT,
)
def payload(given: Given) -> None:
    """Identify what is mounted on the last link: mass, center of mass and inertia."""
    from sdpid.assurance.payload.identify import SEPARATE, identify_payload
    from sdpid.estimation.prior.prior import Prior
    from sdpid.experiment.preparation.prepare import columns_without
    from sdpid.robot.model.load import load_robot

    model, joints = load_robot(given.robot), given.without_effort or []
    absent = columns_without(model, joints)
    bare = given.without
    result = identify_payload(
        model,
        logs.read(given, given.log, without_effort=absent),
        None if bare is None else logs.read(given, bare, without_effort=absent),
        prior=None if given.strength is None else Prior(strength=given.strength),
        separate=given.separate or SEPARATE,
        without_effort=joints,
        **given.chosen("frame link level accept"),
    )
    given.show(result.to_dict(), result.describe())
