"""Estimate five real robots from their public recordings, with default settings.

Every record of docs/evidence/data.md, with every friction model that fits it, under both
inequalities, with
the default prior and without one; nothing is tuned to a robot. What was not trained on is
predicted: the other run where there are two, the last 40 % of a record otherwise. Data that leave
base parameters undetermined must be refused without a prior. Errors are rows like any other.

    python examples/evidence/data_sets.py --data /path/to/data --out results --markdown

With --priors, kinds and strengths of priors are compared instead, under the 4×4 inequality and with
one friction model a set. The folder of the data may also be named by the environment variable
SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import sdpid
from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Table
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import PriorKind
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.prepare import samples_of
from sdpid.experiment.processing.choose import default_processing
from sdpid.robot.inertia import Consistency
from sdpid.workflow.formulate import formulate

Terms = tuple[str | sdpid.friction.FrictionTerm, ...]

TRAINED = 0.6  # of a record whose rest is predicted


@dataclass(frozen=True)
class DataSet:
    """A robot's records, and friction models that suit its effort.

    Attributes
    ----------
    urdf : str
        Its description, in the set's folder.
    records : tuple of str
        One record, or two of which each predicts the other.
    models : dict
        Friction terms by name, beside viscous friction and an offset.
    usual : str
        The model that priors are compared with.
    efforts : tuple of str
        Fields that hold an effort.
    """

    urdf: str
    records: tuple[str, ...]
    models: dict[str, Terms]
    usual: str
    efforts: tuple[str, ...] = ("tau",)


def wrist(width: float) -> Terms:
    """Return the terms of motors that drive joints 5 and 6 together."""
    return "rotor_inertia", sdpid.friction.Coupling("joint_5", "joint_6", width=width)


SETS = {
    "ur10_unisa": DataSet(
        "ur10.urdf",
        ("ur10_exciting",),
        {
            "sign": ("coulomb",),
            "tanh 0.02": (sdpid.friction.Coulomb(width=0.02),),
            "tanh 0.02, rotor": (sdpid.friction.Coulomb(width=0.02), "rotor_inertia"),
            "asymmetric 0.02": (sdpid.friction.AsymmetricCoulomb(width=0.02),),
            "sigmoid": ("sigmoid",),
        },
        "tanh 0.02",
    ),
    "panda_unisa": DataSet(
        "panda.urdf",
        ("panda_exciting",),
        {"sign": ("coulomb",), "tanh 0.02": (sdpid.friction.Coulomb(width=0.02),)},
        "tanh 0.02",
    ),
    "kuka_lwr4plus": DataSet(
        "kuka_lwr4.urdf",
        ("measurements_1", "measurements_2"),
        {"sign": ("coulomb",), "tanh 0.02": (sdpid.friction.Coulomb(width=0.02),)},
        "tanh 0.02",
    ),
    "staubli_tx40": DataSet(
        "tx40.urdf",
        ("tx40_rows_0_24750",),
        {
            "sign, rotor, coupling": ("coulomb", *wrist(0.0)),
            "dead zone 0.01, rotor, coupling": (
                sdpid.friction.Coulomb(dead_zone=0.01),
                *wrist(0.0),
            ),
            "tanh 0.05, rotor, coupling": (sdpid.friction.Coulomb(width=0.05), *wrist(0.05)),
            "tanh 0.05": (sdpid.friction.Coulomb(width=0.05),),
        },
        "tanh 0.05, rotor, coupling",
    ),
    "kinova_gen3_dynamapp": DataSet(
        "gen3.urdf",
        ("opti_traj_testing1", "opti_traj_testing2"),
        {
            "tanh 0.02": (sdpid.friction.Coulomb(width=0.02),),
            "tanh 0.02, rotor": (sdpid.friction.Coulomb(width=0.02), "rotor_inertia"),
        },
        "tanh 0.02",
        ("tau", "tau_current"),
    ),
}

BOTH: tuple[Consistency, ...] = ("pseudo_inertia", "spatial_inertia")

# What `sdpid.identify` takes for its prior: None is the default, False is none.
PLAIN: dict[str, sdpid.Prior | bool | None] = {"none": False, "default": None}
KINDS: tuple[PriorKind, ...] = ("pullback", "entropic", "scaled_euclidean", "euclidean")
STRENGTHS: tuple[float | Literal["evidence"], ...] = (0.1, 0.3, 1.0, 3.0, 10.0, "evidence")
COMPARED: dict[str, sdpid.Prior | bool | None] = {
    "none": False,
    **{
        f"{kind.replace('_', ' ')} {strength}": sdpid.Prior(kind=kind, strength=strength)
        for kind in KINDS
        for strength in STRENGTHS
    },
    "pullback 1.0, links only": sdpid.Prior(friction=False),
}

ROBOTS = dict(zip(SETS, ("UR10", "Panda", "LWR 4+", "TX40", "Gen3"), strict=True))

QUICK = ("panda_unisa",)

HEADER = (
    "set",
    "trained_on",
    "terms",
    "consistency",
    "prior",
    "base_parameters",
    "status",
    "cost",
    "gap",
    "margin",
    "heaviest_link",
    "iterations",
    "solver_ms",
    "solve_ms",
    "residual_trained",
    "residual_held_out",
    "message",
)


def part(log: sdpid.Recording, first: int, last: int) -> sdpid.Recording:
    """Return the samples of a recording from first up to last."""
    own = slice(first, last)
    velocity = None if log.velocity is None else log.velocity[own]
    return replace(
        log,
        time=log.time[own],
        position=log.position[own],
        effort=log.effort[own],
        velocity=velocity,
    )


def cases(
    folder: Path, data: DataSet
) -> Iterator[tuple[str, sdpid.Recording, sdpid.Recording | None]]:
    """Yield what is trained on, in words and as a recording, and what is predicted."""
    for effort in data.efforts:
        logs = [
            sdpid.read_recording(folder / f"{name}.npz", columns={"effort": effort})
            for name in data.records
        ]
        kind = "" if effort == "tau" else f" {effort.partition('_')[2]}"
        if len(logs) == 2:
            yield f"run 1{kind}", logs[0], logs[1]
            yield f"run 2{kind}", logs[1], logs[0]
            continue
        cut = round(TRAINED * logs[0].n_samples)
        yield f"all{kind}", logs[0], None
        yield (
            f"{TRAINED:.0%}{kind}",
            part(logs[0], 0, cut),
            part(logs[0], cut, logs[0].n_samples),
        )


def solved(problem: Problem, fresh: sdpid.Samples | None) -> tuple[object, ...]:
    """Return the cells of a row from the status on."""
    message = ""
    start = time.perf_counter()
    try:
        estimate: Estimate | None = sdpid.solve_sdp(problem)
    except sdpid.errors.SolverError as error:
        # What was found all the same is shown.
        estimate, message = error.found, str(error)
        status = type(error).__name__
    seconds = time.perf_counter() - start
    if estimate is None:
        return status, *(None,) * 6, 1e3 * seconds, None, None, message
    certificate = sdpid.certify(estimate)
    if not message:
        status = "certified" if certificate.passed else "not certified"
    assert estimate.theta is not None
    return (
        status,
        estimate.cost,
        certificate.gap,
        estimate.worst_margin,
        float(estimate.theta[: 10 * problem.robot.n_links : 10].max()),
        estimate.iterations,
        1e3 * estimate.solve_time,
        1e3 * seconds,
        sdpid.validate(estimate).relative,
        None if fresh is None else sdpid.validate(estimate, fresh).relative,
        message,
    )


def rows(
    name: str,
    folder: Path,
    models: Sequence[str],
    kinds: Sequence[Consistency],
    priors: dict[str, sdpid.Prior | bool | None],
) -> Iterator[tuple[object, ...]]:
    """Yield the rows of a data set."""
    data = SETS[name]
    robot = sdpid.load_robot(folder / data.urdf)
    warm = False
    for trained, log, other in cases(folder, data):
        # As the training data are: nothing is chosen by what is predicted.
        alike = default_processing(log)
        fresh = None if other is None else samples_of(robot, other, alike)
        for terms in models:
            for consistency in kinds:
                for belief, prior in priors.items():
                    known = (name, trained, terms, consistency, belief)
                    count = None
                    try:
                        problem = formulate(
                            robot,
                            log,
                            friction=(*data.models[terms], "viscous", "offset"),
                            consistency=consistency,
                            prior=prior,
                        )
                        count = problem.base.count
                        if not warm:
                            # The first solve loads libraries.
                            sdpid.certify(sdpid.solve_sdp(problem))
                            warm = True
                        cells = solved(problem, fresh)
                    except sdpid.errors.SdpidError as error:
                        cells = (type(error).__name__, *(None,) * 9, str(error))
                    yield *known, count, *cells


def markdown(done: Sequence[tuple[object, ...]]) -> str:
    """Return one line a record and model: the worst, and the residuals, of both inequalities."""
    shown = ("gap", "heaviest link, kg", "iterations", "held out, %")
    header = ("record", "terms", *(f"{what}, {prior}" for prior in PLAIN for what in shown))
    lines = ["| " + " | ".join(header) + " |", "|---" * len(header) + "|"]
    for key in dict.fromkeys(row[:3] for row in done):
        cells = [short(key), str(key[2])]
        for prior in PLAIN:
            found = [row for row in done if row[:3] == key and row[4] == prior]
            failed = list(dict.fromkeys(str(row[6]) for row in found if row[6] != "certified"))
            for column, form in ((8, ".0e"), (10, ".1f"), (11, "d")):
                values = [value for row in found if isinstance(value := row[column], (int, float))]
                cells.append(f"{max(values):{form}}" if values else "")
            if failed:
                cells[-3] = f"{', '.join(failed)} {cells[-3]}".strip()
            if key[1] == "all" or all(row[15] is None for row in found):
                cells.append("")
            else:
                cells.append(" / ".join(map(percent, found)))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def compared(done: Sequence[tuple[object, ...]]) -> str:
    """Return one line a prior, the residual in % on what was held out of every record."""
    keys = [key for key in dict.fromkeys(row[:3] for row in done) if key[1] != "all"]
    lines = [
        "| prior | " + " | ".join(map(short, keys)) + " |",
        "|---|" + "---|" * len(keys),
    ]
    for prior in dict.fromkeys(row[4] for row in done):
        cells = [percent(r) for key in keys for r in done if r[:3] == key and r[4] == prior]
        lines.append(f"| {prior} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def short(key: Sequence[object]) -> str:
    """Return a short name of a record."""
    return f"{ROBOTS[str(key[0])]}, {key[1]}"


def percent(row: Sequence[object]) -> str:
    """Return the residual on what was held out, or why there is none."""
    if not isinstance(row[15], float):
        return str(row[6])
    return f"{100.0 * row[15]:#.3g}" if row[15] < 1.0 else f"{100.0 * row[15]:.0f}"


def main() -> int:
    """Run every set and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--set", action="append", choices=tuple(SETS), help="a set (default all)")
    parser.add_argument("--markdown", action="store_true", help="write data_sets.md too")
    parser.add_argument("--priors", action="store_true", help="compare kinds and strengths")
    parser.add_argument("--quick", action="store_true", help="one set, one model")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    names = options.set or (QUICK if options.quick else tuple(SETS))

    done: list[tuple[object, ...]] = []
    for name in names:
        if options.data is None or not (options.data / name).is_dir():
            where = "SDPID_DATA is not set" if options.data is None else f"not in {options.data}"
            print(
                f"{name}: skipped, {where}; docs/evidence/data.md says where it comes from",
                flush=True,
            )
            continue
        models = tuple(SETS[name].models)[: 1 if options.quick else None]
        kinds, priors = BOTH, PLAIN
        if options.priors:
            models, kinds, priors = (SETS[name].usual,), BOTH[:1], COMPARED
        for cells in rows(name, options.data / name, models, kinds, priors):
            done.append(cells)
            print(Table(HEADER[:-1], (cells[:-1],)).text(3).splitlines()[1], flush=True)
            Table(HEADER, tuple(done)).write(options.out / "data_sets.csv")
    Table(HEADER, tuple(done)).write(options.out / "data_sets.csv")
    print("\n" + Table(HEADER[:-1], tuple(cells[:-1] for cells in done)).text(3))
    if options.markdown:
        text = compared(done) if options.priors else markdown(done)
        atomic_write_text(options.out / "data_sets.md", text)
    counts: dict[str, int] = {}
    for cells in done:
        counts[str(cells[6])] = counts.get(str(cells[6]), 0) + 1
    print("\n" + (", ".join(f"{count} {status}" for status, count in counts.items()) or "nothing"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
