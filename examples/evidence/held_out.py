"""What `identify` predicts with its defaults on recordings of six real robots it did not see.

Every set of docs/evidence/data.md is trained on one run, or on the first 60 % of its only record,
without any hint, and predicts the rest. Two errors are shown: on the rows as `identify` itself
processes them, and on common rows, filtered alike whatever the defaults are and with none masked,
so that no default wins by leaving out what is hard. Of the common rows those that move are shown
apart: at rest friction is anything up to its limit, which no function of the velocity tells. Least
squares stands beside, with Coulomb, square-root and viscous friction and offsets, fitted to the
common rows that move.

    python examples/evidence/held_out.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from data_sets import TITLES, TRAINED, Records, part, records_of
from study import Study

import sdpid
from sdpid._common.arrays import Mask
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.preparation.prepare import chosen_processing, default_friction, samples_of

# De Luca's gains of another UR10, N·m/A (docs/evidence/data.md).
GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
UR10E = {
    "8 harmonics": "20_02_05-20sec_8harm",
    "12 harmonics": "20_02_05-20sec_12harm",
    "5 harmonics": "20_02_06-20sec_5harm",
    "15 harmonics": "20_02_19_15harm50sec",
    "January": "20_01_31-unload",
    **{f"joint {j} alone": f"20_01_22-joint_{j}" for j in (1, 2, 4, 5)},
}
# What is known of a drive and stands in no log: the wrist's motors of the TX40 turn two joints.
WRIST = ("rotor_inertia", sdpid.friction.Coupling("joint_5", "joint_6", width=0.05))
UR10E_TRAINED = "20_02_10-30sec_12harm"


@dataclass(frozen=True)
class Case:
    """A recording to train on, and others to predict.

    Attributes
    ----------
    name, robot_name : str
        Of the case, and of its robot: cases of one robot are not independent.
    robot : RobotModel
        The robot.
    log : Recording
        What is trained on.
    others : dict
        Recordings to predict by name.
    scored_hz : float
        Cut-off of the common rows.
    limits : dict
        Largest error in % by name of what is predicted.
    after : float or None
        Time (s) after which rows of the others count. They are filtered with what was measured
        before; nothing of them reaches what is trained on.
    terms : tuple
        Friction terms beside the default ones, where a drive is known.
    """

    name: str
    robot_name: str
    robot: sdpid.RobotModel
    log: sdpid.Recording
    others: dict[str, sdpid.Recording]
    scored_hz: float
    limits: dict[str, float] = field(default_factory=dict)
    after: float | None = None
    terms: tuple[Any, ...] = ()

    @property
    def common(self) -> sdpid.Processing:
        """The processing of the common rows, which no default changes."""
        measured = self.log.velocity is not None and self.log.rate_hz < 100.0
        return sdpid.Processing(
            cutoff_hz=self.scored_hz,
            order=4,
            decimation=None,
            reversal_time=None,
            derivative="central4",
            velocity="measured" if measured else "differentiated",
        )

    def __str__(self) -> str:
        return self.name

    @property
    def rest(self) -> sdpid.Recording:
        """The first recording to predict."""
        return next(iter(self.others.values()))

    def trained(self, processing: sdpid.Processing) -> sdpid.Samples:
        """Return the training samples, which saw nothing of the rest."""
        return samples_of(self.robot, self.log, processing)

    def held_out(self, processing: sdpid.Processing) -> sdpid.Samples:
        """Return the samples of the first recording to predict.

        A record's rest is filtered with its own past before it, which is what was measured then;
        nothing of the rest reaches the training samples.
        """
        samples = samples_of(self.robot, self.rest, processing)
        if self.after is None:
            return samples
        assert samples.time is not None
        begin = int(np.searchsorted(samples.time, self.after, side="right"))
        return samples.between(begin, samples.n_samples)

    def arguments(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arguments of `identify`, with the terms of a known drive."""
        out = dict(given)
        if self.terms:
            out["friction"] = (*(out.get("friction") or default_friction(self.log)), *self.terms)
        return out


def halves(scored_hz: float, limit: float, terms: tuple[Any, ...], arm: Records) -> Iterator[Case]:
    """Yield a set of one record: its first part, which predicts the rest."""
    (log,) = arm.logs()
    cut = round(TRAINED * log.n_samples)
    yield Case(
        f"{arm}{' with its terms' if terms else ''}, first 60 %",
        str(arm),
        arm.robot,
        part(log, 0, cut),
        {"rest": log},
        scored_hz,
        {"rest": limit},
        float(log.time[cut - 1]),
        terms,
    )


def pairs(scored_hz: float, limit: float | None, effort: str, arm: Records) -> Iterator[Case]:
    """Yield a set of two runs, each of which predicts the other."""
    logs = arm.logs(effort)
    title = f"{arm}{'' if effort == 'tau' else ' currents'}"
    for own, other in ((0, 1), (1, 0)):
        label = f"run {other + 1}"
        limits = {label: limit} if limit is not None and own == 0 else {}
        yield Case(
            f"{title}, run {own + 1}",
            str(arm),
            arm.robot,
            logs[own],
            {label: logs[other]},
            scored_hz,
            limits,
        )


def ur10e_logs(folder: Path, runs: Iterable[str]) -> list[sdpid.Recording]:
    """Return runs of the UR10e, of which currents were recorded."""
    kinds = ("position", "velocity", "effort")
    columns = {"time": 1, **{k: list(range(2 + 6 * i, 8 + 6 * i)) for i, k in enumerate(kinds)}}
    return [
        sdpid.read_recording(folder / f"{run}.csv", columns=columns, effort_scale=GAINS)
        for run in runs
    ]


def ur10e(arm: Records) -> Iterator[Case]:
    """Yield the UR10e: the run of 30 s, which predicts the others without load."""
    robot = sdpid.load_robot(arm.folder / "ur10e.urdf")
    own, *logs = ur10e_logs(arm.folder, (UR10E_TRAINED, *UR10E.values()))
    others = dict(zip(UR10E, logs, strict=True))
    yield Case("UR10e, 30 s", "UR10e", robot, own, others, 10.0)


# The cut-offs of the common rows are 30 times the motion of the training part, Hz, those of
# version 0.1.0; the UR10e's is that of its README.
READERS: tuple[tuple[str, Callable[[Records], Iterator[Case]]], ...] = (
    ("ur10_unisa", partial(halves, 5.45, 4.8, ())),
    ("panda_unisa", partial(halves, 4.0, 1.75, ())),
    ("kuka_lwr4plus", partial(pairs, 3.58, 2.25, "tau")),
    ("staubli_tx40", partial(halves, 25.3, 10.0, ())),
    ("staubli_tx40", partial(halves, 25.3, 6.0, WRIST)),
    ("kinova_gen3_dynamapp", partial(pairs, 12.66, 14.5, "tau")),
    ("kinova_gen3_dynamapp", partial(pairs, 12.66, None, "tau_current")),
    ("ur10e_innopolis", ur10e),
)
QUICK = ("panda_unisa", "ur10_unisa")

HEADER = (
    *("trained on", "predicted", "limit", "common rows, %", "moving", "least squares, moving"),
    *("rows of `identify`", "trained"),
)

# A joint slower than this stands still, rad/s.
STILL = 0.01

LEAST_SQUARES = ("coulomb", "square_root", "viscous", "offset")


def cases(data: Path, names: Iterable[str]) -> Iterator[Case]:
    """Yield the cases of the sets that are there, and say which are not."""
    for arm in records_of(data, names):
        for own, reader in READERS:
            if own == arm.name:
                yield from reader(arm)


def moving(samples: sdpid.Samples) -> Mask:
    """Return which rows (K, n) are of joints that move."""
    return np.asarray(np.abs(samples.velocity) > STILL)


def error(
    estimate: Estimate, samples: sdpid.Samples, after: float | None, *, only_moving: bool = False
) -> float:
    """Return the error of predicted efforts over the efforts, in %, on rows behind a time."""
    kept = np.ones(samples.effort.shape, np.bool_) if samples.mask is None else samples.mask
    if after is not None:
        assert samples.time is not None
        kept = kept & (samples.time > after)[:, None]
    if only_moving:
        kept = kept & moving(samples)
    missed = samples.effort - sdpid.validate(estimate, samples).effort_predicted
    return 100.0 * float(np.linalg.norm(missed[kept]) / np.linalg.norm(samples.effort[kept]))


def least_squares(case: Case) -> Estimate:
    """Return the plain least-squares fit to the common rows that move."""
    samples = samples_of(case.robot, case.log, case.common)
    samples = replace(samples, mask=moving(samples))
    terms = (*LEAST_SQUARES, *case.terms)
    problem = sdpid.build_problem(case.robot, samples, friction=terms, weighting="gls")
    return sdpid.solve_wls(problem)


def rows(case: Case) -> Iterator[tuple[object, ...]]:
    """Yield a row for every recording that is predicted."""
    try:
        result = sdpid.identify(case.robot, case.log, intervals=False, **case.arguments({}))
    except sdpid.errors.SdpidError as wrong:
        yield case.name, str(wrong), *(None,) * 6
        return
    try:
        plain: Estimate | None = least_squares(case)
    except sdpid.errors.IdentifiabilityError:
        plain = None  # the run leaves base parameters open
    own, _ = chosen_processing([case.log])
    for label, other in case.others.items():
        common, estimate = samples_of(case.robot, other, case.common), result.estimate
        yield (
            case.name,
            label,
            case.limits.get(label),
            error(estimate, common, case.after),
            error(estimate, common, case.after, only_moving=True),
            plain and error(plain, common, case.after, only_moving=True),
            error(estimate, samples_of(case.robot, other, own), case.after),
            100.0 * result.training.relative,
        )


def main() -> None:
    """Run every case and write the table."""
    study = Study(__doc__, data=True, quick={"sets": [*QUICK]}, sets=[*TITLES])
    study.rows("held_out.csv", HEADER, cases(study.data, study.sets), rows, digits=3)


if __name__ == "__main__":
    main()
