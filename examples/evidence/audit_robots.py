"""Audit and repair every robot of example-robot-data, and compare with other loaders.

Every URDF is audited link by link and repaired. The numbers that were read are compared with the
inertias that Pinocchio reads (added up where links are fixed together), and the verdicts with
MuJoCo's loader, before and after the repair. For MuJoCo the files are stripped of geometry and of
everything that is no link or joint, so that missing meshes do not matter and no mass is invented
from shapes.

    python examples/evidence/audit_robots.py --out results
"""

from __future__ import annotations

import sys
from collections import Counter
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree
from study import Rows, Study

import sdpid
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
# Of the page, and beside it: the largest difference from Pinocchio, what is counted, and kinds.
SHOWN = ("robot", "links", "impossible", "errors", "warnings", "mujoco", "repaired", "mujoco_after")
HEADER = (*SHOWN, "pinocchio_difference", "verdict", "kinds")
# What loaders refuse although it is no error.
EDGE = ("no_thickness", "point", "moving_without_mass")


def stripped(text: str) -> str:
    """Return a URDF with nothing but links, their inertials, and joints."""
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


def rows(name: str) -> Rows:
    """Yield the row of a robot."""
    path = example_robots()[name]
    try:
        audit = sdpid.audit_urdf(path)
    except sdpid.errors.ModelError as error:
        print(f"{name}: {error}", file=sys.stderr)
        yield *(None,) * 5, 0, None, None, None, []
        return
    text = path.read_bytes().decode("utf-8")
    report: RepairReport = repair_urdf(path)
    pin.buildModelFromXML(report.text)
    assert not repair_urdf(report.text).bodies, "a repair of the repaired changes nothing"
    verdict = mujoco_verdict(text)
    edge = any(f.kind in EDGE and f.severity == "warning" for f in audit.findings)
    ours = "with errors" if not audit.passed else "on the edge" if edge else "clean"
    loaded = "loaded" if verdict == "loads" else "refused"
    yield (
        len(audit.bodies),
        sum(body.consistent is False for body in audit.bodies),
        len(audit.errors),
        len(audit.warnings),
        verdict,
        len(report.bodies),
        mujoco_verdict(report.text),
        pinocchio_difference(text),
        f"{ours}, {loaded} by MuJoCo",
        sorted({f"{f.severity} {f.kind}" for f in audit.findings}),
    )


def main() -> None:
    """Audit all, and write the tables."""
    study = Study(__doc__, quick={"robots": [*QUICK]}, robots=[*example_robots()])
    found = study.rows("audit_robots.csv", HEADER, rows, study.robots)
    shown = [row for row in found if row["errors"] or row["mujoco"] not in ("loads", None)]
    study.write("findings.csv", SHOWN, ([row[name] for name in SHOWN] for row in shown))
    read = [row for row in found if row["verdict"]]
    agreement = Counter(row["verdict"] for row in read)
    kinds = Counter(kind for row in read for kind in row["kinds"])
    counts = [*sorted(agreement.items()), *sorted(kinds.items())]
    study.write("audit_robots_counts.csv", ("what", "files"), counts)


if __name__ == "__main__":
    main()
