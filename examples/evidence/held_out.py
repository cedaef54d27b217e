"""What `identify` predicts with its defaults on recordings of six real robots it did not see.

Every set of docs/evidence/data.md is trained on one run, or on the first 60 % of its only record,
without any hint, and predicts the rest, on common rows: filtered alike whatever the defaults are
and with none masked, so that no default wins by leaving out what is hard. Those that move are shown
apart: at rest friction is anything up to its limit, which no function of the velocity tells. Least
squares stands beside, with Coulomb, square-root and viscous friction and offsets, fitted to the
common rows that move. The part ``defaults`` compares candidates for the defaults, scored by errors
on common rows of joints that move, which no candidate changes; each robot is left out in turn, and
the others choose.

    python examples/evidence/held_out.py --parts errors --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from data_sets import EVERY, TRAINED, Records, cut, records_of, wrist
from study import Rows, Study, grouped

import sdpid
from sdpid._common.arrays import Mask
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.preparation.prepare import default_friction, samples_of
from sdpid.experiment.processing.choose import default_processing

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
UR10E_TRAINED = "20_02_10-30sec_12harm"

# Of each set the cut-off of the common rows, Hz (30 times the motion of the training part, by
# version 0.1.0; the UR10e's is that of its README), the field of efforts, and what is known of a
# drive and stands in no log: the wrist's motors of the TX40 turn two joints.
READERS: tuple[tuple[str, float, str, tuple[Any, ...]], ...] = (
    ("ur10_unisa", 5.45, "tau", ()),
    ("panda_unisa", 4.0, "tau", ()),
    ("kuka_lwr4plus", 3.58, "tau", ()),
    ("staubli_tx40", 25.3, "tau", ()),
    ("staubli_tx40", 25.3, "tau", wrist(0.05)),
    ("kinova_gen3_dynamapp", 12.66, "tau", ()),
    ("kinova_gen3_dynamapp", 12.66, "tau_current", ()),
    ("ur10e_innopolis", 10.0, "", ()),
)
QUICK = ("panda_unisa", "ur10_unisa")

# A joint slower than this stands still, rad/s.
STILL = 0.01

LEAST_SQUARES = ("coulomb", "square_root", "viscous", "offset")


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
    after: float | None = None
    terms: tuple[Any, ...] = ()

    def __str__(self) -> str:
        return self.name

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

    @property
    def rest(self) -> sdpid.Recording:
        """The first recording to predict."""
        return next(iter(self.others.values()))

    def trained(self, processing: sdpid.Processing) -> sdpid.Samples:
        """Return the training samples, which saw nothing of the rest."""
        return samples_of(self.robot, self.log, processing)

    def held_out(
        self, processing: sdpid.Processing, other: sdpid.Recording | None = None
    ) -> sdpid.Samples:
        """Return the samples of a recording to predict, the first by default.

        A record's rest is filtered with its own past before it, which is what was measured then;
        nothing of the rest reaches the training samples.
        """
        samples = samples_of(self.robot, other or self.rest, processing)
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

    def identify(self, **given: Any) -> Any:
        """Return what `identify` finds with its defaults, and the terms of a known drive."""
        return sdpid.identify(self.robot, self.log, intervals=False, **self.arguments(given))


def ur10e_logs(folder: Path, runs: Iterable[str]) -> list[sdpid.Recording]:
    """Return runs of the UR10e, of which currents were recorded."""
    kinds = ("position", "velocity", "effort")
    columns = {"time": 1, **{k: list(range(2 + 6 * i, 8 + 6 * i)) for i, k in enumerate(kinds)}}
    return [
        sdpid.read_recording(folder / f"{run}.csv", columns=columns, effort_scale=GAINS)
        for run in runs
    ]


def cases(data: Path, names: Iterable[str]) -> Iterator[Case]:
    """Yield the cases of the sets that are there, and say which are not."""
    for arm in records_of(data, names):
        for name, *known in READERS:
            if name == arm.name:
                yield from _read(arm, *known)


def _read(arm: Records, scored_hz: float, effort: str, terms: tuple[Any, ...]) -> Iterator[Case]:
    """Yield the cases of a set: of one record its first part, of two each, of the UR10e one run."""
    if not arm.runs:
        own, *logs = ur10e_logs(arm.folder, (UR10E_TRAINED, *UR10E.values()))
        others = dict(zip(UR10E, logs, strict=True))
        yield Case("UR10e, 30 s", str(arm), arm.robot, own, others, scored_hz)
        return
    first, *more = arm.logs(effort)
    kind = " with its terms" if terms else "" if effort == "tau" else " currents"
    if not more:
        log, _ = cut(first, TRAINED)
        title, end = f"{arm}{kind}, first 60 %", float(log.time[-1])
        yield Case(title, str(arm), arm.robot, log, {"rest": first}, scored_hz, end, terms)
        return
    for own, log, other in ((1, first, more[0]), (2, more[0], first)):
        others = {f"run {3 - own}": other}
        yield Case(f"{arm}{kind}, run {own}", str(arm), arm.robot, log, others, scored_hz)


def first_of_arms(data: Path, names: Iterable[str], *, known_drives: bool) -> dict[str, Case]:
    """Return the first case of each arm, or that with the terms of its drive if it is known."""
    found: dict[str, Case] = {}
    for case in cases(data, names):
        if (case.terms and known_drives) or case.robot_name not in found:
            found[case.robot_name] = case
    return found


def moving(samples: sdpid.Samples) -> Mask:
    """Return which rows (K, n) are of joints that move."""
    return np.asarray(np.abs(samples.velocity) > STILL)


def error(
    case: Case, estimate: Estimate, other: sdpid.Recording, *, only_moving: bool = True
) -> float:
    """Return the error of predicted efforts over the efforts, in %, on common rows."""
    samples = samples_of(case.robot, other, case.common)
    kept = np.ones(samples.effort.shape, np.bool_) if samples.mask is None else samples.mask
    if case.after is not None:
        assert samples.time is not None
        kept = kept & (samples.time > case.after)[:, None]
    if only_moving:
        kept = kept & moving(samples)
    missed = samples.effort - sdpid.validate(estimate, samples).effort_predicted
    return 100.0 * float(np.linalg.norm(missed[kept]) / np.linalg.norm(samples.effort[kept]))


def least_squares(case: Case) -> Estimate | None:
    """Return the plain least-squares fit to the common rows that move, if they determine one."""
    samples = case.trained(case.common)
    samples = replace(samples, mask=moving(samples))
    terms = (*LEAST_SQUARES, *case.terms)
    try:
        problem = sdpid.build_problem(case.robot, samples, friction=terms, weighting="gls")
        return sdpid.solve_wls(problem)
    except sdpid.errors.IdentifiabilityError:
        return None


def rows(case: Case) -> Rows:
    """Yield a row for every recording that is predicted."""
    try:
        estimate = case.identify().estimate
    except sdpid.errors.SdpidError as wrong:
        yield case.name, str(wrong), None, None, None
        return
    plain = least_squares(case)
    for label, other in case.others.items():
        errors = (error(case, estimate, other, only_moving=each) for each in (False, True))
        yield label, *errors, None if plain is None else error(case, plain, other)


HEADER = ("trained on", "predicted", "common rows, %", "moving", "least squares, moving")


# Candidates for the cut-off, as factors of the default one, which is the first.
FACTORS = (1.0, 0.5, 0.8, 1.2, 2.0)
# A cut-off is at most this share of the rate.
HIGHEST = 2.0 / 15.0
# Another candidate must predict better than the default by more than this: what is seen on other
# choices of robots is 1 % of luck.
BETTER = 1.01
# What is given beside the defaults, the first of each being the default.
CANDIDATES: dict[str, dict[str, float | dict[str, Any]]] = {
    "cut-off": {f"{factor:g} times the default's": factor for factor in FACTORS},
    "mask": {"default": {}, "none": {"processing": {"reversal_time": None}}},
}


def mean(values: Any) -> float:
    """Return the geometric mean."""
    return float(np.exp(np.mean(np.log(values))))


def scored(candidate: str, case: Case) -> Rows:
    """Yield the geometric mean of a case's errors in %, infinite where there is no estimate."""
    title, _, label = candidate.partition(": ")
    given = CANDIDATES[title][label]
    if isinstance(given, float):
        cutoff = min(given * default_processing(case.log).cutoff_hz, HIGHEST * case.log.rate_hz)
        given = {"processing": {"cutoff_hz": cutoff}}
    try:
        estimate = case.identify(**given).estimate
    except sdpid.errors.SdpidError:
        yield label, case.robot_name, case.name, float("inf")
        return
    errors = [error(case, estimate, other) for other in case.others.values()]
    yield label, case.robot_name, case.name, mean(errors)


def chosen(robots: dict[str, dict[str, float]]) -> Rows:
    """Yield of each robot what the others would have chosen, by errors with each candidate."""
    default = next(iter(robots))
    for name in robots[default]:
        others = {
            label: float(np.mean([np.log(own[other]) for other in own if other != name]))
            for label, own in robots.items()
        }
        best = min(others, key=lambda label: others[label])
        yield name, default if others[best] > others[default] - np.log(BETTER) else best


def errors(study: Study) -> None:
    """Predict what was not trained on."""
    study.rows("held_out.csv", HEADER, rows, cases(study.data, study.sets), digits=3)


def defaults(study: Study) -> None:
    """Compare candidates for the defaults."""
    found = [*cases(study.data, study.sets)]
    for title, candidates in CANDIDATES.items():
        wanted = [f"{title}: {label}" for label in candidates][: study.candidates]
        header = ("candidate", "robot", "case", "error")
        errors = study.rows(f"{title}.cases.csv", header, scored, wanted, found)
        lines, robots = [], {}
        for (label,), own in grouped(errors, "candidate"):
            names = dict.fromkeys(own["robot"])
            robots[label] = {name: mean(own["error"][own["robot"] == name]) for name in names}
            lines.append((label, *own["error"], mean([*robots[label].values()])))
        study.write(f"{title}.csv", (title, *map(str, found), "robots' mean"), lines, digits=3)
        study.write(f"{title}.chosen.csv", ("left out", "the others choose"), chosen(robots))


def main() -> None:
    """Write the tables that are asked for."""
    parts = {"errors": errors, "defaults": defaults}
    study = Study(
        __doc__,
        data=True,
        quick={"sets": [*QUICK], "candidates": 1},
        parts=[*parts],
        sets=[*EVERY],
        candidates=(max(map(len, CANDIDATES.values())), "for each default"),
    )
    for part in study.parts:
        parts[part](study)


if __name__ == "__main__":
    main()
