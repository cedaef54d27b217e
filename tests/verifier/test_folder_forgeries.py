"""Forged results folders: whoever writes all digests anew is found by the numbers themselves."""

import json
import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import sdpid
from sdpid.verifier.reading import digest
from sdpid.verifier.results.friction_code import WRITERS
from tests.helpers.commands import alone
from tests.helpers.forged import edit, reseal
from tests.helpers.runs import arm, recorded


def made(folder: Path, seed: int) -> Path:
    """Write the results of a run."""
    sdpid.identify(arm(), recorded(seed), intervals=False).save(folder, figures=False)
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a run."""
    return made(tmp_path_factory.mktemp("run"), 1)


@pytest.fixture
def results(run: Path, tmp_path: Path) -> Path:
    """A copy of them."""
    shutil.copytree(run, tmp_path / "results")
    return tmp_path / "results"


def problems(folder: Path) -> list[str]:
    """Return what is not proven; there is something, and it is said in words."""
    done = alone(folder)
    assert done.returncode in (1, 2), done.stdout
    assert "Traceback" not in done.stderr
    lines = [line for line in done.stdout.splitlines() if line.startswith("NOT PROVEN: ")]
    return lines or [done.stderr]


def compared(folder: Path) -> tuple[str, ...]:
    """Return what is not proven once the package has read the robots; there is something."""
    found = sdpid.verify(folder).problems
    assert found
    return found


def test_resealing_what_is_unchanged_is_no_forgery(results: Path) -> None:
    reseal(results)
    done = alone(results)
    assert done.returncode == 0, done.stdout
    assert done.stdout.splitlines()[-1].startswith("PROVEN")


@pytest.mark.parametrize("name", ["identified.urdf", "identified.xml", "parameters.json"])
def test_a_file_of_another_run_is_named(name: str, results: Path, tmp_path: Path) -> None:
    other = made(tmp_path / "other", 2)
    shutil.copy(other / name, results / name)
    reseal(results)
    found = compared(results)
    assert all(name in each for each in found)
    assert any("certifi" in each for each in found)


@pytest.mark.parametrize("name", ["identified.urdf", "identified.xml"])
def test_swapped_links_are_named(name: str, results: Path) -> None:
    tag = "<inertial.*?(?:</inertial>|/>)" if name.endswith(".xml") else "<inertial>.*?</inertial>"

    def swap(text: str) -> str:
        found = re.findall(tag, text, re.DOTALL)
        first, second = found[:2]
        return text.replace(first, "@").replace(second, first).replace("@", second)

    edit(results / name, swap)
    reseal(results)
    assert len([each for each in compared(results) if "link" in each]) >= 2


@pytest.mark.parametrize("name", ["identified.urdf", "identified.xml", "parameters.csv"])
def test_a_file_that_is_not_sealed_is_none_of_the_run(name: str, results: Path) -> None:
    """A swapped file that neither manifest nor result.json names any more is not passed over."""

    def forget(text: str) -> str:
        data = json.loads(text)
        data["exports"] = [each for each in data["exports"] if each["file"] != name]
        return json.dumps(data)

    if name != "parameters.csv":
        edit(results / "result.json", forget)
    edit(results / name, lambda text: re.sub("([1-9])", lambda m: str(10 - int(m[1])), text))
    reseal(results, without=name)
    assert any(name in each for each in problems(results))


def _forged(path: Path, how: Callable[[dict[str, Any]], object]) -> None:
    """Change the numbers in a file of friction, and write its code anew."""
    text = path.read_text(encoding="utf-8")
    (line,) = (each for each in text.splitlines() if "sdpid-friction: " in each)
    data = json.loads(line.partition("sdpid-friction: ")[2])
    how(data)
    path.write_text(WRITERS[path.suffix](data), encoding="utf-8")


@pytest.mark.parametrize("name", ["identified_friction.py", "identified_friction.hpp"])
def test_forged_friction_is_named(name: str, results: Path, tmp_path: Path) -> None:
    path = results / name
    content = path.read_text(encoding="utf-8")
    mark = "#" if path.suffix == ".py" else "//"

    def found() -> tuple[str, ...]:
        reseal(results)
        said = compared(results)
        path.write_text(content, encoding="utf-8")
        assert all(name in each for each in said), said
        return said

    def double(data: dict[str, Any]) -> None:
        data["terms"][0]["values"][0] *= 2.0

    # A number in the code, a comment, and code at the end.
    for forged in (
        re.sub(r"(\d)( \* )", lambda m: str(9 - int(m[1])) + m[2], content, count=1),
        content.replace("made by a program", "checked by hand"),
        content + f"{mark} x\n",
        content.replace("\n", "\r\n"),
    ):
        path.write_text(forged, encoding="utf-8")
        assert any("code is not what follows" in each for each in found())
    for how, wanted in (
        (double, "'terms' of its numbers"),
        (lambda data: data["terms"].pop(), "'terms' of its numbers"),
        (lambda data: data["terms"].append(data["terms"][0]), "'terms' of its numbers"),
        (lambda data: data.update(robot="another"), "'robot' of its numbers"),
        (lambda data: data.update(certificate="0" * 64), "'certificate' of its numbers"),
        (lambda data: data["joints"].reverse(), "'joints' of its numbers"),
        (lambda data: data["left_out"].append("Tilt"), "'left_out' of its numbers"),
    ):
        _forged(path, how)
        assert any(wanted in each for each in found()), wanted
    for line in ("{", '{"schema": "sdpid-friction"}', "[" * 9000, '{"version": 1, "version": 1}'):
        path.write_text(f"{mark} sdpid-friction: {line}\n", encoding="utf-8")
        assert any("cannot be compared" in each for each in found())
    path.write_text(content + content, encoding="utf-8")
    assert any("2 of its lines" in each for each in found())
    reseal(results, without=name)
    assert any("not sealed" in each for each in problems(results))


def test_links_in_a_circle_end(results: Path) -> None:
    def circle(text: str) -> str:
        text = re.sub(
            '<joint name="(?!x)[^"]*" type="(revolute|continuous)"', _fixed, text, count=1
        )
        child = re.search('<joint [^>]*type="fixed".*?<child link="([^"]*)"', text, re.DOTALL)
        link = child[1]
        joint = '<joint name="x" type="fixed"><parent link="{}"/><child link="{}"/></joint>'
        root = re.search('<link name="([^"]*)"', text)
        return text.replace("</robot>", joint.format(link, root[1]) + "</robot>")

    edit(results / "identified.urdf", circle)
    reseal(results)
    assert any("identified.urdf" in each for each in compared(results))


def _fixed(match: re.Match[str]) -> str:
    return match[0].replace(match[1], "fixed")


@pytest.mark.parametrize("cell", ['"', "\0", "1_0.5", "\u0661", "nan", "x" * 200_000])
def test_odd_tables_are_told_in_words(cell: str, results: Path) -> None:
    edit(results / "parameters.csv", lambda text: text.replace("\n", f"\n{cell},", 1))
    reseal(results)
    assert any("parameters.csv" in each for each in problems(results))


@pytest.mark.parametrize("cell", ["{}_0", " {}", "{}\u00a0"])
def test_numbers_that_other_readers_refuse_are_none(cell: str, results: Path) -> None:
    path = results / "parameters.csv"
    header, first, *others = path.read_text(encoding="utf-8").splitlines()
    column, values = header.split(",").index("value"), first.split(",")
    number = values[column]
    assert float(number)
    values[column] = cell.format(f"{number}.0" if "." not in number else f"{number}")
    path.write_text("\n".join([header, ",".join(values), *others]) + "\n", encoding="utf-8")
    reseal(results)
    assert any("parameters.csv" in each for each in problems(results))


def test_axes_cannot_be_turned_behind_a_long_quaternion(results: Path) -> None:
    """The same axes written by a huge quaternion, turned by 1e-4: no rounding of its digits."""

    def turn(text: str) -> str:
        found = re.search('<inertial [^>]*quat="([^"]*)"', text)
        w, x, y, z = map(float, found[1].split())
        half = 0.5e-4
        turned = (w - half * x, x + half * w, y + half * z, z - half * y)
        norm = math.sqrt(sum(value * value for value in turned))
        long = " ".join(repr(9e11 * value / norm) for value in turned)
        return text.replace(found[1], long, 1)

    edit(results / "identified.xml", turn)
    reseal(results)
    assert any("identified.xml" in each for each in compared(results))


def test_another_gravity_is_not_passed_over(results: Path) -> None:
    edit(
        results / "identified.xml", lambda text: re.sub('gravity="[^"]*"', 'gravity="0 0 5"', text)
    )
    reseal(results)
    assert any("gravity" in each for each in sdpid.verify(results).unchecked)


@pytest.mark.parametrize(
    "head",
    [
        '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>',
        '<!DOCTYPE robot SYSTEM "file:///etc/passwd">',
    ],
)
def test_entities_are_refused(head: str, results: Path) -> None:
    edit(results / "identified.urdf", lambda text: re.sub("<robot", head + "<robot", text, count=1))
    reseal(results)
    assert any("document type" in each for each in compared(results))


@pytest.mark.parametrize("name", ["../run.csv", "/etc/passwd", "a\\b", "", ".", "manifest.json"])
def test_a_manifest_names_files_of_its_folder(name: str, results: Path) -> None:
    path = results / "manifest.json"
    manifest: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    manifest["files"][name] = {"bytes": 0, "sha256": "0" * 64}
    path.write_text(json.dumps({**manifest, "sha256": digest(manifest)}), encoding="utf-8")
    assert problems(results)
