"""Audits of numbers and of descriptions, and what others say of them, in two parts.

* ``paper``: can any links have the base parameters that the Denso paper prints? Every answer is
  proven. Both columns of Table IV, each number known to half a unit in its last printed place,
  under both consistencies; the constrained column against the margins and masses of Table V; and
  how the answers depend on the bound on masses and on the lengths that the paper does not give.
* ``robots``: every robot of example-robot-data is audited link by link and repaired. The numbers
  that were read are compared with the inertias that Pinocchio reads (added up where links are fixed
  together), and the verdicts with MuJoCo's loader, before and after the repair. For MuJoCo the
  files are stripped of geometry and of everything that is no link or joint, so that missing meshes
  do not matter and no mass is invented from shapes.

    python examples/evidence/audits.py --parts paper --out results
"""

from __future__ import annotations

import csv
import json
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree
from study import Rows, Study

import sdpid
from sdpid.assurance.descriptions.checks import carried, carried_theta
from sdpid.assurance.tables.audit import BaseAudit
from sdpid.assurance.tables.csv_table import BaseTable, half_unit, read_base_table
from sdpid.output.robots.repair import repair_urdf
from sdpid.robot.description.bodies import read_urdf_bodies
from sdpid.robot.description.catalog import bundled_folder, example_robots
from sdpid.robot.description.dh_table import DhTable
from sdpid.robot.description.xml import parse_xml
from sdpid.robot.inertia import Consistency
from sdpid.verifier.tables import answer_of

ROBOT = "denso_vp6242"
FOLDER = bundled_folder(ROBOT)

FOUR: Consistency = "pseudo_inertia"
SPATIAL: Consistency = "spatial_inertia"

# Lengths of the maker's drawing, which the bundled model has: row and field of its table.
LENGTHS = {"l2": (2, "d"), "l3x": (3, "d"), "l3z+l4": (3, "r"), "l5": (5, "r")}
TIMES = (0.5, 0.8, 1.25, 2.0)
MASSES = (5.0, 10.0, 12.0, 15.0, 20.0, 40.0, 100.0, 1000.0)

# Smallest number that is printed as Table V's 0.01.
PRINTED_MARGIN = "0.005"


def column(name: str) -> BaseTable:
    """Return a column of Table IV, each number as exactly as it is printed."""
    return read_base_table(FOLDER / "table_iv.csv", value=name)


CWLS = partial(column, "cwls")


def with_table_v() -> BaseTable:
    """Return the constrained column with the masses of Table V."""
    table = CWLS()
    values, halfwidths = dict(table.values), dict(table.halfwidths)
    with (FOLDER / "table_v.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            name = f"m_{row['link']}"
            values[name] = Fraction(row["mass_kg"])
            halfwidths[name] = half_unit(row["mass_kg"])
    return BaseTable(values, halfwidths, frozenset(values))


def with_sigma(name: str, times: int) -> BaseTable:
    """Return a column whose halfwidths are the printed rounding and `times` sigma."""
    table = column(name)
    sigma = read_base_table(FOLDER / "table_iv.csv", value="sigma").values
    wide = {name: half + times * sigma[name] for name, half in table.halfwidths.items()}
    return BaseTable(table.values, wide, table.mentioned)


def stretched(factors: Mapping[str, float]) -> sdpid.RobotModel:
    """Return the arm with some lengths multiplied."""
    table = DhTable.from_toml(FOLDER / "kinematics.toml")
    joints = list(table.joints)
    for name, factor in factors.items():
        row, field = LENGTHS[name]
        length = round(getattr(joints[row], field) * factor, 6)
        joints[row] = replace(joints[row], **{field: length})
    return sdpid.RobotModel.from_mdh(replace(table, joints=tuple(joints)))


def audited(
    robot: sdpid.RobotModel, table: BaseTable, consistency: Consistency, **options: object
) -> BaseAudit:
    """Audit, and check what is proven once more from what would be written."""
    found = sdpid.audit_base_parameters(
        robot, table.values, table.halfwidths, consistency=consistency, **options
    )
    if found.verdict != "undecided" and not found.holds():
        raise AssertionError(f"{found.verdict}, but the proof does not hold")
    if found.certificate is not None:
        stored = json.loads(json.dumps(found.certificate.to_dict()))
        if not answer_of(stored).holds:
            raise AssertionError("the stored proof does not hold")
    return found


# What is asked: the table, the consistency, and further arguments of the audit.
QUESTIONS: dict[str, tuple[Callable[[], BaseTable], Consistency, dict[str, str]]] = {
    **{
        f"Table IV {name}, {kind}": (partial(column, name), kind, {})
        for name in ("cwls", "wls")
        for kind in (FOUR, SPATIAL)
    },
    "Table IV cwls, margin of Table V (0.01)": (CWLS, SPATIAL, {"margin": "0.01"}),
    "Table IV cwls, margin that prints as 0.01": (CWLS, SPATIAL, {"margin": PRINTED_MARGIN}),
    "Table IV cwls with the masses of Table V": (with_table_v, SPATIAL, {}),
    "Table IV cwls with the masses of Table V, margin that prints as 0.01": (
        with_table_v,
        SPATIAL,
        {"margin": PRINTED_MARGIN},
    ),
    **{
        f"Table IV {name} +- 2 sigma, {kind}": (partial(with_sigma, name, 2), kind, {})
        for name in ("cwls", "wls")
        for kind in (SPATIAL, FOUR)
    },
}


def verdict(title: str) -> Rows:
    """Yield the answer to a question about Table IV."""
    table, consistency, more = QUESTIONS[title]
    found = audited(sdpid.load_robot(ROBOT), table(), consistency, **more)
    print(f"== {title}\n{found.summary()}\n", flush=True)
    numbers = None if found.refutation is None else len(found.refutation.weights)
    yield found.verdict, found.margin, numbers


def scanned(changed: str | float) -> Rows:
    """Yield the row of another bound on masses, or of an arm of other lengths."""
    if not isinstance(changed, str):
        found = audited(sdpid.load_robot(ROBOT), CWLS(), SPATIAL, mass_max=changed)
        yield f"masses up to {changed:g} kg", found.verdict, found.margin, None
        return
    names, factor = changed.split(" x ")
    arm = stretched(dict.fromkeys(LENGTHS if names == "all" else [names], float(factor)))
    found = audited(arm, CWLS(), SPATIAL)
    others = (("cwls", FOUR), ("wls", FOUR), ("wls", SPATIAL))
    refuted = all(
        audited(arm, column(name), kind).verdict == "not realisable" for name, kind in others
    )
    yield found.verdict, found.margin, refuted


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


def audited_file(name: str) -> Rows:
    """Yield the row of a robot."""
    path = example_robots()[name]
    try:
        audit = sdpid.audit_urdf(path)
    except sdpid.errors.ModelError as error:
        print(f"{name}: {error}", file=sys.stderr)
        yield *(None,) * 5, 0, None, None, None, []
        return
    text = path.read_bytes().decode("utf-8")
    report = repair_urdf(path)
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


def paper(study: Study) -> None:
    """Audit the paper's tables."""
    study.rows("audit_paper.csv", ("case", "verdict", "margin", "numbers"), verdict, QUESTIONS)
    header = ("changed", "cwls_spatial_inertia", "largest_margin", "others_refuted")
    study.rows("audit_paper_scan.csv", header, scanned, [*study.masses, *study.lengths])


def robots(study: Study) -> None:
    """Audit all files."""
    found = study.rows("audit_robots.csv", HEADER, audited_file, study.robots)
    shown = [row for row in found if row["errors"] or row["mujoco"] not in ("loads", None)]
    study.write("findings.csv", SHOWN, ([row[name] for name in SHOWN] for row in shown))
    read = [row for row in found if row["verdict"]]
    agreement = Counter(row["verdict"] for row in read)
    kinds = Counter(kind for row in read for kind in row["kinds"])
    counts = [*sorted(agreement.items()), *sorted(kinds.items())]
    study.write("audit_robots_counts.csv", ("what", "files"), counts)


def main() -> None:
    """Write the tables that are asked for."""
    parts = {"paper": paper, "robots": robots}
    lengths = [f"{name} x {factor:g}" for factor in TIMES for name in ("all", *LENGTHS)]
    study = Study(
        __doc__,
        quick={"masses": [10.0], "lengths": lengths[:1], "robots": [*QUICK]},
        parts=[*parts],
        masses=[*MASSES],
        lengths=lengths,
        robots=[*example_robots()],
    )
    for part in study.parts:
        parts[part](study)


if __name__ == "__main__":
    main()
