"""The page of a plan: valid, alone, told in words, and the arm moves."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sdpid.experiment.trajectory.played import played
from sdpid.output.plans.page import plan_html
from sdpid.output.plans.scene import scene_of
from sdpid.output.report.page import number
from tests.helpers.browser import Tab, look
from tests.helpers.plans import small_plan
from tests.helpers.scenes import unpacked
from tests.output.report.test_report import elements, pictures, tree, words

EVIL = "</script><script>alert(1)</script>"


@pytest.fixture(scope="module")
def page() -> str:
    pytest.importorskip("jinja2")
    pytest.importorskip("matplotlib")
    plan = small_plan()
    return plan_html(replace(plan, notes=(*plan.notes, EVIL)), command=f"sdpid excite {EVIL}")


def scene(page: str) -> dict[str, Any]:
    (found,) = [each for each in elements(page, "script") if each.get("type")]
    content: dict[str, Any] = json.loads(found.text)
    return content


def test_it_is_valid_and_alone(page: str) -> None:
    """Of scripts one runs, by its digest; nothing is fetched."""
    assert page.startswith("<!DOCTYPE html>")
    data, player = elements(page, "script")
    assert data.get("type") == "application/json"
    assert not player.attrib
    digest = base64.b64encode(hashlib.sha256(player.text.encode()).digest()).decode()
    (policy,) = [m.get("content") for m in elements(page, "meta") if m.get("http-equiv")]
    assert f"script-src 'sha256-{digest}'" in policy.split("; ")
    assert "default-src 'none'" in policy.split("; ")
    for element in tree(page).iter("{*}*"):
        for key, value in element.attrib.items():
            assert not key.startswith("on")
            if key in ("src", "href", "srcset", "data", "action"):
                assert re.match(r"data:image/svg\+xml;base64,|#", value)
    ids = [e.get("id") for e in tree(page).iter("{*}*") if e.get("id")]
    assert len(ids) == len(set(ids))
    assert all(link.get("href")[1:] in ids for link in elements(page, "a"))
    assert all(image.get("alt") for image in elements(page, "img"))
    assert "http" not in player.text


def test_it_tells_the_plan(page: str) -> None:
    plan, shown = small_plan(), words(page)
    for text in (
        "Every limit holds at every instant",
        "mm kept of 20 mm asked for",
        number(plan.condition_number),
        EVIL,
        "<b>box",
        "rad/s²",
        *plan.names,
        *plan.limits.notes,
        *plan.expected.sentences(),
    ):
        assert re.sub(r"\s+", " ", text).rstrip(".").lower() in shown.lower()
    # A picture a joint, distances, spectrum, and errors over the duration.
    assert len(pictures(page)) == plan.robot.n + 3
    assert len(pictures(plan_html(plan, figures=False))) == 0


def test_a_broken_limit_is_bad(page: str) -> None:
    plan = small_plan()
    row = replace(plan.limits.rows[0], verdict="broken", reached=99.0)
    limits = replace(plan.limits, rows=(row, *plan.limits.rows[1:]))
    shown = words(plan_html(replace(plan, limits=limits), figures=False))
    assert "Not every limit is proven to hold" in shown
    assert "Every limit holds" not in shown


def test_the_scene_is_the_motion(page: str) -> None:
    plan, found = small_plan(), scene(page)
    motion, frames = played(plan.trajectory, 25.0), found["frames"]
    assert frames["count"] == len(motion.time)
    assert (frames["count"] - 1) / frames["rate"] == pytest.approx(plan.trajectory.period)
    assert np.allclose(unpacked(frames["q"]), motion.position, atol=1e-4)
    groups = {(each["group"], each["link"]) for each in found["surfaces"]}
    assert groups == {("links", -1), ("links", 0), ("links", 1), ("obstacles", -1), ("planes", -1)}
    assert len(found["distances"]["frames"]) == frames["count"]
    bare = scene_of(plan.robot, motion, None, 0.0)
    assert "no collisions were checked" in bare.markup


def test_the_arm_moves_in_a_browser(page: str, tmp_path: Path) -> None:
    """From a file: without a network, without errors, and it obeys its controls."""
    (tmp_path / "report.html").write_text(page, encoding="utf-8")
    told, picture = (
        "document.getElementById('scene-told').textContent",
        "document.getElementById('scene-view').toDataURL()",
    )

    async def visit(tab: Tab) -> None:
        # Out of sight it stands still.
        await tab.value("document.getElementById('scene').scrollIntoView()")
        await tab.until("document.getElementById('scene-told').textContent !== ''")
        await tab.value(f"[window.seen, window.read] = [{picture}, {told}]")
        await tab.until(f"{picture} !== seen && {told} !== read")
        assert "nearest:" in await tab.value(told)
        await tab.value("document.getElementById('scene-view').focus()")
        await tab.key(" ")
        await tab.until("document.getElementById('scene-play').textContent === 'Play'")
        await tab.value(f"window.seen = {picture}")
        await tab.key("ArrowLeft")
        await tab.until(f"{picture} !== seen")
        slide = "s = document.getElementById('scene-time'); s.value = 2; s.dispatchEvent(new Event("
        await tab.value(f"{slide}'input'))")
        await tab.until(f"{told}.startsWith('2.00 s of')")
        for width in (1280, 390):
            size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
            await tab.call("Emulation.setDeviceMetricsOverride", **size)
            assert await tab.value("document.documentElement.scrollWidth") <= width
        assert not tab.named("Runtime.exceptionThrown", "Runtime.consoleAPICalled")
        assert not tab.named("Log.entryAdded")
        asked = [e["params"]["request"]["url"] for e in tab.named("Network.requestWillBeSent")]
        assert all(url.startswith(("file:", "data:")) for url in asked)

    look(tmp_path / "report.html", tmp_path / "profile", visit)
