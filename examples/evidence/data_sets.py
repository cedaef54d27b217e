"""Estimate five real robots from their public recordings, with default settings.

Every record of docs/evidence/data.md, with every friction model that fits it, under both
inequalities, with the default prior and without one; nothing is tuned to a robot. What was not
trained on is predicted: the other run where there are two, the last 40 % of a record otherwise.
Data that leave base parameters undetermined must be refused without a prior. Errors are rows like
any other.

    python examples/evidence/data_sets.py --data /path/to/data --out results

With --priors, kinds and strengths of priors are compared instead, under the 4×4 inequality and
with one friction model a set. The folder of the data may also be named by the environment variable
SDPID_DATA.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from study import Study, pivot

import sdpid
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


def folders(data: Path, names: Iterable[str]) -> Iterator[tuple[str, Path]]:
    """Yield name and folder of every set that is there, and say which are not."""
    for name in dict.fromkeys(names):
        if (data / name).is_dir():
            yield name, data / name
            continue
        print(f"{name}: skipped, not in {data}; docs/evidence/data.md says where it comes from")


@dataclass(frozen=True)
class Records:
    """A robot of the public records: name and folder of its set."""

    name: str
    folder: Path

    def __str__(self) -> str:
        return TITLES[self.name]

    @property
    def data(self) -> DataSet:
        """What is known of its set."""
        return SETS[self.name]

    @property
    def urdf(self) -> Path:
        """Its description."""
        return self.folder / self.data.urdf

    @property
    def paths(self) -> dict[str, Path]:
        """Files of its records, by name."""
        return {run: self.folder / f"{run}.npz" for run in self.data.records}

    @cached_property
    def robot(self) -> sdpid.RobotModel:
        """The robot as it is described."""
        return sdpid.load_robot(self.urdf)

    def logs(self, effort: str = "tau") -> list[sdpid.Recording]:
        """Return its records."""
        columns = {"effort": effort}
        return [sdpid.read_recording(path, columns=columns) for path in self.paths.values()]


def records_of(data: Path, names: Iterable[str]) -> Iterator[Records]:
    """Yield the records of arms that are there, and say which are not."""
    yield from (Records(*each) for each in folders(data, names))


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

TITLES = {
    "ur10_unisa": "UR10",
    "panda_unisa": "Panda",
    "kuka_lwr4plus": "LWR 4+",
    "staubli_tx40": "TX40",
    "kinova_gen3_dynamapp": "Gen3",
    "ur10e_innopolis": "UR10e",
}

QUICK = ("panda_unisa",)

HEADER = (
    *("record", "terms", "consistency", "prior", "status", "gap", "margin", "heaviest_link"),
    *("iterations", "trained", "held_out", "message"),
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


def cases(arm: Records) -> Iterator[tuple[str, sdpid.Recording, sdpid.Recording | None]]:
    """Yield what is trained on, in words and as a recording, and what is predicted."""
    for effort in arm.data.efforts:
        logs = arm.logs(effort)
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
    try:
        estimate: Estimate | None = sdpid.solve_sdp(problem)
    except sdpid.errors.SolverError as error:
        # What was found all the same is shown.
        estimate, message = error.found, str(error)
        status = type(error).__name__
    if estimate is None:
        return status, *(None,) * 6, message
    certificate = sdpid.certify(estimate)
    if not message:
        status = "certified" if certificate.passed else "not certified"
    assert estimate.theta is not None
    return (
        status,
        certificate.gap,
        estimate.worst_margin,
        float(estimate.theta[: 10 * problem.robot.n_links : 10].max()),
        estimate.iterations,
        100.0 * sdpid.validate(estimate).relative,
        None if fresh is None else 100.0 * sdpid.validate(estimate, fresh).relative,
        message,
    )


def rows(
    arm: Records, terms: str, trained: tuple[Any, ...], study: Study
) -> Iterator[tuple[object, ...]]:
    """Yield the rows of a record with a friction model."""
    words, log, other = trained
    # As the training data are: nothing is chosen by what is predicted.
    fresh = None if other is None else samples_of(arm.robot, other, default_processing(log))
    for consistency in BOTH[: 1 if study.priors else None]:
        for belief, prior in (COMPARED if study.priors else PLAIN).items():
            try:
                problem = formulate(
                    arm.robot,
                    log,
                    friction=(*arm.data.models[terms], "viscous", "offset"),
                    consistency=consistency,
                    prior=prior,
                )
                cells = solved(problem, fresh)
            except sdpid.errors.SdpidError as error:
                cells = (type(error).__name__, *(None,) * 6, str(error))
            yield f"{arm}, {words}", terms, consistency, belief, *cells


def of_both(rows: list[dict[str, Any]]) -> Iterator[list[object]]:
    """Yield one line a record and model: the worst, and the residuals, of both inequalities."""
    for key in dict.fromkeys((row["record"], row["terms"]) for row in rows):
        line: list[object] = [*key]
        for prior in PLAIN:
            own = [
                row for row in rows if (row["record"], row["terms"], row["prior"]) == (*key, prior)
            ]
            failed = dict.fromkeys(r["status"] for r in own if r["status"] != "certified")
            for column, form in (("gap", ".0e"), ("heaviest_link", ".1f"), ("iterations", "d")):
                values = [row[column] for row in own if row[column] is not None]
                worst = f"{max(values):{form}}" if values else ""
                words = failed if column == "gap" else ()
                line.append(" ".join(filter(None, (", ".join(words), worst))))
            held = [percent(row) for row in own]
            line.append(" / ".join(held) if any(row["held_out"] for row in own) else "")
        yield line


def percent(row: Mapping[str, Any]) -> str:
    """Return the residual on what was held out, or why there is none."""
    if row["held_out"] is None:
        return str(row["status"])
    return f"{row['held_out']:#.3g}" if row["held_out"] < 100.0 else f"{row['held_out']:.0f}"


def main() -> None:
    """Run every set and write the table."""
    study = Study(
        __doc__,
        data=True,
        quick={"sets": [*QUICK], "models": 1},
        sets=[*SETS],
        models=(max(len(data.models) for data in SETS.values()), "friction models of a set"),
        priors=(False, "compare kinds and strengths of priors"),
    )
    found = {arm.name: arm for arm in records_of(study.data, study.sets)}
    trained = {name: {case[0]: case for case in cases(arm)} for name, arm in found.items()}
    wanted = [
        (name, words, terms)
        for name, arm in found.items()
        for words in trained[name]
        if not (study.priors and words == "all")
        for terms in ([arm.data.usual] if study.priors else [*arm.data.models][: study.models])
    ]
    cells = study.rows(
        "cells.csv",
        HEADER,
        wanted,
        lambda c: rows(found[c[0]], c[2], trained[c[0]][c[1]], study),
    )
    if study.priors:
        study.write("data_sets.csv", *pivot(cells, "prior", "record", percent))
        return
    shown = ("gap", "heaviest link, kg", "iterations", "held out, %")
    header = ("record", "terms", *(f"{what}, {prior}" for prior in PLAIN for what in shown))
    study.write("data_sets.csv", header, of_both(cells))


if __name__ == "__main__":
    main()
