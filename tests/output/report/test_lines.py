"""The terminal's lines say what the report's boxes say, on public recordings and on wrong logs."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import sdpid
from sdpid.errors import SdpidError
from sdpid.experiment.inspection.accept import REFUSED
from sdpid.output.report.report import report_html
from sdpid.output.report.verdict import findings
from sdpid.workflow.result import Identification
from tests.experiment.inspection.test_inspect import WRONG, simulated
from tests.output.test_report import elements

# Description, log, and another recording where there is one.
RECORDS: dict[str, tuple[str, str, str | None]] = {
    "ur10_unisa": ("ur10.urdf", "ur10_exciting.npz", None),
    "panda_unisa": ("panda.urdf", "panda_exciting.npz", None),
    "kuka_lwr4plus": ("kuka_lwr4.urdf", "measurements_1.npz", "measurements_2.npz"),
    "staubli_tx40": ("tx40.urdf", "tx40_rows_0_24750.npz", None),
    "kinova_gen3_dynamapp": ("gen3.urdf", "opti_traj_testing1.npz", "opti_traj_testing2.npz"),
    "kr300": ("kr300.urdf", "run_A.npz", "run_B.npz"),
}
CURRENTS = [14.87, 13.26, 11.13, 10.62, 11.03, 11.47]


def text_of(element: Any) -> str:
    return re.sub(r"\s+", " ", "".join(element.itertext())).strip()


def number_of(text: str) -> float:
    return float(text.replace("−", "-").removesuffix(" %").replace("–", "nan"))


def unlike(result: Identification) -> Iterator[str]:
    """Yield what of the report the terminal has not, or has otherwise."""
    page, headline = report_html(result), result.headline
    lines = headline.lines
    red = [text_of(box) for box in elements(page, "li") if box.get("class") == "bad"]
    # Red boxes of the verdict, in their words, and of the log.
    warned = {"Do not trust" + each.text: each.warning for each in findings(result)}
    warned = {re.sub(r"\s+", " ", text).strip(): words for text, words in warned.items()}
    for box in red:
        if box.startswith("accepted all the same"):
            if not any(str(each) in line for each in result.findings for line in headline.log):
                yield box
        elif not (warned.get(box) and any(line.endswith(warned[box]) for line in lines)):
            yield box
    for each in result.findings:
        told = each.severity == "note" or each.kind == "continued" or each.line() in headline.log
        if not told:
            yield each.line()
    # One error in all places: the bars, the tile, JSON, and the line.
    if result.held_out is not None and result.held_out.fit.moving.rows.any():
        line = re.sub(r", no robot \([^)]*\)", "", lines[1])
        said = [float(share) for share in re.findall(r"([\d.e+-]+) %", line)]
        bars = [
            number_of(text_of(row.find("{*}td")))
            for table in elements(page, "table")
            if "bars are logarithmic" in text_of(table)
            for row in table.find("{*}tbody")
        ]
        held = result.to_dict()["held_out"]
        own = [
            100.0 * held[name]["moving"]["relative_residual"]
            for name in held
            if name not in ("by", "blocks")
        ]
        for what, found in (("line", said), ("bars", bars)):
            if found != pytest.approx(own, rel=6e-3):
                yield f"{what}: {found}, JSON {own}"
    tiles = {
        text_of(each.find("{*}dt")): text_of(each.find("{*}dd"))
        for each in elements(page, "div")
        if each.find("{*}dt") is not None
    }
    training = number_of(tiles["training relative residual"])
    if training != pytest.approx(100.0 * result.training.told.relative, rel=6e-3):
        yield f"training: {training}"
    # Where least squares is no robot.
    share = re.search(r"M < 0 (all along|on ([\d.e+-]+) %)", lines[1])
    told = 0.0 if share is None else 100.0 if share[2] is None else float(share[2])
    (table,) = [t for t in elements(page, "table") if "Least eigenvalue" in text_of(t)]
    row = next(r for r in table.iter("{*}tr") if text_of(r).startswith("least squares"))
    shown = number_of(text_of(row[-1]))
    if "least squares" in lines[1] and told != pytest.approx(shown, rel=6e-3):
        yield f"no robot: {told}, {text_of(row)}"


@pytest.mark.parametrize("name", RECORDS)
def test_public_recordings(data_folder: Path, name: str) -> None:
    robot, log, validation = RECORDS[name]
    folder = data_folder / name
    others = None if validation is None else folder / validation
    result = sdpid.identify(folder / robot, folder / log, validation=others, intervals=False)
    assert list(unlike(result)) == []


def test_public_currents(data_folder: Path) -> None:
    folder = data_folder / "ur10e_innopolis"
    columns = {"time": 1, "position": [*range(2, 8)], "effort": [*range(14, 20)]}
    logs = [
        sdpid.read_recording(
            folder / f"20_02_05-20sec_{k}harm.csv", columns=columns, gains=CURRENTS
        )
        for k in (8, 12)
    ]
    robot = folder / "ur10e.urdf"
    result = sdpid.identify(robot, logs[0], validation=logs[1], intervals=False)
    assert list(unlike(result)) == []


@pytest.mark.parametrize("name", WRONG)
def test_wrong_logs(name: str) -> None:
    robot = sdpid.load_robot("ur_description/ur5_robot")
    log = WRONG[name][0](simulated(robot, 1))
    kinds: list[str] = []
    while True:
        try:
            result = sdpid.identify(robot, log, accept=kinds, intervals=False, effects="none")
        except SdpidError as cause:
            # Refused: everybody is told, and nothing is written. Overruled by name it goes on.
            more = {kind for kind in REFUSED if f"--accept {kind}" in str(cause)} - {*kinds}
            if not more:
                assert WRONG[name][2] == "refuse"
                return
            kinds += more
        else:
            assert list(unlike(result)) == []
            return
