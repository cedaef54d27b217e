"""Can any links have the base parameters that the Denso paper prints? Every answer is proven.

Both columns of Table IV, each number known to half a unit in its last printed place, under both
consistencies; the constrained column against the margins and masses of Table V; and how the
answers depend on the bound on masses and on the lengths that the paper does not give.

    python examples/evidence/audit_paper.py --out results
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import sdpid
from sdpid._common.tables import Table
from sdpid.assurance.tables.audit import BaseAudit
from sdpid.assurance.tables.csv_table import BaseTable, half_unit, read_base_table
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.description.dh_table import DhTable
from sdpid.robot.inertia import CONSISTENCIES, Consistency
from sdpid.verifier.tables import answer_of

ROBOT = "denso_vp6242"
FOLDER = bundled_folder(ROBOT)

# Lengths (m) of the maker's drawing, which the bundled model has, and where they stand in its
# table: row, field and sign.
LENGTHS = {
    "l2": (2, "d", 1.0),
    "l3x": (3, "d", -1.0),
    "l3z+l4": (3, "r", 1.0),
    "l5": (5, "r", 1.0),
}
TIMES = (0.5, 0.8, 1.25, 2.0)
MASSES = (5.0, 10.0, 12.0, 15.0, 20.0, 40.0, 100.0, 1000.0)

# Smallest number that is printed as Table V's 0.01.
PRINTED_MARGIN = "0.005"


def column(name: str) -> BaseTable:
    """Return a column of Table IV, each number as exactly as it is printed."""
    return read_base_table(FOLDER / "table_iv.csv", value=name)


def with_table_v(table: BaseTable) -> BaseTable:
    """Return a column with the masses of Table V."""
    import csv

    values, halfwidths = dict(table.values), dict(table.halfwidths)
    with (FOLDER / "table_v.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            name = f"m_{row['link']}"
            values[name] = Fraction(row["mass_kg"])
            halfwidths[name] = half_unit(row["mass_kg"])
    return BaseTable(values, halfwidths, frozenset(values))


def with_sigma(table: BaseTable, times: int) -> BaseTable:
    """Return a column whose halfwidths are the printed rounding and `times` sigma."""
    sigma = read_base_table(FOLDER / "table_iv.csv", value="sigma").values
    wide = {name: half + times * sigma[name] for name, half in table.halfwidths.items()}
    return BaseTable(table.values, wide, table.mentioned)


def stretched(factors: Mapping[str, float]) -> sdpid.RobotModel:
    """Return the arm with some lengths multiplied."""
    table = DhTable.from_toml(FOLDER / "kinematics.toml")
    joints = list(table.joints)
    for name, factor in factors.items():
        row, field, _ = LENGTHS[name]
        length = round(getattr(joints[row], field) * factor, 6)
        joints[row] = replace(joints[row], **{field: length})
    return sdpid.RobotModel.from_mdh(replace(table, joints=tuple(joints)))


def other_lengths(quick: bool) -> Iterator[tuple[str, sdpid.RobotModel]]:
    """Yield arms of other lengths, one length at a time and all together."""
    for factor in TIMES[:1] if quick else TIMES:
        yield f"all x {factor:g}", stretched(dict.fromkeys(LENGTHS, factor))
        for name in () if quick else LENGTHS:
            yield f"{name} x {factor:g}", stretched({name: factor})


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


def main() -> int:
    """Audit the paper's tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="one set of other lengths only")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    robot = sdpid.load_robot(ROBOT)
    tables = {"cwls": column("cwls"), "wls": column("wls")}
    cases = [
        (f"Table IV {name}, {kind}", tables[name], kind, {})
        for name in tables
        for kind in CONSISTENCIES
        if kind != "none"
    ]
    spatial: Consistency = "spatial_inertia"
    constrained = tables["cwls"]
    cases += [
        ("Table IV cwls, margin of Table V (0.01)", constrained, spatial, {"margin": "0.01"}),
        (
            "Table IV cwls, margin that prints as 0.01",
            constrained,
            spatial,
            {"margin": PRINTED_MARGIN},
        ),
        ("Table IV cwls with the masses of Table V", with_table_v(constrained), spatial, {}),
        (
            "Table IV cwls with the masses of Table V, margin that prints as 0.01",
            with_table_v(constrained),
            spatial,
            {"margin": PRINTED_MARGIN},
        ),
    ]
    for name, table in tables.items():
        cases += [
            (f"Table IV {name} +- 2 sigma, {kind}", with_sigma(table, 2), kind, {})
            for kind in (spatial, "pseudo_inertia")
        ]
    rows, proofs = [], {}
    for title, table, kind, more in cases:
        found = audited(robot, table, kind, **more)
        print(f"== {title}\n{found.summary()}\n")
        proof = found.refutation
        rows.append(
            (
                title,
                found.verdict,
                found.margin,
                found.margin_bound,
                None if proof is None else len(proof.weights),
                found.needs_mass_bound,
                found.change,
            )
        )
        if proof is not None:
            proofs[title] = proof
    header = ("case", "verdict", "margin", "margin_bound", "numbers", "mass_bound", "change")
    Table(header, tuple(rows)).write(options.out / "audit_paper.csv")
    text = json.dumps({title: proof.to_dict() for title, proof in proofs.items()}, indent=1)
    (options.out / "audit_paper_proofs.json").write_text(text + "\n", encoding="utf-8")

    scan = []
    for mass_max in MASSES[1:2] if options.quick else MASSES:
        found = audited(robot, constrained, spatial, mass_max=mass_max)
        scan.append((f"masses up to {mass_max:g} kg", found.verdict, found.margin, None))
    for title, arm in other_lengths(options.quick):
        found = audited(arm, constrained, spatial)
        refuted = all(
            audited(arm, tables[name], kind).verdict == "not realisable"
            for name, kind in (
                ("cwls", "pseudo_inertia"),
                ("wls", "pseudo_inertia"),
                ("wls", "spatial_inertia"),
            )
        )
        scan.append((title, found.verdict, found.margin, refuted))
    table = Table(
        ("changed", "cwls_spatial_inertia", "largest_margin", "others_refuted"), tuple(scan)
    )
    table.write(options.out / "audit_paper_scan.csv")
    print("== Table IV cwls, spatial_inertia: masses and lengths (masses up to 100 kg if not said)")
    print(table.text(3))
    return 0


if __name__ == "__main__":
    sys.exit(main())
