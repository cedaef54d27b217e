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
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

from study import Rows, Study, pivot

import sdpid
from sdpid.experiment.preparation.prepare import samples_of
from sdpid.experiment.processing.choose import default_processing
from sdpid.friction import AsymmetricCoulomb, Coulomb, Coupling
from sdpid.workflow.formulate import formulate

Terms = tuple[Any, ...]

TRAINED = 0.6  # of a record whose rest is predicted

SIGN: dict[str, Terms] = {"sign": ("coulomb",)}
TANH: dict[str, Terms] = {"tanh 0.02": (Coulomb(width=0.02),)}
WITH_ROTOR: dict[str, Terms] = {"tanh 0.02, rotor": (Coulomb(width=0.02), "rotor_inertia")}


@dataclass(frozen=True, eq=False)
class Records:
    """A robot's public records, and friction models that suit its effort.

    Attributes
    ----------
    title : str
        What the robot is called.
    description : str
        Its URDF, in the set's folder.
    runs : tuple of str
        One record, or two of which each predicts the other.
    models : dict
        Friction terms by name, beside viscous friction and an offset.
    usual : str
        The model that priors are compared with.
    efforts : tuple of str
        Fields that hold an effort.
    folder : Path
        The set's folder, whose name is that of the set.
    """

    title: str
    description: str
    runs: tuple[str, ...] = ()
    models: dict[str, Terms] = field(default_factory=dict)
    usual: str = "tanh 0.02"
    efforts: tuple[str, ...] = ("tau",)
    folder: Path = Path()

    def __str__(self) -> str:
        return self.title

    @property
    def name(self) -> str:
        """Of the set."""
        return self.folder.name

    @property
    def urdf(self) -> Path:
        """Its description."""
        return self.folder / self.description

    @property
    def paths(self) -> dict[str, Path]:
        """Files of its records, by name."""
        return {run: self.folder / f"{run}.npz" for run in self.runs}

    @cached_property
    def robot(self) -> sdpid.RobotModel:
        """The robot as it is described."""
        return sdpid.load_robot(self.urdf)

    def logs(self, effort: str = "tau") -> list[sdpid.Recording]:
        """Return its records."""
        columns = {"effort": effort}
        return [sdpid.read_recording(path, columns=columns) for path in self.paths.values()]


def wrist(width: float) -> Terms:
    """Return the terms of motors that drive joints 5 and 6 together."""
    return "rotor_inertia", Coupling("joint_5", "joint_6", width=width)


SETS = {
    "ur10_unisa": Records(
        "UR10",
        "ur10.urdf",
        ("ur10_exciting",),
        {
            **SIGN,
            **TANH,
            **WITH_ROTOR,
            "asymmetric 0.02": (AsymmetricCoulomb(width=0.02),),
            "sigmoid": ("sigmoid",),
        },
    ),
    "panda_unisa": Records("Panda", "panda.urdf", ("panda_exciting",), SIGN | TANH),
    "kuka_lwr4plus": Records(
        "LWR 4+", "kuka_lwr4.urdf", ("measurements_1", "measurements_2"), SIGN | TANH
    ),
    "staubli_tx40": Records(
        "TX40",
        "tx40.urdf",
        ("tx40_rows_0_24750",),
        {
            "sign, rotor, coupling": ("coulomb", *wrist(0.0)),
            "dead zone 0.01, rotor, coupling": (Coulomb(dead_zone=0.01), *wrist(0.0)),
            "tanh 0.05, rotor, coupling": (Coulomb(width=0.05), *wrist(0.05)),
            "tanh 0.05": (Coulomb(width=0.05),),
        },
        "tanh 0.05, rotor, coupling",
    ),
    "kinova_gen3_dynamapp": Records(
        "Gen3",
        "gen3.urdf",
        ("opti_traj_testing1", "opti_traj_testing2"),
        TANH | WITH_ROTOR,
        efforts=("tau", "tau_current"),
    ),
}
# With one of which other files and motors' currents are read (held_out.py).
EVERY = {**SETS, "ur10e_innopolis": Records("UR10e", "ur10e.urdf")}
QUICK = ("panda_unisa",)


def folders(data: Path, names: Iterable[str]) -> Iterator[tuple[str, Path]]:
    """Yield name and folder of every set that is there, and say which are not."""
    for name in dict.fromkeys(names):
        if (data / name).is_dir():
            yield name, data / name
            continue
        print(f"{name}: skipped, not in {data}; docs/evidence/data.md says where it comes from")


def records_of(data: Path, names: Iterable[str]) -> list[Records]:
    """Return the records of arms that are there, and say which are not."""
    return [replace(EVERY[name], folder=folder) for name, folder in folders(data, names)]


def part(log: sdpid.Recording, first: int, last: int) -> sdpid.Recording:
    """Return the samples of a recording from first up to last."""
    names = ("time", "position", "effort", "velocity")
    arrays = {name: getattr(log, name) for name in names}
    return replace(log, **{k: None if v is None else v[first:last] for k, v in arrays.items()})


def cut(log: sdpid.Recording, share: float) -> tuple[sdpid.Recording, sdpid.Recording]:
    """Return the first share of a recording, and the rest."""
    at = round(share * log.n_samples)
    return part(log, 0, at), part(log, at, log.n_samples)


@cache
def cases(arm: Records) -> dict[str, tuple[sdpid.Recording, sdpid.Recording | None]]:
    """Return what is trained on, and what is predicted, by what the former is called."""
    found: dict[str, tuple[sdpid.Recording, sdpid.Recording | None]] = {}
    for effort in arm.efforts:
        first, *others = arm.logs(effort)
        kind = "" if effort == "tau" else f" {effort.partition('_')[2]}"
        if others:
            found |= {f"run 1{kind}": (first, others[0]), f"run 2{kind}": (others[0], first)}
        else:
            found |= {f"all{kind}": (first, None), f"{TRAINED:.0%}{kind}": cut(first, TRAINED)}
    return found


# What `sdpid.identify` takes for its prior: None is the default, False is none.
PLAIN: dict[str, Any] = {"none": False, "default": None}
COMPARED: dict[str, Any] = {
    "none": False,
    **{
        f"{kind.replace('_', ' ')} {strength}": sdpid.Prior(kind=kind, strength=strength)
        for kind in ("pullback", "entropic", "scaled_euclidean", "euclidean")
        for strength in (0.1, 0.3, 1.0, 3.0, 10.0, "evidence")
    },
    "pullback 1.0, links only": sdpid.Prior(friction=False),
}
HEADER = (
    *("record", "terms", "consistency", "prior", "status", "gap", "heaviest_link", "iterations"),
    "held_out",
)


def rows(study: Study, arm: Records, words: str, terms: str) -> Rows:
    """Yield the rows of a record with a friction model."""
    log, other = cases(arm)[words]
    # As the training data are: nothing is chosen by what is predicted.
    fresh = None if other is None else samples_of(arm.robot, other, default_processing(log))
    for consistency in ("pseudo_inertia", "spatial_inertia")[: 1 if study.priors else None]:
        for belief, prior in (COMPARED if study.priors else PLAIN).items():
            try:
                problem = formulate(
                    arm.robot,
                    log,
                    friction=(*arm.models[terms], "viscous", "offset"),
                    consistency=consistency,
                    prior=prior,
                )
                estimate, status = sdpid.solve_sdp(problem), ""
            except sdpid.errors.SdpidError as error:
                # What was found all the same is shown.
                estimate, status = getattr(error, "found", None), type(error).__name__
            cells: list[object] = [None] * 4
            if estimate is not None:
                certificate = sdpid.certify(estimate)
                status = status or ("certified" if certificate.passed else "not certified")
                links = estimate.theta[: 10 * problem.robot.n_links]
                held = None if fresh is None else 100.0 * sdpid.validate(estimate, fresh).relative
                cells = [certificate.gap, links[::10].max(), estimate.iterations, held]
            yield f"{arm}, {words}", terms, consistency, belief, status, *cells


def of_both(rows: list[dict[str, Any]]) -> Rows:
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
        models=(max(len(each.models) for each in SETS.values()), "friction models of a set"),
        priors=(False, "compare kinds and strengths of priors"),
    )
    wanted = [
        (arm, words, terms)
        for arm in records_of(study.data, study.sets)
        for words in cases(arm)
        if not (study.priors and words == "all")
        for terms in ([arm.usual] if study.priors else [*arm.models][: study.models])
    ]
    cells = study.rows("cells.csv", HEADER, partial(rows, study), wanted)
    if study.priors:
        study.write("data_sets.csv", *pivot(cells, "prior", "record", percent))
        return
    shown = ("gap", "heaviest link, kg", "iterations", "held out, %")
    header = ("record", "terms", *(f"{what}, {prior}" for prior in PLAIN for what in shown))
    study.write("data_sets.csv", header, of_both(cells))


if __name__ == "__main__":
    main()
