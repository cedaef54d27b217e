"""A results folder whose files do not hold the proven numbers is named, sealed anew or not."""

import json
import math
import re
import shutil
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import sdpid
import sdpid.verifier
from sdpid.output.robots.principal_axes import along, principal_axes, rotation
from sdpid.robot.inertia import physical_parameters
from sdpid.verifier.command import check_path
from sdpid.verifier.reading import MalformedError
from sdpid.verifier.result import Result
from sdpid.verifier.results.inertials import central, exists, inside, rounded, tensor
from sdpid.verifier.results.manifest import sealed
from sdpid.verifier.results.markup import Node, parse
from sdpid.workflow.verify import Verification
from tests.helpers.commands import VERIFIER, alone
from tests.helpers.forged import edit, reseal
from tests.helpers.refusals import refuses
from tests.helpers.runs import arm, recorded
from tests.helpers.strategies import bodies

SHARP = ("coulomb", "viscous")


def saved(seed: int, folder: Path, **options: Any) -> Path:
    result = sdpid.identify(arm(), recorded(seed), intervals=False, **options)
    result.save(folder, figures=False, config="# options\n")
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved(1, tmp_path_factory.mktemp("runs") / "one", friction=SHARP)


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of another log."""
    return saved(2, tmp_path_factory.mktemp("runs") / "other", friction=SHARP)


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def verified(path: Path) -> Result:
    """Return what the stand-alone checker says."""
    return check_path(path).result


def compared(path: Path) -> Verification:
    """Return what the package says, which reads robots too; the checker says no more."""
    found = sdpid.verify(path)
    assert {*verified(path).problems} <= {*found.problems}
    return found


@pytest.mark.parametrize("sizes", [{"report.html": 2**29}, {"report.html": 2**28, "b": 2**28}])
def test_files_of_any_size_are_not_hashed(copy: Path, sizes: dict[str, int]) -> None:
    data = json.loads((copy / "manifest.json").read_text())
    for name, size in sizes.items():
        with (copy / name).open("wb") as file:
            file.truncate(size)
        data["files"][name] = {"bytes": size, "sha256": "0" * 64}
    del data["sha256"]
    (copy / "manifest.json").write_text(json.dumps(sealed(data)))
    refuses(MalformedError, r"bytes, and less than|not an integer from 0", verified, copy)


def test_what_was_written_holds(folder: Path) -> None:
    result = compared(folder)
    assert result.problems == ()
    files = "result.json, parameters.json, parameters.csv, base_parameters.csv"
    assert f"{files}: the numbers are the certificate's, to the last digit." in result.statements
    robots = "identified.urdf, identified.xml: the inertia of every link is that of the certified"
    assert any(said.startswith(robots) for said in result.statements)
    assert any("'sdpid verify' of the whole" in said for said in verified(folder).unchecked)
    assert not any("'sdpid verify' of the whole" in said for said in result.unchecked)
    assert any("the log" in said for said in result.unchecked)
    assert any("a digest is no signature" in said for said in result.unchecked)


def test_the_copied_checker_says_the_same(folder: Path, tmp_path: Path) -> None:
    """With the standard library alone, wherever it lies and whatever it is called."""
    there = tmp_path / "checker-1"
    shutil.copytree(VERIFIER, there, ignore=shutil.ignore_patterns("*.pyc"))
    done = alone(folder, there, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == list(verified(folder).lines)


@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_any_digit_of_any_file(folder: Path, tmp_path_factory: Any, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(path.name for path in folder.iterdir())))
    text = (folder / name).read_bytes()
    # The name of the software, at the manifest's head, is not sealed.
    start = text.index(b"inputs") if name == "manifest.json" else 0
    digits = [m.start() for m in re.finditer(rb"\d", text) if m.start() > start]
    assume(digits)
    at = data.draw(st.sampled_from(digits))
    new = data.draw(st.sampled_from(sorted({*b"0123456789"} - {text[at]})))
    path = Path(shutil.copytree(folder, tmp_path_factory.mktemp("digit") / "copy"))
    (path / name).write_bytes(text[:at] + bytes([new]) + text[at + 1 :])
    try:
        problems = verified(path).problems
    except (MalformedError, json.JSONDecodeError):  # no JSON has numbers such as 02
        assert name in ("manifest.json", "certificate.json")
        return
    assert any(name in problem for problem in problems)


URDF_NUMBER = re.compile(r'(?:value|xyz|i[xyz]{2})="([^"]*)"')


@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_any_digit_of_a_urdf_that_is_sealed_anew(
    folder: Path, tmp_path_factory: Any, data: st.DataObject
) -> None:
    """Of inertials, where a digit is more than rounding: the link is named."""
    text = (folder / "identified.urdf").read_text()
    moving = text.index('<link name="upper"')
    places = [
        m.start(1) + k
        for part in re.finditer(r"<inertial>.*?</inertial>", text, re.DOTALL)
        if part.start() > moving
        for m in URDF_NUMBER.finditer(text, part.start(), part.end())
        for k, letter in enumerate(m.group(1))
        if letter.isdigit()
    ]
    at = data.draw(st.sampled_from(places))
    new = data.draw(st.sampled_from(sorted({*"0123456789"} - {text[at]})))
    changed = text[:at] + new + text[at + 1 :]
    old, new = ([float(x) for x in re.findall(r"[-+.\de]*\d[-+.\de]*", t)] for t in (text, changed))
    assume(max(abs(a - b) for a, b in zip(old, new, strict=True)) > 1e-10)
    path = Path(shutil.copytree(folder, tmp_path_factory.mktemp("digit") / "copy"))
    (path / "identified.urdf").write_text(changed)
    reseal(path)
    problems = compared(path).problems
    assert problems
    assert all(each.startswith("identified.urdf: ") for each in problems)
    assert any(re.search(r"link '\w+'|cannot be compared", each) for each in problems)


FORGERIES = {
    "mass of a link": (
        "identified.urdf",
        lambda text: re.sub(r'(name="upper".*?<mass value=")[^"]*', r"\g<1>1.5", text, flags=re.S),
        "link 'upper': its inertia is not that of the certified parameters",
    ),
    "a turned inertial": (
        "identified.urdf",
        lambda text: text.replace('rpy="0 0 0"', 'rpy="0 0 1e-6"'),
        "its inertia is not",
    ),
    "axes by a quaternion": (
        "identified.urdf",
        lambda text: text.replace('rpy="0 0 0"', 'rpy="0 0 0" quat_xyzw="1 0 0 0"'),
        "link 'upper': 'quat_xyzw' of <origin>, which readers may take differently",
    ),
    "a unit": (
        "identified.urdf",
        lambda text: text.replace("<mass ", '<mass unit="g" '),
        "link 'upper': 'unit' of <mass>, which readers may take differently",
    ),
    "a shape in an inertial": (
        "identified.urdf",
        lambda text: text.replace("</inertial>", "<density/></inertial>"),
        "which readers may take differently",
    ),
    "a lower triangle": (
        "identified.urdf",
        lambda text: text.replace("<inertia ", '<inertia iyx="1" '),
        "'iyx' of <inertia>",
    ),
    "another version": (
        "identified.urdf",
        lambda text: text.replace("<robot ", '<robot version="9" '),
        "cannot be compared: .*version",
    ),
    "a cost": (
        "result.json",
        lambda text: re.sub(r'("cost": )[^,]*', r"\g<1>300.0", text),
        r"cost is 300\.0, that of the certified parameters \d",
    ),
    "a cost that is proven": (
        "parameters.json",
        lambda text: re.sub(r'("cost_at_most": \d+\.\d{4})\d', r"\g<1>0", text),
        r"cost_at_most is \d[\d.]*, the certificate has ",
    ),
    "two inertials": (
        "identified.urdf",
        lambda text: text.replace("</inertial>", "</inertial><inertial/>"),
        "has several <inertial>",
    ),
    "two axes of a joint": (
        "identified.urdf",
        lambda text: text.replace(
            '<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><axis xyz="0 1 0"/>', 1
        ),
        "has several <axis>",
    ),
    "two masses": (
        "identified.urdf",
        lambda text: text.replace("<mass ", '<mass value="9"/><mass '),
        "has several <mass>",
    ),
    "two links of a name": (
        "identified.urdf",
        lambda text: text.replace("</robot>", '<link name="upper"/></robot>'),
        "the same name",
    ),
    "another moving link": (
        "identified.urdf",
        lambda text: text.replace(
            "</robot>",
            '<link name="more"/><joint name="m" type="continuous"><parent link="fore"/>'
            '<child link="more"/></joint></robot>',
        ),
        "link 'more': the certificate has no such moving link",
    ),
    "something fixed to a link": (
        "identified.urdf",
        lambda text: text.replace(
            "</robot>",
            '<link name="load"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" '
            'iyy="1" iyz="0" izz="1"/></inertial></link><joint name="f" type="fixed">'
            '<parent link="fore"/><child link="load"/></joint></robot>',
        ),
        "link 'fore'",
    ),
    "an entity": (
        "identified.urdf",
        lambda text: '<!DOCTYPE robot [<!ENTITY m "1">]>' + text,
        "it has a document type",
    ),
    "mass in the MJCF": (
        "identified.xml",
        lambda text: re.sub(r' mass="[^"]*', ' mass="1.5', text, count=1),
        "link 'upper': its inertia is not that of the certified parameters",
    ),
    "a turned body": (
        "identified.xml",
        lambda text: re.sub(r'(<inertial [^>]*quat=")[^"]*', r"\g<1>1.0 0.0 0.0 0.0", text),
        r"link '\w+': its inertia is not",
    ),
    "a long quaternion": (
        "identified.xml",
        lambda text: re.sub(r'(<inertial [^>]*quat=")[^"]*', r"\g<1>1e12 0.0 0.0 0.0", text),
        "its inertia is not",
    ),
    "a compiler's option": (
        "identified.xml",
        lambda text: text.replace("<compiler ", '<compiler settotalmass="9" '),
        "settotalmass",
    ),
    "a geom": (
        "identified.xml",
        lambda text: text.replace("</body>", '<geom size="1"/></body>', 1),
        "which sdpid does not write",
    ),
    "a base parameter": (
        "parameters.json",
        lambda text: re.sub(r'("base": \{\s*"(\w+)": \{\s*"value": )[^,]*', r"\g<1>1.25", text),
        r"base parameter '\w+' is 1\.25, the certificate has ",
    ),
    "another robot": (
        "parameters.json",
        lambda text: text.replace('"robot": "arm"', '"robot": "leg"'),
        "robot is 'leg', the certificate has 'arm'",
    ),
    "parameters in another order": (
        "parameters.json",
        lambda text: json.dumps(
            {**json.loads(text), "standard": dict(reversed(json.loads(text)["standard"].items()))}
        ),
        "their order",
    ),
    "a cell": (
        "parameters.csv",
        lambda text: re.sub(r"(m_2,kg,)[^,]*", r"\g<1>0.5", text),
        r"parameter 'm_2' is 0\.5, the certificate has \d",
    ),
    "a missing row": (
        "base_parameters.csv",
        lambda text: "\n".join(text.splitlines()[:-1]) + "\n",
        "not those of the certificate",
    ),
    "a gap": (
        "result.json",
        lambda text: re.sub(r'"gap": [^,]*', '"gap": 0.0', text),
        r"gap is 0\.0, the certificate has ",
    ),
    "a certificate that others name": (
        "result.json",
        lambda text: re.sub(r'("certificate": ")[0-9a-f]{8}', r"\g<1>00000000", text),
        "certificate is '00000000",
    ),
}


@pytest.mark.parametrize("kind", FORGERIES)
def test_forgeries_that_are_sealed_anew(copy: Path, kind: str) -> None:
    """The manifest is right, and the numbers are named all the same."""
    name, change, words = FORGERIES[kind]
    edit(copy / name, change)
    changed = verified(copy).problems
    assert any(f"'{name}' was changed: " in problem for problem in changed)
    reseal(copy)
    problems = compared(copy).problems
    assert problems
    assert all(problem.startswith(f"{name}: ") for problem in problems)
    assert any(re.search(words, problem) for problem in problems), problems


def test_two_links_that_are_swapped(copy: Path) -> None:
    def swap(text: str) -> str:
        inertial = r'<link name="%s">.*?(<inertial>.*?</inertial>)'
        first, second = (
            match.group(1)
            for link in ("upper", "fore")
            if (match := re.search(inertial % link, text, re.DOTALL))
        )
        return text.replace(first, "@").replace(second, first).replace("@", second)

    edit(copy / "identified.urdf", swap)
    reseal(copy)
    problems = " ".join(compared(copy).problems)
    assert "link 'upper': its inertia" in problems
    assert "link 'fore'" in problems


@pytest.mark.parametrize(
    "name",
    ["identified.urdf", "identified.xml", "parameters.json", "parameters.csv", "result.json"],
)
def test_a_file_of_another_run(copy: Path, other: Path, name: str) -> None:
    shutil.copy(other / name, copy / name)
    assert any(f"'{name}' was changed" in problem for problem in verified(copy).problems)
    reseal(copy)
    problems = compared(copy).problems
    assert problems
    assert all(problem.startswith(f"{name}: ") for problem in problems)


def test_a_certificate_of_another_run(copy: Path, other: Path) -> None:
    """It proves its own numbers, and every other file has different ones."""
    shutil.copy(other / "certificate.json", copy / "certificate.json")
    problems = verified(copy).problems
    assert any("sealed with certificate" in problem for problem in problems)
    reseal(copy)
    named = {
        name for problem in compared(copy).problems for name in problem.split(":")[0].split(", ")
    }
    assert named == {
        *("result.json", "parameters.json", "parameters.csv", "base_parameters.csv"),
        *("identified.urdf", "identified.xml"),
        *("identified_friction.py", "identified_friction.hpp"),
    }


@pytest.mark.parametrize("name", ["identified.urdf", "parameters.csv", "report.html", "run.toml"])
def test_a_file_that_is_gone(copy: Path, name: str) -> None:
    (copy / name).unlink()
    assert any(f"'{name}' is missing" in problem for problem in verified(copy).problems)
    reseal(copy)
    problems = verified(copy).problems
    # Of a robot and of tables it is known that they were written.
    derivable = name not in ("report.html", "run.toml")
    assert any("and not sealed" in problem for problem in problems) == derivable


def test_files_of_others_are_told(copy: Path) -> None:
    (copy / "notes\x1b[2J.txt").write_text("mine")
    result = verified(copy)
    assert result.passed
    assert any("'notes\\x1b[2J.txt': not of this run" in said for said in result.unchecked)


def test_a_certificate_that_does_not_hold(copy: Path) -> None:
    data = json.loads((copy / "certificate.json").read_text())
    data["claims"]["lower_bound"] = data["claims"]["cost"]
    (copy / "certificate.json").write_text(json.dumps(data))
    reseal(copy)
    problems = verified(copy).problems
    assert any(problem.startswith("certificate.json: ") for problem in problems)
    assert any("it says 'certified'" in problem for problem in problems)


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.update(version=1.0),
        lambda data: data.update(version=True),
        lambda data: data.update(more=1),
        lambda data: data.pop("inputs"),
        lambda data: data["files"].update({"../x": {"bytes": 0, "sha256": "0" * 64}}),
        lambda data: data["files"].update({"": {"bytes": 0, "sha256": "0" * 64}}),
        lambda data: data["files"].update({"x": {"bytes": -1, "sha256": "0" * 64}}),
        lambda data: data["files"].update({"x": {"bytes": 0, "sha256": "0" * 63}}),
        lambda data: data["files"].pop("certificate.json"),
        lambda data: data["inputs"].append({}),
        lambda data: data["inputs"][0].update(role="friend"),
        lambda data: data.update(recipe=1),
        lambda data: data.update(certificate=1),
    ],
)
def test_a_manifest_that_is_none(copy: Path, change: Callable[[Any], Any]) -> None:
    data = json.loads((copy / "manifest.json").read_text())
    change(data)
    (copy / "manifest.json").write_text(json.dumps(data))
    with pytest.raises(MalformedError):
        verified(copy)


def test_a_folder_without_a_manifest(tmp_path: Path) -> None:
    refuses(sdpid.errors.CertificateError, r"no manifest\.json", sdpid.verify, tmp_path)


def test_through_the_package(folder: Path) -> None:
    found = sdpid.verify(folder)
    assert found.passed
    assert found.sha256 == json.loads((folder / "manifest.json").read_text())["sha256"]
    assert found.cost == json.loads((folder / "result.json").read_text())["cost_at_most"]


# Bodies without rounding: their laws, and libraries in floating point.


def about_origin(
    mass: Fraction, com: Sequence[Fraction], moments: Sequence[Fraction]
) -> list[Fraction]:
    """Return the ten parameters of a mass, a center of mass and moments about it, exactly."""
    square = sum(c * c for c in com)
    places = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
    return [mass, *(mass * c for c in com)] + [
        value + mass * ((square if i == j else 0) - com[i] * com[j])
        for value, (i, j) in zip(moments, places, strict=True)
    ]


def exactly(body: np.ndarray) -> list[Fraction]:
    return [Fraction(x) for x in body.tolist()]


@given(bodies())
def test_about_the_center_and_back(body: np.ndarray) -> None:
    exact = exactly(body)
    assert about_origin(*central(exact)) == exact
    mass, com, inertia = physical_parameters(body)
    written = rounded(exact)
    assert written.mass == mass
    assert written.com == tuple(com)
    found = np.array(written.moments) - inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    assert np.abs(found).max() <= 1e-14 * np.abs(body[4:]).max()


@given(bodies())
def test_each_written_number_is_the_nearest(body: np.ndarray) -> None:
    exact, found = central(exactly(body)), rounded(exactly(body))
    numbers = zip(
        (found.mass, *found.com, *found.moments), (exact[0], *exact[1], *exact[2]), strict=True
    )
    for number, value in numbers:
        assert abs(Fraction(number) - value) <= Fraction(math.ulp(number)) / 2


@pytest.mark.parametrize("consistency", ["pseudo_inertia", "spatial_inertia"])
def test_the_edge(consistency: str) -> None:
    """A point, a rod and a plate are raised, a ball is not, and what is no body stays none."""
    m = Fraction(1)
    point = about_origin(m, [m / 2, m, m], [Fraction(0)] * 6)
    rod = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, m * 0])
    plate = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, 2 * m])
    ball = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, m])
    for body in (point, rod):
        found = inside(body, consistency)
        assert 0 < found[4] - body[4] < Fraction(1e-12)
        written = rounded(found)
        assert exists(written.mass, written.moments, consistency)
    raised = inside(plate, consistency)
    assert raised is not None
    assert (raised != plate) == (consistency == "pseudo_inertia")
    assert inside(ball, consistency) == ball
    assert inside(about_origin(m, [m, m, m], [-m, m * 0, m, m * 0, m * 0, m]), consistency) is None
    assert inside([Fraction(0)] * 10, consistency) is None


@given(bodies())
def test_principal_axes(body: np.ndarray) -> None:
    """Moments and quaternion give the tensor back to its rounding."""
    exact = central(exactly(body))[2]
    quaternion, moments = principal_axes(exact)
    R = rotation([Fraction(x) for x in quaternion])
    diagonal = np.diag([Fraction(x) for x in moments]).tolist()
    turned, wanted = along(diagonal, np.transpose(R).tolist()), tensor(exact)
    limit = Fraction(1e-14) * max(map(abs, exact))
    assert all(abs(turned[i][j] - wanted[i][j]) <= limit for i in range(3) for j in range(3))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "<a>",
        "<a/><b/>",
        "<!DOCTYPE a><a/>",
        '<!DOCTYPE a [<!ENTITY x "y">]><a b="&x;"/>',
        '<a b="&x;"/>',
        '<?xml version="1.0" encoding="nonsense"?><a/>',
        "<a>" * 1100 + "</a>" * 1100,
        "<a b='1' b='2'/>",
    ],
)
def test_xml_that_is_refused(text: str) -> None:
    with pytest.raises(MalformedError):
        parse(text.encode())


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_encodings(encoding: str) -> None:
    declared = {"utf-8-sig": "utf-8"}.get(encoding, encoding)
    text = f'<?xml version="1.0" encoding="{declared}"?><a b="é"/>'
    assert parse(text.encode(encoding)).attributes == {"b": "é"}


@pytest.mark.parametrize(
    "text", ["", "1 2", "x", "nan", "inf", "1_0", "0x1", "1e13", "1e99999", "٣"]
)
def test_numbers_that_are_refused(text: str) -> None:
    with pytest.raises(MalformedError):
        Node("mass", {"value": text}).number("value")
