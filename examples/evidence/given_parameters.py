"""How far parameters from elsewhere are from the best that a robot can have, proven.

Table IV of the Denso paper against a short simulated log, whose truth is the nearest bodies to its
constrained column; and the links of the TX40's description, with friction refitted, against its
public record.

    python examples/evidence/given_parameters.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

from pathlib import Path

from data_sets import Records, records_of, wrist
from study import Rows, Study

import sdpid
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.workflow.certify_parameters import GivenParameters, certify_parameters, read_given
from sdpid.workflow.formulate import formulate

DENSO = Path(__file__).resolve().parents[2] / "models" / "denso_vp6242"
HEADER = (
    *("parameters", "consistency", "bodies", "cost", "bound", "over_the_bound"),
    *("residual_percent", "optimum_percent"),
)


def judged(title: str, problem: Problem, given: GivenParameters) -> tuple[object, ...]:
    """Return one row: feasible or not, cost beside the proven bound, and relative residuals."""
    found = certify_parameters(problem, given)
    bodies = "feasible" if found.feasible else "not feasible"
    if found.audit is not None:
        bodies = found.audit.verdict
    cost, bound = found.estimate.cost, found.certificate.lower_bound
    given_to = 100.0 * found.residuals["given"], 100.0 * found.residuals["optimum"]
    return title, problem.consistency, bodies, cost, bound, cost / bound, *given_to


def denso(periods: int, period: float) -> Rows:
    """Yield the paper's columns, and the truth."""
    robot = sdpid.load_robot("denso_vp6242")
    theta = true_parameters("denso_vp6242")
    motion = sdpid.paper_excitation("denso_vp6242", 0, periods=periods, period=period)
    log = sdpid.simulate(robot, motion, theta=theta, seed=0, progress=False)
    terms = ("coulomb", "viscous")
    for consistency in ("pseudo_inertia", "spatial_inertia"):
        problem = formulate(robot, log, friction=terms, effects="none", consistency=consistency)
        for column in ("cwls", "wls"):
            table = read_given(DENSO / "table_iv.csv", robot, value=column)
            yield judged(f"Denso, Table IV, {column.upper()}", problem, table)
        truth = dict(zip(problem.base.theta_names, map(float, theta), strict=True))
        yield judged("Denso, the truth", problem, GivenParameters(source="truth", values=truth))


def tx40(arm: Records) -> Rows:
    """Yield the links of the description, friction and drives refitted."""
    robot = arm.robot
    problem = formulate(
        robot,
        arm.logs()[0],
        friction=(sdpid.friction.Coulomb(0.05), "viscous", "offset", *wrist(0.05)),
        effects="none",
        prior=False,
    )
    links = dict(zip(robot.parameter_names, robot.prior.ravel().tolist(), strict=True))
    yield judged("TX40, links of its URDF", problem, GivenParameters(source="urdf", values=links))


def main() -> None:
    """Judge all and write the table."""
    study = Study(__doc__, data=True, quick={"period": 19.0}, period=(76.0, "of the log, s"))
    arms = records_of(study.data, ["staubli_tx40"])
    study.rows(
        "given_parameters.csv",
        HEADER,
        lambda arm: denso(8, study.period) if arm == "Denso" else tx40(arm),
        ["Denso", *arms],
    )


if __name__ == "__main__":
    main()
