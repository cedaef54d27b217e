"""Can any links have the base parameters that the Denso paper prints? Every answer is proven.

Both columns of Table IV, each number known to half a unit in its last printed place, under both
consistencies; the constrained column against the margins and masses of Table V; and how the
answers depend on the bound on masses and on the lengths that the paper does not give.

    python examples/evidence/audit_paper.py --out results
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from functools import partial

from study import Rows, Study

import sdpid
from sdpid.assurance.tables.audit import BaseAudit
from sdpid.assurance.tables.csv_table import BaseTable, half_unit, read_base_table
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.description.dh_table import DhTable
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


def main() -> None:
    """Audit the paper's tables."""
    lengths = [f"{name} x {factor:g}" for factor in TIMES for name in ("all", *LENGTHS)]
    quick = {"masses": [10.0], "lengths": lengths[:1]}
    study = Study(__doc__, quick=quick, masses=[*MASSES], lengths=lengths)
    header = ("case", "verdict", "margin", "numbers")
    study.rows("audit_paper.csv", header, verdict, QUESTIONS)
    header = ("changed", "cwls_spatial_inertia", "largest_margin", "others_refuted")
    study.rows("audit_paper_scan.csv", header, scanned, [*study.masses, *study.lengths])


if __name__ == "__main__":
    main()
