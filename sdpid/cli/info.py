"""The command ``sdpid info``: what a log holds, and what is wrong with it."""

from __future__ import annotations

import sdpid.cli.options as opt
from sdpid.cli.printing import Printing, listed


def info(
    log: opt.Log,
    reading: opt.Reading,
    periods: opt.Periods,
    printing: Printing,
    robot: opt.OptionalRobot = None,
) -> None:
    """Show what was understood of a log, and what is wrong with it."""
    from sdpid._common.tables import Table
    from sdpid.experiment.preparation.overview import overview
    from sdpid.experiment.readers.read import read_described
    from sdpid.experiment.recording.floating.robots import robot_of

    log_read = read_described(log, **reading.arguments(), **periods.arguments())
    model = None if robot is None else robot_of(robot, [log_read.recording])
    facts = overview(log_read.recording, model)
    source = {"file": log_read.file, "mapping": log_read.mapping, "read_from": log_read.sources}
    content = {**source, **facts}
    joints, findings = facts.pop("joints"), facts.pop("findings")
    chosen = (facts["processing"] or {}).items()
    settings = ", ".join(f"{key.replace('_', ' ')} {_text(value)}" for key, value in chosen)
    shown = {**source, **facts, "processing": settings or None}
    shown = {key: each for key, each in shown.items() if each is not None and key != "read_from"}
    width = max(map(len, shown))
    parts = [
        "\n".join(f"{key.replace('_', ' '):{width}}  {_text(each)}" for key, each in shown.items()),
        listed("read from", (f"{key}: {each}" for key, each in log_read.sources.items())),
        Table(tuple(joints[0]), tuple(tuple(joint.values()) for joint in joints)).text(),
    ]
    found = [f"{each['severity']} {each['kind']}: {each['text']}" for each in findings]
    if not found and robot is None:
        none = "findings: none (give --robot, and efforts are compared with the motion too)"
    else:
        none = "findings: none"
    parts.append(listed("findings", found) if found else none)
    printing.show(content, "\n\n".join(parts))


def _text(value: object) -> str:
    """Return a fact as text, a dash where it is missing."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
