"""Commands that only look: what a log holds, and which names stand for a robot's description."""

from __future__ import annotations

from sdpid.cli.commands import Given, command, listed
from sdpid.cli.logs import LOG, PERIODS, READING, WITHOUT_EFFORT, periods, reading


@command(
    LOG,
    READING,
    PERIODS,
    WITHOUT_EFFORT,
    {"--robot ROBOT": "Robot to compare with: URDF or MJCF file, or name."},
)
def info(given: Given) -> None:
    """Show what was understood of a log, and what is wrong with it."""
    from sdpid._common.tables import Table
    from sdpid.experiment.preparation.overview import overview
    from sdpid.experiment.preparation.prepare import columns_without
    from sdpid.experiment.readers.read import read_described
    from sdpid.experiment.recording.joints import robot_of

    joints = tuple(given.without_effort or ())
    # Only a robot knows the numbers of joints, for logs without names.
    absent = joints if given.robot is None else columns_without(given.robot, joints)
    log = read_described(given.log, without_effort=absent, **reading(given), **periods(given))
    model = None if given.robot is None else robot_of(given.robot, [log.recording])
    facts = overview(log.recording, model, without_effort=joints)
    content = {"file": log.file, "mapping": log.mapping, "read_from": log.sources, **facts}
    rows, findings = facts.pop("joints"), facts.pop("findings")
    chosen = (facts["processing"] or {}).items()
    facts["processing"] = ", ".join(f"{key.replace('_', ' ')} {_text(it)}" for key, it in chosen)
    shown = {"file": log.file, "mapping": log.mapping, **facts}
    shown = {key: each for key, each in shown.items() if each not in (None, "")}
    width = max(map(len, shown))
    none = "findings: none"
    if given.robot is None:
        none += " (give --robot, and efforts are compared with the motion too)"
    given.show(
        content,
        "\n".join(f"{key.replace('_', ' '):{width}}  {_text(each)}" for key, each in shown.items()),
        listed("read from", (f"{key}: {each}" for key, each in log.sources.items())),
        Table(tuple(rows[0]), tuple(tuple(row.values()) for row in rows)).text(),
        listed("findings", (f"{it['severity']} {it['kind']}: {it['text']}" for it in findings))
        or none,
    )


def _text(value: object) -> str:
    """Return a fact as text."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


@command({"word WORD = none": "Only names that hold this word."})
def robots(given: Given) -> None:
    """List the names that may be given in place of a URDF or MJCF file."""
    from sdpid.robot.description.catalog import (
        bundled_robots,
        downloadable_robots,
        example_robots,
        identified_robots,
    )
    from sdpid.verifier.reading import parse, read_bytes

    results = identified_robots()
    sources = {
        "bundled": bundled_robots(),
        "identified": tuple(results),
        "example-robot-data": tuple(example_robots()),
        "robot_descriptions, downloaded at first use": downloadable_robots(),
    }
    word = given.word or ""
    held = {
        source: [name for name in names if word.lower() in name.lower()]
        for source, names in sources.items()
    }
    missed = {
        name: parse(read_bytes(results[name] / "result.json"))["headline"]["error"]
        for name in held["identified"]
    }
    lines = {**held, "identified": [f"{name}: {error}" for name, error in missed.items()]}
    shown = "\n".join(filter(None, map(listed, lines, lines.values())))
    given.show({**held, "identified": missed}, shown or f"no name holds {word!r}")
