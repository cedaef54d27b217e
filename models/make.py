"""Make the folders of identified robots, and their pages, from public records.

    python models/make.py ur10 panda     # identify these again, with SDPID_DATA set
    python models/make.py                # all of recipes.toml
    python models/make.py --pages        # write the pages anew from what is there

Each row of recipes.toml is one run of ``sdpid identify``, whose folder is kept as it is. A second
run fits a part and predicts the rest, and is only told of, in held_out.json: the first recording
of several, or the first 60 % of one. Every number on a page comes from these files.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.files import atomic_write_text, load_toml
from sdpid._common.tables import json_text

HERE = Path(__file__).resolve().parent
RECIPES = HERE / "recipes.toml"
HELD_OUT = "held_out.json"

# Of the only recording, the part that is fitted while the rest is predicted.
FITTED = 0.6

# Models that are compared, and what pages call them.
SIDES = {
    "description as it is": "the description as it is",
    "description, friction fitted": "the description, friction fitted",
    "least squares": "least squares",
    "this estimate": "this estimate",
}
BODY = ("xx", "xy", "xz", "yy", "yz", "zz", "mx", "my", "mz", "m")

Row = Mapping[str, Any]


def recipes() -> dict[str, Row]:
    """Return the rows of recipes.toml."""
    return load_toml(RECIPES)


def command(row: Row, logs: list[str], *more: str) -> list[str]:
    """Return the arguments of ``sdpid`` that identify a robot from logs."""
    return ["identify", *logs, "--robot", row["robot"], *row.get("options", ()), *more]


def _run(arguments: list[str], folder: Path) -> None:
    """Run ``sdpid`` in a folder."""
    subprocess.run([sys.executable, "-m", "sdpid", *arguments], cwd=folder, check=True)


def _parts(log: Path) -> list[str]:
    """Write the two parts of a recording beside it, and return their names in the records."""
    with np.load(log, allow_pickle=False) as file:
        fields = dict(file)
    rows = len(fields["t"])
    cut, names = int(FITTED * rows), []
    for name, part in (("fitted", slice(cut)), ("predicted", slice(cut, None))):
        path = log.with_name(f"{log.stem}_{name}.npz")
        of_rows = {key: value.ndim and len(value) == rows for key, value in fields.items()}
        np.savez(path, **{k: v[part] if of_rows[k] else v for k, v in fields.items()})
        names.append(f"{log.parent.name}/{path.name}")
    return names


def make(name: str, row: Row, data: Path) -> None:
    """Identify a robot, and keep the folder; paths in it are those below the folder of records."""
    kept = HERE / name / "identified"
    with tempfile.TemporaryDirectory() as place:
        records = Path(place)
        for file in (*row["logs"], row["robot"]):
            (records / file).parent.mkdir(exist_ok=True)
            shutil.copy(data / file, records / file)
        _run(command(row, row["logs"], "--bare", "--out", f"{name}_identified"), records)
        shutil.rmtree(kept, ignore_errors=True)
        shutil.copytree(records / f"{name}_identified", kept)
        if "--law" in row.get("options", ()):
            return  # it predicts the fastest third of the log itself
        logs = list(row["logs"])
        fitted, *rest = logs if len(logs) > 1 else _parts(records / logs[0])
        judge = [each for other in rest for each in ("--validation", other)]
        quick = ("--no-intervals", "--bare", "--rollout", "--out", "judged")
        _run(command(row, [fitted], *judge, *quick), records)
        judged = json.loads((records / "judged" / "result.json").read_text(encoding="utf-8"))
    atomic_write_text(kept / HELD_OUT, json_text(_told(judged, len(logs))) + "\n")


def _told(judged: Row, logs: int) -> dict[str, Any]:
    """Return what a page tells of the run that predicts: errors, and positions of rollouts."""
    held, moved = judged["held_out"], judged["rollouts"][0]
    return {
        "fitted": f"the first {100.0 * FITTED:.0f} %" if logs == 1 else "the first recording",
        "predicted": "the rest" if logs == 1 else "the other",
        "errors": {side: held[side]["moving"] for side in SIDES if side in held},
        "horizons": moved["horizons"],
        "starts": moved["starts"],
        "rollouts": {
            side: {key: moved["models"][side][key] for key in ("median", "diverged")}
            for side in (*SIDES, "constant velocity")
            if side in moved["models"]
        },
    }


def page(name: str, row: Row) -> str:
    """Return the page of a robot, from the files in its folder."""
    head = [f"# {row['title']}", row["recorded"], f"Source: {row['source']} (../../NOTICES.txt)."]
    if "alone" in row:
        head[-1] = f"Source: {row['source']}."
        body = ["## No numbers, the recipe alone", row["alone"], _code(*row["commands"])]
        return _joined([*head, *body])
    folder = HERE / name / "identified"
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    run = shlex.join(["sdpid", *command(row, row["logs"], "--bare", "--out", f"{name}_identified")])
    again = [
        "## Made again",
        "With the public records in `SDPID_DATA` (docs/evidence/data.md), this page and all files:",
        _code(f"python models/make.py {name}"),
        "which runs, in that folder,",
        _code(run),
        "The proof needs no records"
        + (
            ":"
            if "law" in result
            else "; with them (`--data`) the rest is made again and compared:"
        ),
        _code(f"sdpid verify {name}"),
    ]
    use = [
        "## Use",
        _code(
            f'robot = sdpid.load_robot("{name}_identified")  # links, as the file has them',
            f'saved = sdpid.load("{name}")  # .base, .standard, .to_frame(), .plot()',
            *([] if "law" in result else ["model = saved.model()  # friction and all effects too"]),
        ),
    ]
    return _joined([*head, *use, *_good_for(result, folder), *_known(result, folder), *again])


def _joined(parts: list[str]) -> str:
    return "\n\n".join(part for part in parts if part) + "\n"


def _code(*lines: str) -> str:
    """Return lines as a block of code."""
    return "\n".join(("```text", *lines, "```"))


def _table(*rows: tuple[object, ...]) -> str:
    """Return rows as a table, the first one its header."""
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in rows]
    return "\n".join((lines[0], "|" + "---|" * len(rows[0]), *lines[1:]))


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


def _good_for(result: Row, folder: Path) -> Iterator[str]:
    """Yield what the model predicts, how far its motion leaves the measured one, and the advice."""
    told = result["headline"]
    yield "## What it is good for"
    yield f"**{told['title']}.**"
    if "law" in result:
        law = result["law"]
        rows = ((kinds.replace("+", ", "), f"{1e3 * e:.3g}") for kinds, e in law["judged"].items())
        yield "Rms of positions in rollouts of the fastest third of the log, fitted without it:"
        yield _table(("fitted beside the links", "mrad"), *rows)
        reduced, rich = (f"{1e3 * law[key]:.3g}" for key in ("rms_reduced", "rms"))
        yield (
            f"All of the log fitted: {rich} mrad with friction over position (tendons of "
            f"identified.xml), {reduced} mrad with constants (drives_*.py, drives.csv)."
        )
    else:
        yield from _errors(result, json.loads((folder / HELD_OUT).read_text(encoding="utf-8")))
    labels = {
        "worst": "worst joint",
        "delay": "delay",
        "given_up": "given up",
        "found": "found",
        "file": "robot file",
        "tilt": "base",
        "proven": "proven",
    }
    lines = [f"- {label}: {told[key]}" for key, label in labels.items() if told.get(key)]
    yield "\n".join([*lines, *(f"- do not {each}" for each in told["warnings"])])


def _errors(result: Row, judged: Row) -> Iterator[str]:
    """Yield tables of missed efforts, of rollouts, and of joints."""
    held = result["held_out"]
    yield (
        "Missed effort in motion, share of the effort. Blocks: this model, each of "
        f"{held['blocks']} blocks predicted by a fit to the others. Rest: {judged['fitted']} "
        f"fitted, {judged['predicted']} predicted."
    )
    yield _table(
        ("", "blocks", "rest"),
        *(
            (
                title,
                _percent(held[side]["moving"]["relative_residual"]),
                _percent(judged["errors"][side]["relative_residual"]),
            )
            for side, title in SIDES.items()
            if side in held
        ),
    )
    times = [f"{each:g} s" for each in judged["horizons"]]
    yield (
        f"Let go under the measured efforts of {judged['predicted']}, from {judged['starts']} "
        "instants: median error of the joints' positions, mrad, after"
    )
    moved = judged["rollouts"].items()
    yield _table(
        ("", *times),
        *((SIDES.get(side, side), *map(_milli, each["median"])) for side, each in moved),
    )
    blocks, rest = held["this estimate"]["moving"], judged["errors"]["this estimate"]
    yield _table(
        ("joint", "missed, blocks", "missed, rest", "rms, N·m"),
        *(
            (joint, _share(own), _share(rest["joints"][joint]), _rms(own))
            for joint, own in blocks["joints"].items()
        ),
    )


def _milli(value: float | None) -> str:
    return "ran away" if value is None else f"{1e3 * value:.3g}"


def _share(errors: Row) -> str:
    return "did not move" if errors["nrmse"] is None else _percent(errors["nrmse"])


def _rms(errors: Row) -> str:
    return "" if errors["rmse"] is None else f"{errors['rmse']:.3g}"


def _known(result: Row, folder: Path) -> Iterator[str]:
    """Yield a table of links: how much of each the data tell."""
    parameters = json.loads((folder / "parameters.json").read_text(encoding="utf-8"))
    found = {each["name"]: each for each in result["intervals"]["parameters"]}
    yield "## Which links are known"
    if "law" in result:
        yield "Of the convex fit (parameters.json), from which positions were fitted:"
    prior = result["problem"]["prior"]
    told_by = "the data tell better than the prior" if prior else "have intervals that exclude zero"
    yield (
        f"Of each link's base parameters, those that {told_by}. Efforts depend on base parameters "
        "alone; a mass is known only where it is one."
    )
    rows: list[tuple[object, ...]] = []
    for number, link in parameters["links"].items():
        base = [name for name in parameters["base"] if _body_of(name) == number]
        known = [
            each["label"] == "from data" and (prior or each["lower"] * each["upper"] > 0.0)
            for each in map(found.get, base)
            if each is not None
        ]
        mass = parameters["standard"][f"m_{number}"]["value"]
        told = "told by the data" if f"m_{number}" in found else "not told by the data"
        rows.append((link, f"{sum(known)} of {len(base)}", f"{mass:.3g}, {told}"))
    yield _table(("link", "base parameters known", "mass, kg"), *rows)


def _body_of(name: str) -> str | None:
    """Return the number of the link that a base parameter of bodies is of."""
    kind = name.rstrip("0123456789")
    return name[len(kind) :] if kind.removesuffix("r") in BODY else None


def write_pages() -> None:
    """Write every page, and the list of them."""
    for name, row in recipes().items():
        folder = HERE / name if "alone" in row else HERE / name / "identified"
        if "alone" in row or folder.is_dir():
            folder.mkdir(exist_ok=True)
            atomic_write_text(folder / "README.md", page(name, row))
    atomic_write_text(HERE / "README.md", listing())


def listing() -> str:
    """Return the list of all robots, with what they miss."""
    rows: list[tuple[object, ...]] = []
    for name, row in recipes().items():
        file = HERE / name / "identified" / "result.json"
        if "alone" in row:
            rows.append((f"`{name}`", row["title"], "recipe alone", ""))
        elif file.exists():
            result = json.loads(file.read_text(encoding="utf-8"))
            rows.append((f"`{name}`", row["title"], *_missed(result)))
    text = (
        "Made from public records by `python models/make.py`. Missed is the effort in motion, "
        "block by block of the log, each predicted by a fit to the others; of robots whose torque "
        "was not measured the positions of its fastest third. `NAME/identified/README.md` says who "
        "recorded what, what the model is good for and which links are not known; where a license "
        "does not allow more, `NAME/README.md` has the commands alone."
    )
    table = _table(("name", "robot", "missed", "least squares misses"), *rows)
    return _joined(["# Identified robots", text, table])


def _missed(result: Row) -> tuple[str, str]:
    """Return what the model misses, and what least squares misses."""
    if "law" in result:
        return f"{1e3 * min(result['law']['judged'].values()):.3g} mrad of positions", ""
    own, free = (result["held_out"][each]["moving"] for each in ("this estimate", "least squares"))
    return _percent(own["relative_residual"]), _percent(free["relative_residual"])


def main() -> None:
    """Make what is asked for."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", 1)[0])
    parser.add_argument("names", nargs="*", help="rows of recipes.toml; default: all")
    parser.add_argument("--pages", action="store_true", help="write the pages alone")
    given = parser.parse_args()
    rows = {name: row for name, row in recipes().items() if "alone" not in row}
    for name in () if given.pages else given.names or rows:
        make(name, rows[name], Path(os.environ["SDPID_DATA"]))
    write_pages()


if __name__ == "__main__":
    main()
