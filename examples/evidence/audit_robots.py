"""Audit and repair every robot of example-robot-data, and compare with other loaders.

Every URDF is audited link by link and repaired. The numbers that were read are compared with the
inertias that Pinocchio reads (added up where links are fixed together), and the verdicts with
MuJoCo's loader, before and after the repair. For MuJoCo the files are stripped of geometry and of
everything that is no link or joint, so that missing meshes do not matter and no mass is invented
from shapes.

    python examples/evidence/audit_robots.py --out results
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import sdpid
from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Table
from sdpid.assurance.descriptions.audit import UrdfAudit
from sdpid.assurance.descriptions.checks import carried, carried_theta
from sdpid.output.robots.repair import RepairReport, repair_urdf
from sdpid.robot.description.bodies import read_urdf_bodies
from sdpid.robot.description.catalog import example_robots
from sdpid.robot.description.xml import parse_xml

QUICK = (
    "allegro_hand_description/allegro_left_hand",
    "bolt_description/bolt",
    "double_pendulum_description/double_pendulum_simple",
    "finger_edu_description/finger_edu",
    "human_description/human",
    "so_arm_description/so101",
)
HEADER = (
    "robot",
    "links",
    "impossible",
    "errors",
    "warnings",
    "notes",
    "kinds",
    "mujoco",
    "repaired",
    "largest_distance",
    "mujoco_after",
    "pinocchio_difference",
)
# What loaders refuse although it is no error.
EDGE = ("no_thickness", "point", "moving_without_mass")


def stripped(text: str) -> str:
    """Return a URDF with nothing but links, their inertials, and joints."""
    from lxml import etree

    root = parse_xml(text, "URDF")
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
        elif element.tag == "link":
            for child in list(element):
                if child.tag != "inertial":
                    element.remove(child)
    return str(etree.tostring(root, encoding="unicode"))


def mujoco_verdict(text: str) -> str:
    """Return what MuJoCo's loader says of the inertias: ``"loads"`` or its complaint."""
    import mujoco

    try:
        mujoco.MjModel.from_xml_string(stripped(text))
    except ValueError as error:
        first = str(error).splitlines()[0]
        for complaint in ("A + B >= C", "positive eigenvalues", "mjMINVAL"):
            if complaint in first:
                return complaint
        return first
    return "loads"


def pinocchio_difference(text: str) -> float:
    """Return the largest relative difference from the inertias that Pinocchio reads."""
    model: Any = pin.buildModelFromXML(text, mimic=False)
    _, bodies = read_urdf_bodies(text, "URDF")
    worst = 0.0
    for group in carried(bodies).values():
        joint = model.getJointId(group[0].joint)
        theirs = np.asarray(model.inertias[joint].toDynamicParameters())
        ours = carried_theta(group)
        size = float(np.abs(theirs).max())
        if size > 0.0 or np.any(ours):
            worst = max(worst, float(np.abs(ours - theirs).max()) / max(size, 1e-300))
    return worst


def row(name: str, path: Path) -> tuple[tuple[object, ...], UrdfAudit | None]:
    """Return a row of the table, and the audit."""
    try:
        audit = sdpid.audit_urdf(path)
    except sdpid.errors.ModelError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return (name, *(None,) * 5, "unreadable", *(None,) * 5), None
    text = path.read_bytes().decode("utf-8")
    report: RepairReport = repair_urdf(path)
    pin.buildModelFromXML(report.text)
    assert not repair_urdf(report.text).bodies, "a repair of the repaired changes nothing"
    notes = len(audit.findings) - len(audit.errors) - len(audit.warnings)
    kinds = Counter(f.kind for f in audit.findings if f.severity != "note")
    distances = [body.proof.distance for body in report.bodies if body.proof is not None]
    cells = (
        name,
        len(audit.bodies),
        sum(body.consistent is False for body in audit.bodies),
        len(audit.errors),
        len(audit.warnings),
        notes,
        ", ".join(f"{count} {kind}" for kind, count in kinds.items()),
        mujoco_verdict(text),
        len(report.bodies),
        max(distances, default=None),
        mujoco_verdict(report.text),
        pinocchio_difference(text),
    )
    return cells, audit


def markdown(rows: list[tuple[object, ...]]) -> str:
    """Return the rows with errors, or that MuJoCo refuses, as a short Markdown table."""
    columns = (0, 1, 2, 3, 4, 7, 8, 10)
    lines = ["| " + " | ".join(HEADER[k] for k in columns) + " |"]
    lines.append("|---" + "|--:" * 4 + "|---|--:|---|")
    for cells in rows:
        if cells[3] or cells[7] not in ("loads", None):
            lines.append("| " + " | ".join(str(cells[k]) for k in columns) + " |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Audit all, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="a handful of small robots")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    robots = example_robots()
    rows: list[tuple[object, ...]] = []
    agreement: Counter[str] = Counter()
    kinds: Counter[str] = Counter()
    for name in QUICK if options.quick else robots:
        cells, audit = row(name, robots[name])
        rows.append(cells)
        print(*cells[:10], sep="  ", flush=True)
        if audit is None:
            continue
        kinds.update({(f"{f.severity} {f.kind}") for f in audit.findings})
        edge = any(f.kind in EDGE and f.severity == "warning" for f in audit.findings)
        ours = "with errors" if not audit.passed else "on the edge" if edge else "clean"
        agreement[f"{ours}, {'loaded' if cells[7] == 'loads' else 'refused'} by MuJoCo"] += 1
    Table(HEADER, tuple(rows)).write(options.out / "audit_robots.csv")
    read = [cells for cells in rows if cells[1] is not None]
    summary = [
        f"{len(rows)} files, {len(read)} with links",
        f"{sum(bool(cells[2]) for cells in read)} with a body that cannot exist",
        f"{sum(cells[8] or 0 for cells in read)} bodies repaired in "  # type: ignore[misc]
        f"{sum(bool(cells[8]) for cells in read)} files",
        f"{sum(cells[10] == 'loads' for cells in read)} load in MuJoCo after repair, "
        f"{sum(cells[7] == 'loads' for cells in read)} before",
        f"largest relative difference from Pinocchio {max(c[11] for c in read):.1e}",  # type: ignore[type-var]
        *(f"{count} files {what}" for what, count in sorted(agreement.items())),
        *(f"{count} files with {kind}" for kind, count in sorted(kinds.items())),
    ]
    counted = [*sorted(agreement.items()), *sorted(kinds.items())]
    Table(("what", "files"), tuple(counted)).write(options.out / "audit_robots_counts.csv")
    text = markdown(rows) + "\n" + "\n".join(f"- {line}" for line in summary) + "\n"
    atomic_write_text(options.out / "audit_robots.md", text)
    print("\n" + text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
