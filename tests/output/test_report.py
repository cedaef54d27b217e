"""The report is one valid page that needs nothing else and runs what draws it alone."""

import base64
import hashlib
import html
import importlib.util
import json
import re
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from lxml import etree

import sdpid
from sdpid.assurance.diagnostics.active_constraints import constraint_states
from sdpid.assurance.diagnostics.held_out import hold_out
from sdpid.assurance.intervals.delta_method import link_properties
from sdpid.errors import ExportError
from sdpid.estimation.compression.rows import RowSource
from sdpid.output.charts.page import Charts, number, packed, policy, scripts, style
from sdpid.output.report import parameters, report
from sdpid.output.report.headline import headline
from sdpid.output.report.recording import units
from sdpid.output.report.report import report_html, write_report
from sdpid.output.robots.export_report import ExportErrors
from sdpid.workflow.result import Identification
from tests.helpers.browser import Tab, look
from tests.helpers.identified import arm_theta, identified, moved
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE
from tests.helpers.runs import arm as recorded_arm
from tests.helpers.runs import recorded
from tests.helpers.scenes import unpacked

EVIL = "<script>alert(1)</script>"
EVIL_LINK = "\"'><img src=http://example.org/x onerror=alert(1)>"
FETCHING = ("src", "href", "srcset", "data", "action", "poster", "background")
# Of two joints: effort, error, friction, and what the error looks like; and the mass matrix.
CHARTS = (3 + 3) * 2 + 1
# A forest plot of the parameters of each link.
FORESTS = 2
SECTIONS = (
    *("verdict", "robot", "joints", "parameters", "links", "mass-matrix"),
    *("effects", "log", "certificate", "made"),
)
COMMAND = "sdpid identify 'a <b>.csv' --robot arm.urdf"


@pytest.fixture(scope="module")
def result() -> Identification:
    theta = arm_theta()
    notes = ("low-pass filter at 10 Hz", EVIL)
    return identified(moved(theta, 1, notes=notes), moved(theta, 2))


@pytest.fixture(scope="module")
def page(result: Identification) -> str:
    return report_html(result, command=COMMAND)


@pytest.fixture(scope="module")
def evil_page() -> str:
    """Return the report of a robot with names that want to run."""
    text = (
        '<robot name="&lt;b&gt;arm$"><link name="base"/>'
        f'<link name="{quoted(EVIL_LINK)}">{body(1.0)}</link>'
        f'<link name="tip">{body(0.5)}</link>'
        f'<joint name="{quoted(EVIL)}" type="continuous"><parent link="base"/>'
        f'<child link="{quoted(EVIL_LINK)}"/><axis xyz="0 1 0"/></joint>'
        f'<joint name="$\\undefined$" type="continuous"><parent link="{quoted(EVIL_LINK)}"/>'
        '<child link="tip"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/></joint></robot>'
    )
    robot = sdpid.load_robot(text)
    return report_html(identified(moved(arm_theta(), 1, robot=robot), robot=robot), command=EVIL)


def quoted(text: str) -> str:
    return html.escape(text, quote=False).replace('"', "&quot;")


def body(mass: float) -> str:
    return (
        f'<inertial><origin xyz="0.1 0 0"/><mass value="{mass}"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def tree(page: str) -> Any:
    """Parse as the standard says, without forgiving anything."""
    with warnings.catch_warnings():
        # The parser speaks of its own dependencies.
        warnings.simplefilter("ignore", DeprecationWarning)
        html5lib = pytest.importorskip("html5lib")
        builder = html5lib.getTreeBuilder("lxml")
        return html5lib.HTMLParser(tree=builder, strict=True).parse(page)


def elements(page: str, name: str) -> list[Any]:
    return list(tree(page).iter(f"{{*}}{name}"))


def flat(element: Any) -> str:
    """Return the words of an element."""
    return re.sub(r"\s+", " ", "".join(element.itertext())).strip()


def pictures(page: str, *, scene: bool = False) -> list[Any]:
    """Return the pictures of a page as SVG, or the one that stands for the scene."""
    found = []
    for image in elements(page, "img"):
        if (image.getparent().get("class") == "scene") != scene:
            continue
        kind, _, data = image.get("src").partition(",")
        assert kind == "data:image/svg+xml;base64"
        found.append(etree.fromstring(base64.b64decode(data, validate=True)))
    return found


def charts(page: str) -> list[dict[str, Any]]:
    """Return what is drawn into the places for charts, in the order of the page."""
    (held,) = [each for each in elements(page, "script") if each.get("id") == "chart-data"]
    every = json.loads(held.text)["charts"]
    places = [each for each in elements(page, "div") if each.get("data-chart")]
    assert all(place.get("aria-label") for place in places)
    return [every[int(place.get("data-chart"))] for place in places]


def words(page: str) -> str:
    found = tree(page)
    for other in [*found.iter("{*}style"), *found.iter("{*}script")]:
        # What follows an element is its own tail: it stays.
        other.text = ""
    return re.sub(r"\s+", " ", "".join(found.getroot().itertext()))


def self_contained(page: str) -> None:
    """Check that nothing is fetched and nothing runs but player and charts, by their digests."""
    runs = [each for each in elements(page, "script") if each.get("type") != "application/json"]
    drawn = pictures(page, scene=True)
    assert len(drawn) == 1
    assert len(runs) == 3
    (allowed,) = re.findall(r"script-src ([^;\"]*)", page)
    assert allowed.split() == [digest_of(each.text) for each in runs]
    assert not any(each.attrib for each in runs)
    allowed = {"a": r"#", "img": r"data:image/svg\+xml;base64,", "use": r"#"}
    for element in (part for root in (tree(page), *drawn) for part in root.iter("{*}*")):
        name = etree.QName(element).localname
        assert name not in ("link", "iframe", "object", "embed", "base", "form")
        assert name not in ("image", "foreignObject", "animate", "set")
        for key, value in element.attrib.items():
            assert not key.startswith("on")
            if etree.QName(key).localname in FETCHING:
                assert re.match(allowed[name], value), (name, key, value[:60])
            assert "url(" not in value.replace("url(#", "")
    style = "".join(element.text or "" for element in elements(page, "style"))
    assert style
    assert "url(" not in style
    assert "@import" not in style
    assert all(image.get("alt") for image in elements(page, "img"))
    (given,) = [
        meta.get("content")
        for meta in elements(page, "meta")
        if meta.get("http-equiv") == "Content-Security-Policy"
    ]
    assert {"default-src 'none'", "img-src data:"} <= set(given.split("; "))
    ids = [e.get("id") for e in tree(page).iter("{*}*") if e.get("id")]
    assert len(ids) == len(set(ids))
    assert all(a.get("href")[1:] in ids for a in elements(page, "a"))


def digest_of(script: str) -> str:
    """Return what a policy names a script by."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


def tells(page: str, *texts: str) -> None:
    """Check that a page says these words."""
    shown = words(page)
    assert [text for text in texts if text not in shown] == []


def test_it_is_valid_and_self_contained(page: str, evil_page: str) -> None:
    for text in (page, evil_page):
        assert text.startswith("<!DOCTYPE html>")
        assert not pictures(text)
        assert len(charts(text)) == CHARTS
        self_contained(text)


def test_names_are_escaped(evil_page: str) -> None:
    tells(evil_page, EVIL, EVIL_LINK, "<b>arm$", "$\\undefined$")
    # Data of scene and charts, and what draws them; none that a name brought.
    assert evil_page.count("<script") == len(elements(evil_page, "script")) == 5
    assert not elements(evil_page, "b")[0].get("onerror")


def test_it_tells_the_whole_story(result: Identification, page: str) -> None:
    certificate = result.certificate
    tells(
        page,
        *("low-pass filter at 10 Hz", EVIL, "50 Hz", "20 s", "Condition number", "Coulomb"),
        *("validation (held out)", "standard error", COMMAND),
        f"{result.validation.r2[0]:.4f}",
        f"{result.training.r2[1]:.4f}",
        certificate.to_dict()["sha256"],
        f"{certificate.lower_bound:#.10g}",
        *result.verdict,
        *result.problem.base.names,
        *result.problem.base.theta_names,
        *(s.name for s in constraint_states(result.estimate) if s.active),
        *(result.problem.robot.name, *result.problem.robot.joint_names),
    )
    # A bar for every standard parameter, each of them full.
    bars = [e for e in elements(page, "span") if e.get("class") == "bar"]
    assert len(bars) == result.problem.n_theta
    for bar in bars:
        widths = [float(re.search(r"width:([\d.]+)%", part.get("style"))[1]) for part in bar]
        assert sum(widths) == pytest.approx(100.0, abs=0.2)


def test_it_begins_with_the_verdict_in_short_and_shows_baselines(
    result: Identification, page: str
) -> None:
    shown, short = words(page), headline(result)
    least = result.held_out.baselines["least squares"].moving
    tells(page, short.error, short.worst, short.step, "least squares", f"{least.rmse[0]:#.3g}")
    assert shown.index(short.error) < shown.index(result.verdict[0])
    blocks = hold_out(result.estimate, result.wls, None)
    alone = replace(result, validation=None, validation_samples=None, held_out=blocks)
    said = ("5 blocks (held out in turn)", "relative residual, same motion", *alone.verdict)
    tells(report_html(alone), *said)


def test_its_sections_stand_in_order(page: str) -> None:
    """What matters most first, and every table says what it holds."""
    sections = [section.get("id") for section in elements(page, "section")]
    assert sections == list(SECTIONS)
    assert all(table.find("{*}caption") is not None for table in elements(page, "table"))
    assert all(head.get("scope") for head in elements(page, "th"))
    shown = words(page)
    assert shown.index("Next step") < shown.index("least squares") < shown.index("Joint by joint")
    # A table of many rows is folded, and its summary says how many.
    folded = [" ".join("".join(each.itertext()).split()) for each in elements(page, "summary")]
    assert any(re.match(r"Standard parameters.*\(\d+ rows\)", each) for each in folded)


def test_every_link_stands_beside_its_description(result: Identification, page: str) -> None:
    (shown,) = [flat(each) for each in elements(page, "section") if each.get("id") == "links"]
    masses = link_properties(result.estimate).value[:, 5]
    for name, mass in zip(result.problem.robot.link_names, masses, strict=True):
        assert name in shown
        assert number(mass, 3) in shown
    # There is no prior: the data do not tell the mass of a link that turns about one axis.
    assert "not told" in shown
    assert "description" not in shown.partition("link from")[2]  # this arm has none


def test_the_mass_matrix_is_looked_at_along_the_motion(result: Identification) -> None:
    found = parameters.values(result._subject, None, Charts())["mass_matrix"]
    least = {row["name"]: row["least"] for row in found["rows"]}
    q = result.problem.samples.position
    own = np.linalg.eigvalsh(result.estimate.model().mass_matrix(q))[:, 0].min()
    assert least["this estimate"] == pytest.approx(own, rel=0.05)
    assert 0.0 < found["bound"] <= found["box"].value <= own
    # A least-squares fit whose inertia is negative says so.
    base = result.wls.base.copy()
    base[list(result.problem.base.names).index("zzr1")] = -1.0
    wrong = replace(result, wls=replace(result.wls, base=base))
    rows = parameters.values(wrong._subject, None, Charts())["mass_matrix"]["rows"]
    (free,) = [row for row in rows if row["name"] == "least squares"]
    assert free["most"] < 0.0
    assert free["indefinite"] == 1.0


def test_without_validation_or_command(result: Identification) -> None:
    alone = replace(result, validation=None, validation_samples=None, held_out=None)
    text = report_html(alone)
    self_contained(text)
    tells(text, "Nothing was held out", "From Python")
    assert "held out)" not in words(text)
    assert len(charts(text)) == CHARTS


def test_the_same_result_gives_the_same_page_without_matplotlib(
    result: Identification, page: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert report_html(result, command=COMMAND) == page
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert report_html(result, command=COMMAND) == page


def test_a_long_record_is_drawn_with_few_points_and_says_so() -> None:
    theta = arm_theta()
    short, long = (report_html(identified(moved(theta, 1, seconds=s))) for s in (16.0, 400.0))
    assert "least and the greatest value" not in words(short)
    assert "least and the greatest value of each 27 samples" in words(long)
    places = [each.get("aria-label") for each in elements(long, "div") if each.get("data-chart")]
    assert sum("about the largest error" in place for place in places) == 2
    assert len(charts(long)) == CHARTS + 2
    # Twenty-five times as many samples.
    assert len(long) < 2 * len(short)


def test_rows_on_a_cluster_are_counted_and_a_selection_is_drawn(result: Identification) -> None:
    """As of a problem whose rows are elsewhere: `samples` is one in so many."""
    problem = result.problem
    assert problem.rows is not None
    thinned = problem.rows.on(problem.samples.every(10))
    there = replace(problem, rows=replace(thinned, elsewhere=Many(problem.rows)))
    thin = sdpid.validate(replace(result.estimate, problem=there), there.samples)
    alone = {"validation": None, "validation_samples": None, "held_out": None}
    text = report_html(replace(result, problem=there, training=thin, **alone), sha256="0")
    self_contained(text)
    tells(
        text,
        f"{problem.samples.n_samples:,} samples of 2 joints",
        f"{problem.n_rows:,} of {problem.samples.effort.size:,}",
        *("50 Hz", "one in 10 samples", "higher frequencies are folded"),
    )
    assert "one in" not in words(report_html(result, sha256="0"))


class Many:
    """Samples that are elsewhere."""

    def __init__(self, rows: RowSource) -> None:
        self.rows, self.samples, self.n_samples = rows, rows.samples, rows.n_samples

    def map(self, _: RowSource, function: Any, arguments: Any, sigma: Any) -> list[Any]:
        return self.rows.map(function, *arguments, sigma=sigma)


def test_samples_without_time_and_with_masked_rows(result: Identification) -> None:
    samples = moved(arm_theta(), 1, seconds=8.0)
    mask = np.ones(samples.effort.shape, dtype=bool)
    mask[100:200, 0] = False
    text = report_html(identified(replace(samples, time=None, mask=mask)))
    self_contained(text)
    assert "700 of 800" in words(text)


def test_intervals_are_shown(result: Identification) -> None:
    base, theta = result.problem.base.names[0], result.problem.base.theta_names[0]
    # Intervals as anybody may make them.
    ends = {"lower": np.array([-1.25, 0.0]), "upper": np.array([2.5, np.inf])}
    given = SimpleNamespace(names=(base, theta), label=("from data", "from physics"), **ends)
    tells(report_html(result, intervals=given), "−1.250 … 2.500", "0 … –", "from physics")
    gauss = sdpid.confidence_intervals(result.estimate, method="gauss_markov")
    tells(report_html(result, intervals=gauss), "from data")


def test_cross_validation_and_pieces_are_shown() -> None:
    found = sdpid.identify(recorded_arm(), [recorded(1), recorded(2)], folds=2)
    text = report_html(found)
    self_contained(text)
    tells(
        text,
        "2 blocks of time held out in turn",
        "relative residual in motion of blocks held out in turn",
        *("block 2 of 2", "pieces, recorded apart"),
        f"{found.cross_validation.rmse[0]:#.3g}",
        *found.notes,
    )


def test_values_at_a_bound_are_zero(result: Identification) -> None:
    tiny = replace(result.estimate, base=np.array([1e-12, *result.estimate.base[1:]]))
    rows, again = (
        [row["value"] for row in parameters.base_rows(each._subject, None)]
        for each in (result, replace(result, estimate=tiny))
    )
    assert again == [0.0, *rows[1:]]


def test_it_is_written_whole_or_not_at_all(
    result: Identification, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_report(result, tmp_path / "report.html", sha256="0")
    before = path.read_text(encoding="utf-8")
    nowhere = tmp_path / "nowhere" / "report.html"
    refuses(ExportError, "nowhere", write_report, result, nowhere, sha256="0")
    monkeypatch.setattr(report, "atomic_write_text", Mock(side_effect=ExportError("no")))
    refuses(ExportError, "no", result.save, tmp_path, figures=False)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert path.read_text(encoding="utf-8") == before


def test_save_writes_it_with_what_the_written_files_predict(
    result: Identification, tmp_path: Path
) -> None:
    assert tmp_path / "report.html" in result.save(tmp_path, figures=False, command=COMMAND)
    certificate, content = (
        json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8"))
        for name in ("certificate", "result")
    )
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    tells(page, certificate["sha256"], COMMAND, "As the written files predict it")
    for export in content["exports"]:
        both = [f"{100.0 * export[kind]['file']:#.3g} %" for kind in ("validation", "training")]
        share = f"{100.0 * export['left_out'][0]['share']:.2g} %"
        tells(page, f"{export['file']} {both[0]}{both[1]} Offset {share}")
    assert "As the written files" not in words(report_html(result))
    # A file that loses too much says so, one that does not is silent.
    urdf = sdpid.write_urdf(result.estimate, target=tmp_path / "again.urdf")
    for file, warned in ((0.05, True), (0.03, False)):
        export = replace(urdf, validation=ExportErrors(file=file, estimate=0.02), training=None)
        page = words(report_html(result, exports=[export]))
        assert ("predict efforts with estimate.model() instead" in page) == warned


def test_save_goes_on_without_the_extra(
    result: Identification, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: Callable[..., Any] = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name == "jinja2" else found(name, *a)
    )
    said: list[str] = []
    files = result.save(tmp_path, figures=False, report=said.append)
    assert "report.html" not in {file.name for file in files}
    assert any("[report]'" in text for text in said)


FORESTS_SEEN = """
(() => {
  const forests = [...document.querySelectorAll("figure > svg")], cut = [];
  for (const forest of forests) {
    const s = forest.getBoundingClientRect();
    for (const text of forest.querySelectorAll("text")) {
      const t = text.getBoundingClientRect();
      const beside = t.left < s.left - 1 || t.right > s.right + 1;
      if (beside || t.top < s.top - 1 || t.bottom > s.bottom + 1) cut.push(text.textContent);
    }
  }
  return { cut, drawn: forests.filter((f) => f.clientWidth > 250 && f.clientHeight > 50).length };
})()
"""


# The instant that the first chart names, and that at which the robot is shown.
AT_CURSOR = """
[document.querySelector("#joints .u-value").textContent,
 document.getElementById("scene-time").value].map(Number)
"""


def test_a_browser_shows_it(page: str, tmp_path: Path) -> None:
    """At the width of a desk and of a phone, from a file, with all charts, and it can be zoomed."""
    (tmp_path / "report.html").write_text(page, encoding="utf-8")
    drawn = "document.querySelectorAll('.uplot').length"
    # Effort and error of the first joint.
    seen = "[...document.querySelectorAll('#joints canvas')].slice(0, 2).map((c) => c.toDataURL())"

    async def visit(tab: Tab) -> None:
        for width in (1280, 390):
            await tab.fits(width)
            assert await tab.value(FORESTS_SEEN) == {"cut": [], "drawn": FORESTS}
        # Charts are drawn where they are looked at.
        assert await tab.value(drawn) < CHARTS - 8
        await tab.value("document.querySelector('.joint').scrollIntoView()")
        await tab.until("document.querySelectorAll('.joint .uplot').length >= 2")
        assert await tab.value(drawn) < CHARTS
        # A drag zooms in on all charts over this time; a double click shows the whole again.
        place = "document.querySelector('#joints .u-over').getBoundingClientRect()"
        x, y = await tab.value(f"[{place}.left, {place}.top]")
        whole = await tab.value(seen)
        # The cursor shows the robot at its instant, beside the charts where it is out of sight.
        await tab.call("Input.dispatchMouseEvent", type="mouseMoved", x=x + 80, y=y + 50)
        await tab.until("document.getElementById('scene').classList.contains('beside')")
        instant, shown = await tab.value(AT_CURSOR)
        assert instant > 0.0
        assert shown == pytest.approx(instant, abs=0.1)
        for kind, right, held in (("Pressed", 80, 1), ("Moved", 160, 1), ("Released", 160, 0)):
            event = {"type": f"mouse{kind}", "x": x + right, "y": y + 50, "buttons": held}
            button = {} if kind == "Moved" else {"button": "left", "clickCount": 1}
            await tab.call("Input.dispatchMouseEvent", **event, **button)
        await tab.value(f"window.whole = {json.dumps(whole)}")
        await tab.until(f"{seen}.every((picture, k) => picture !== whole[k])")
        over = "document.querySelector('#joints .u-over')"
        await tab.value(f"{over}.dispatchEvent(new MouseEvent('dblclick', {{ bubbles: true }}))")
        await tab.until(f"{seen}.every((picture, k) => picture === whole[k])")
        # Before printing all are drawn, those that are folded, too.
        await tab.value("dispatchEvent(new Event('beforeprint'))")
        assert await tab.value(drawn) == CHARTS
        await tab.value("dispatchEvent(new Event('afterprint'))")
        tab.heard_nothing()
        # What the page's policy does not name does not run.
        evil = "e = document.createElement('script'); e.textContent = 'window.ran = 1';"
        assert await tab.value(f"{evil} document.body.append(e); window.ran === undefined")

    look(tmp_path / "report.html", tmp_path / "profile", visit)


# What all pages share: a policy that lets named scripts run, and colors that can be read.


# Of text that is not large, by the accessibility guidelines (WCAG 2.2, 1.4.3).
CONTRAST = 4.5

# Every color of letters with what it stands on.
PAIRS = [
    *((ink, ground) for ink in ("ink", "soft", "link") for ground in ("bg", "card", "faint")),
    *((level, ground) for level in ("good", "caution", "bad") for ground in ("bg", "card")),
    *((ink, f"{level}-bg") for level in ("good", "caution", "bad") for ink in ("ink", level)),
]


def schemes() -> dict[str, dict[str, str]]:
    """Return the variables of the light scheme and of the dark one."""
    style = files("sdpid.output.report").joinpath("page.css").read_text(encoding="utf-8")
    blocks = re.findall(r":root \{(.*?)\}", style, flags=re.DOTALL)
    light, dark = (dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block)) for block in blocks)
    return {"light": light, "dark": {**light, **dark}}


def luminance(color: str) -> float:
    shares = [int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
    return sum(w * s for w, s in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_letters_can_be_read(scheme: str) -> None:
    colors = schemes()[scheme]
    assert {"bg", "ink", "soft", "good", "bad", "caution", "link"} <= set(colors)
    for ink, ground in PAIRS:
        high, low = sorted((luminance(colors[ink]), luminance(colors[ground])), reverse=True)
        assert (high + 0.05) / (low + 0.05) >= CONTRAST, (ink, ground)


def test_only_given_scripts_run() -> None:
    assert "script-src" not in policy()
    assert "default-src 'none'" in policy().split("; ")
    script = "'use strict'; // <é>"
    assert f"script-src {digest_of(script)}" in policy([script]).split("; ")


# What the report says of a recording.


@pytest.mark.parametrize(("description", "effort"), [(TREE, "N, N·m"), ("denso_vp6242", "N·m")])
def test_units_are_those_of_the_joints(description: str, effort: str) -> None:
    found = units(sdpid.load_robot(description))
    assert set(found["effort"].split(", ")) == set(effort.split(", "))
    assert ("m/s" in found["velocity"].split(", ")) == ("N" in effort.split(", "))


# ---- Charts of a page: what it holds of arrays, and the library that draws them.


X = np.linspace(0.0, 4.0, 50)


def column(charts: Charts, k: int) -> np.ndarray:
    return unpacked(json.loads(charts.data)["columns"][k]).ravel()


def test_columns_are_what_was_given_and_are_held_once() -> None:
    charts, y = Charts(), np.where(X > 3.0, np.nan, np.sin(X))
    assert charts.add(x=X, effort=y, half=0.0 * X + 0.1, nothing=None, range=(0.0, 1.0)) == 0
    assert charts.add(x=X, error=y, shaded=np.array([[1.0, 2.00000001]])) == 1
    content = json.loads(charts.data)
    first, second = content["charts"]
    assert len(content["columns"]) == 3
    assert (first["x"], first["effort"]) == (second["x"], second["error"])
    assert "nothing" not in first
    assert first["range"] == [0.0, 1.0]
    assert second["shaded"] == [[1.0, 2.0]]
    assert column(charts, first["x"]) == pytest.approx(X, abs=1e-4)
    assert column(charts, first["effort"]) == pytest.approx(y, abs=2e-5, nan_ok=True)
    assert column(charts, first["half"]) == pytest.approx(0.1)


def test_what_is_missing_is_told_apart() -> None:
    values = np.array([[1.0, np.nan], [np.inf, np.nan], [-3.0, -np.inf]])
    found = packed(values)
    assert found["low"] == [-3.0, 0.0]
    expected = np.where(np.isfinite(values), values, np.nan)
    assert unpacked(found) == pytest.approx(expected, nan_ok=True)


def test_no_name_leaves_its_place() -> None:
    charts, evil = Charts(), '</script><script>"alert(1)'
    charts.add(x=X, **{evil: X})
    assert "<" not in charts.data
    assert evil in json.loads(charts.data)["charts"][0]


def test_the_library_is_the_released_one_with_its_licence() -> None:
    """By the digests of the files in the package uplot 1.6.32 of npm's registry."""
    folder = files("sdpid.output.charts").joinpath("uplot")
    lines = folder.joinpath("SHA256SUMS").read_text().splitlines()
    listed = {name: digest for digest, name in map(str.split, lines)}
    assert set(listed) == {"uPlot.iife.min.js", "uPlot.min.css", "LICENSE"}
    for name, digest in listed.items():
        assert hashlib.sha256(folder.joinpath(name).read_bytes()).hexdigest() == digest
    library, _ = scripts()
    assert "The MIT License (MIT)" in library
    assert "uPlot (v1.6.32)" in library
    # Under a page's policy nothing is fetched, and no text is run.
    fetching = r"\beval\(|new Function|fetch\(|XMLHttpRequest|import\("
    assert not re.search(fetching, "".join(scripts()))
    assert "url(" not in style()
