"""The robot of a report: its motion, its ellipsoids, and what is told of those it lacks."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.page import policy
from sdpid.output.scene.contents import recorded_motion
from sdpid.output.scene.identified import identified_scene
from sdpid.output.scene.scene import Scene
from sdpid.robot.model.geometry import link_placements, neutral
from sdpid.robot.model.model import RobotModel
from tests.helpers.browser import Tab, look
from tests.helpers.robots import TREE, TREE_MIMIC
from tests.helpers.scenes import unpacked

# Steps of 16 bits over some meters, and over 2 in quaternions, of which products make a rotation.
QUANTIZED = 5e-4

pytest.importorskip("jinja2")


def moved(robot: RobotModel, seconds: float = 2.0, rate: float = 100.0, **fields: Any) -> Samples:
    """Return samples of a slow motion."""
    time = np.arange(round(seconds * rate)) / rate
    turned = 0.5 * np.sin(time)[:, None] * np.ones(robot.n)
    if robot.free_flyer:
        start = neutral(robot)
        position = np.stack([pin.integrate(robot.pin_model, start, each) for each in turned])
    else:
        position = turned
    rest = np.zeros((len(time), robot.n))
    motion = {"velocity": rest, "acceleration": rest, "effort": rest}
    return Samples(position=position, **motion, **{"time": time, **fields})


def data_of(scene: Scene) -> dict[str, Any]:
    """Return what the page holds for the player."""
    found = re.search(r'id="scene-data">(.*?)</script>', scene.markup, re.S)
    assert found
    content: dict[str, Any] = json.loads(found[1])
    return content


def shown(robot: RobotModel, theta: Array | None = None) -> Scene:
    """Return the scene of a robot on a slow motion."""
    return identified_scene(robot, moved(robot), theta)


@pytest.mark.parametrize(
    ("text", "root"),
    [
        pytest.param(TREE, None, id="prismatic joints and branches"),
        pytest.param(TREE_MIMIC, None, id="mimic joint"),
        pytest.param(TREE, "free_flyer", id="floating base"),
    ],
)
def test_links_are_where_they_were(text: str, root: Any) -> None:
    robot = sdpid.load_robot(text, root=root)
    samples = moved(robot)
    data = data_of(identified_scene(robot, samples, 1.1 * robot.prior.ravel()))
    frames = data["frames"]
    assert (frames["rate"], frames["count"]) == (25.0, 50)
    assert data["follow"] == robot.free_flyer
    poses = unpacked(frames["poses"]).reshape(50, robot.n_links, 7)
    for k in (0, 30):
        own = link_placements(robot, samples.position[4 * k])
        assert np.allclose(poses[k, :, :3], own[:, :3, 3], atol=QUANTIZED)
        i, j, m, w = poses[k, :, 3:].T
        turned = [1 - 2 * (j * j + m * m), 2 * (i * j + m * w), 2 * (i * m - j * w)]
        assert np.allclose(np.stack(turned, axis=-1), own[:, :3, 0], atol=QUANTIZED)
    groups = [each["group"] for each in data["ellipsoids"]]
    bodies = np.count_nonzero(robot.prior[:, 0])
    assert groups == ["identified"] * bodies + ["described"] * bodies
    # Ten percent more of all moments is ten percent more mass, and the same ellipsoid.
    half = data["ellipsoids"][bodies:]
    for one, other in zip(data["ellipsoids"], half, strict=False):
        assert np.allclose(one["lengths"], other["lengths"])


def test_impossible_and_missing_bodies_are_told() -> None:
    robot = sdpid.load_robot(TREE)
    theta = robot.prior.copy()
    theta[0, 4] = -1.0
    theta[1] = 0.0
    theta[2, 4:] *= 1e6
    scene = shown(robot, theta.ravel())
    groups = [each["group"] for each in data_of(scene)["ellipsoids"]]
    assert groups.count("identified") == robot.n_links - 3
    first, second, third = robot.link_names[:3]
    assert f"no body can have of {first}:" in scene.markup
    assert f"no inertia of {second}." in scene.markup
    assert re.search(rf"are not\s+drawn: {third}\.", scene.markup)
    assert "identified" not in {each["group"] for each in data_of(shown(robot))["ellipsoids"]}


def test_names_are_no_markup_and_bytes_are_the_same() -> None:
    robot = sdpid.load_robot(TREE.replace('"tree"', '"&lt;/script>&lt;b>"'))
    hostile = sdpid.load_robot(TREE.replace('"column"', '"&lt;/script>&lt;b>"'))
    for each in (robot, hostile):
        theta = np.zeros(each.prior.size)
        scene = shown(each, theta)
        assert scene == shown(each, theta)
        assert scene.markup.count("</script>") == 1
        assert "<b>" not in scene.markup
        assert "&lt;b&gt;" in scene.markup


def test_recordings_play_their_first_minute() -> None:
    robot = sdpid.load_robot(TREE)
    long = recorded_motion(moved(robot, seconds=90.0))
    assert len(long.position) == 1500
    assert "first 60 s of 90 s" in long.note
    assert np.allclose(long.position[100], 0.5 * np.sin(4.0))
    slow = recorded_motion(moved(robot, seconds=4.0, rate=10.0))
    assert (slow.rate_hz, len(slow.position)) == (pytest.approx(10.0), 40)
    bare = recorded_motion(moved(robot, time=None))
    assert "no stamps" in bare.note
    # Two pieces an hour apart are played one after the other.
    samples = moved(robot)
    broken = moved(robot, time=samples.time + 3600.0 * (samples.time >= 1.0), starts=(0, 100))
    assert np.allclose(recorded_motion(broken).position, recorded_motion(samples).position)
    assert len(recorded_motion(moved(robot, seconds=0.01)).position) == 1


def test_it_plays_in_a_browser(tmp_path: Path) -> None:
    """From a file: without a network, without errors; and a picture stands where it does not."""
    robot = sdpid.load_robot(TREE)
    scene = shown(robot, 1.1 * robot.prior.ravel())
    head = '<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{}">'
    head = head.format(policy([scene.script]))
    page = f"<!DOCTYPE html>{head}<style>{scene.style}</style>{scene.markup}<script>{scene.script}"
    (tmp_path / "page.html").write_text(f"{page}</script>", encoding="utf-8")
    colors = """(() => { const c = document.createElement("canvas"), v = get("scene-view");
      [c.width, c.height] = [v.width, v.height]; const p = c.getContext("2d"); p.drawImage(v, 0, 0);
      const d = p.getImageData(0, 0, c.width, c.height).data; let blue = 0, gray = 0;
      for (let k = 0; k < d.length; k += 4) if (d[k + 3] > 60) {
        if (d[k + 2] > d[k] + 40) blue++; else gray++; }
      return [blue, gray]; })()""".replace("get(", "document.getElementById(")

    async def visit(tab: Tab) -> None:
        live = await tab.value("document.getElementById('scene').classList.contains('live')")
        assert live
        await tab.until("document.getElementById('scene-told').textContent !== ''")
        blue, gray = await tab.value(colors)
        assert min(blue, gray) > 1000
        box = "document.querySelector('[data-group=identified]')"
        await tab.value(f"{box}.click()")
        await tab.value("document.getElementById('scene-play').click()")
        await tab.until(f"({colors})[0] === 0")
        assert not tab.named("Runtime.exceptionThrown", "Runtime.consoleAPICalled")
        assert not tab.named("Log.entryAdded")
        asked = [e["params"]["request"]["url"] for e in tab.named("Network.requestWillBeSent")]
        assert all(url.startswith(("file:", "data:")) for url in asked)
        await tab.call("Emulation.setEmulatedMedia", media="print")
        seen = "getComputedStyle(document.querySelector('.scene %s')).display"
        assert [await tab.value(seen % each) for each in ("img", ".stage")] == ["block", "none"]

    look(tmp_path / "page.html", tmp_path / "profile", visit)
