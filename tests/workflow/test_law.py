"""Identification without efforts: a known law, its delay, drives fitted to positions, files."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from functools import partial
from xml.etree import ElementTree

import mujoco
import numpy as np
import pandas as pd
import pytest

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.simulation.law import CommandedMotion, law_of
from sdpid.output.robots import drive_files
from sdpid.output.robots.drive_files import NAMES, bam, isaaclab, mjlab, write_drives
from sdpid.output.robots.export_report import given_up
from sdpid.output.samples.drive_draws import draw_drives, truncated_normal
from tests.estimation.test_positions import (
    DRIVES,
    KD,
    KP,
    LEG,
    LEGS,
    STEP,
    N,
    commanded,
    drives,
    followed,
    links_of_legs,
)
from tests.helpers import world
from tests.helpers.commands import run
from tests.helpers.refusals import refuses

PD = sdpid.controllers.PD
LAW = PD(kp=KP, kd=KD)


@pytest.fixture(scope="module")
def legs(tmp_path_factory):
    """Two legs whose knees rub more on one side, their log without efforts, and the file."""
    path = tmp_path_factory.mktemp("law") / "legs.xml"
    path.write_text(LEGS.format(legs=LEG.format("l", 0.1, DRIVES) + LEG.format("r", -0.1, DRIVES)))
    robot = sdpid.load_robot(path)
    time, command = commanded(9.0)
    rollout = followed(time, command, command).rollout(links_of_legs(robot))
    start = np.stack([command[0], np.zeros(N)])
    truth = drives(delay=0.005, slope=np.array([0.0, 0.2, 0.0, -0.2]))
    position = rollout.positions(rollout.run(truth, start))
    position += 1e-4 * np.random.default_rng(0).standard_normal(position.shape)
    log = sdpid.Recording(
        time=time, position=position, reference=command, joint_names=robot.joint_names
    )
    return path, log


@pytest.fixture(scope="module")
def result(legs):
    return sdpid.identify(*legs, law=LAW)


def test_stiff_drives_without_a_delay_are_found(legs):
    # At another delay than theirs the law's efforts seem to push: no sign is wrong.
    path, _ = legs
    robot = sdpid.load_robot(path)
    time, command = commanded(5.0)
    stiff = {"kp": 400.0, "kd": 20.0}
    rollout = followed(time, command, command).rollout(links_of_legs(robot))
    motion = rollout.run(drives(armature=0.05, **stiff), np.stack([command[0], np.zeros(N)]))
    position = rollout.positions(motion)
    position += 1e-5 * np.random.default_rng(0).standard_normal(position.shape)
    columns = {"position": position, "effort": position, "reference": command}
    log = sdpid.Recording(time=time, **columns, joint_names=robot.joint_names)
    found = sdpid.identify(robot, log, law=PD(**stiff), intervals=False)
    assert [note for note in found.notes if "the log has efforts as well" in note]
    assert found.drives.delay < 1e-5
    np.testing.assert_allclose(found.drives.rich["armature"], 0.05, rtol=0.05)
    assert not [each for each in found.findings if each.kind == "effort_sign"]


def test_drives_and_delay_are_found(result):
    found = result.drives
    assert found.kinds == ("armature", "damping", "friction", "slope")
    assert found.complete
    assert not result.problem.errors
    assert result.certificate.passed
    low, high = found.delay_interval
    assert low <= 0.005 <= high
    assert high - low < 1e-3
    assert found.rms < 1.05e-4 < found.rms_reduced
    np.testing.assert_allclose(found.rich["slope"], [0.0, 0.2, 0.0, -0.2], atol=0.02)
    np.testing.assert_allclose(found.reduced["damping"], 0.3, atol=0.02)
    intervals = found.intervals()
    ends = [intervals[f"damping{j + 1}"][1:] for j in range(N)]
    assert sum(low <= 0.3 <= high for low, high in ends) >= N - 1
    for value, own, _ in found.sharp().values():
        assert 0.0 < own < 0.1 * value
    assert "steps" in found.notes[0]
    assert "changes with position" in found.given_up


@pytest.mark.parametrize("tendons", [False, True])
def test_files_play_what_was_fitted(legs, result, tmp_path, tendons):
    _, log = legs
    notes = []
    result.save(tmp_path / "o", tendons=tendons, report=notes.append)
    told = json.loads((tmp_path / "o" / "result.json").read_text())
    assert told["delay_s"] == pytest.approx(0.005, abs=5e-4)
    assert set(told["law"]["drives"]["reduced"]["lhip"]) >= {"armature", "damping", "friction"}
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "o" / "identified.xml"))
    assert (model.ntendon > 0) == tendons
    data = mujoco.MjData(model)
    data.qpos[:] = log.reference[0]
    played = [data.qpos.copy()]
    for k in range(int(log.duration / STEP)):
        row = max(np.searchsorted(log.time, k * STEP - told["delay_s"] + 1e-9, side="right") - 1, 0)
        data.qfrc_applied[:] = KP * (log.reference[row] - data.qpos) - KD * data.qvel
        mujoco.mj_step(model, data)
        played.append(data.qpos.copy())
    grid = STEP * np.arange(len(played))
    at = np.stack([np.interp(log.time, grid, x) for x in np.array(played).T], axis=1)
    error = float(np.sqrt(np.mean((at - log.position)[60:] ** 2)))
    assert error < (1.5e-3 if tendons else 1.2 * result.drives.rms_reduced + 1e-3)
    assert ("tendons" in " ".join(notes)) == tendons


def test_words_tell_the_proven_start_from_what_is_written(legs, result, tmp_path):
    drives = result.drives
    # Noise of encoders is all that is left: no convex step could gain anything.
    assert 0.0 <= drives.remaining < 1e-4
    assert drives.proof.startswith("not proven: the best of 2 starts")
    assert "linearized cost by more than" in drives.proof
    told = str(result.headline)
    assert "the start, a convex fit to the law's efforts (parameters.json)" in told
    assert drives.proof in told
    sentences = " ".join(result.verdict)
    assert "whose parameters stand in parameters.json, is proven" in sentences
    assert f"identified.urdf, and the drives, are {drives.proof}" in sentences
    assert "no possible parameters fit better" not in sentences
    notes = []
    result.save(tmp_path / "o", report=notes.append)
    assert "recorded efforts" not in " ".join(notes)
    stated = json.loads((tmp_path / "o" / "result.json").read_text())
    assert stated["certified_is"].startswith("the convex fit to the law's efforts")
    assert stated["law"]["proof"] == drives.proof
    assert "not of the links and drives" in (tmp_path / "o" / "report.html").read_text()
    # No certificate is of the numbers in the code of friction.
    assert "CERTIFICATE = None" in (tmp_path / "o" / "identified_friction.py").read_text()
    assert "the start: feasible" in result.summary()


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (PD(kp=KP, kd=KD, delay=0.005), ()),
        (PD(kp=KP, kd=KD, delay=0.0), ("the delay given, 0 ms, does not suit the log: ",)),
        (PD(kp=1.5 * KP, kd=KD), ("the kp given is 1.7 times what the described masses ask for",)),
        (PD(kp=0.7 * KP, kd=KD), ("the kp given, of all joints, does not suit the log: ",)),
        # Of two joints the other one may be wrong the other way round.
        (PD(kp=[KP, 1.2 * KP, KP, KP], kd=KD), ("the kp given, 20 at lhip, does not suit ",)),
    ],
    ids=["right", "delay", "kp too large", "kp too small", "kp of one joint"],
)
def test_a_wrong_law_is_named(legs, law, words):
    result = sdpid.identify(*legs, law=law)
    found = result.drives
    assert len(found.warnings) == len(words)
    for warning, start in zip(found.warnings, words, strict=True):
        assert warning.startswith(start)
        assert any(warning in each for each in result.headline.warnings)
    if law.delay is not None:
        assert not found.delay_found
        assert found.delay_in_words == f"{1e3 * law.delay:.3g} ms as given"
        assert found.proof.startswith("not proven: found by a local search from one start")


def test_kp_is_found_as_masses_tell(legs):
    found = sdpid.identify(*legs, law=PD(kp=None, kd=KD))
    (warning,) = found.headline.warnings
    assert "masses: they alone fix the scale of kp (" in warning
    np.testing.assert_allclose(found.drives.rich["kp"], KP, rtol=0.2)


@pytest.fixture(scope="module")
def files(legs, tmp_path_factory):
    """Options of the command: the log and the robot."""
    path, log = legs
    folder = tmp_path_factory.mktemp("command")
    log.to_parquet(folder / "run.parquet")
    return [str(folder / "run.parquet"), "--robot", str(path)]


BY_JOINT = """delay = 0.005
[kp]
lhip = 20.0
lknee = 20.0
rhip = 20.0
rknee = 20.0
[kd]
lhip = 1.0
lknee = 1.0
rhip = 1.0
rknee = 1.0
"""
CONFIG = """law = "pd"
kp = "20,20,20,20"
kd = "1"
delay = 0.005
for = "isaac"
"""
JOINTS = ("lhip", "lknee", "rhip", "rknee")
SERVOS = "".join(
    f'<general joint="{joint}" gainprm="20" biastype="affine" biasprm="0 -20 -1"/>'
    for joint in JOINTS
)


@pytest.mark.parametrize(
    ("name", "text", "options"),
    [
        ("law.toml", BY_JOINT, ["--law", "{file}", "--for", "mujoco"]),
        ("run.toml", CONFIG, ["--config", "{file}"]),
        ("servos.xml", None, ["--law", "{file}", "--delay", "0.005"]),
    ],
)
def test_command(legs, files, tmp_path, name, text, options):
    if text is None:
        text = legs[0].read_text().replace("</mujoco>", f"<actuator>{SERVOS}</actuator></mujoco>")
    (tmp_path / name).write_text(text)
    law = [each.format(file=tmp_path / name) for each in options]
    done = run("identify", *files, "--out", str(tmp_path / "o"), *law)
    assert done.exit_code == 0, done.output
    assert "5 ms as given" in done.stdout
    assert "mrad rms of rollouts" in done.stdout
    told = json.loads((tmp_path / "o" / "result.json").read_text())
    assert told["delay_s"] == 0.005
    assert told["law"]["kp"] == [KP] * N
    assert told["law"]["kd"] == [KD] * N
    assert told["law"]["target"] == ("isaac" if name == "run.toml" else "mujoco")
    assert 'id="drives"' in (tmp_path / "o" / "report.html").read_text()


@pytest.mark.parametrize(
    ("joint", "actuators", "says"),
    [
        ("", '<position joint="{}" kp="20" forcerange="-9 9"/>', 9.0),
        ('actuatorfrcrange="-5 5"', '<position joint="{}" kp="20" forcerange="-9 9"/>', 5.0),
        ('actuatorfrcrange="-5 5"', '<position joint="{}" kp="20" gear="-2"/>', 5.0),
        ("", '<position joint="{}" kp="20" timeconst="0.1"/>', "or filters its command"),
        ("", '<position tendon="{}" kp="20"/>', "no position servo at a joint"),
        ("", '<motor joint="{}"/>', "no position servo at a joint"),
    ],
)
def test_limits_and_filters_of_actuators(legs, tmp_path, joint, actuators, says):
    robot = sdpid.load_robot(legs[0])
    text = legs[0].read_text()
    tendons = "".join(
        f'<fixed name="{name}"><joint joint="{name}" coef="2"/></fixed>' for name in JOINTS
    )
    own = "".join(actuators.format(name) for name in JOINTS)
    text = text.replace("<joint ", f"<joint {joint} ").replace(
        "</mujoco>", f"<tendon>{tendons}</tendon><actuator>{own}</actuator></mujoco>"
    )
    (tmp_path / "servos.xml").write_text(text)
    if isinstance(says, str):
        refuses(DataError, says, law_of, str(tmp_path / "servos.xml"), robot, {})
        return
    law = law_of(str(tmp_path / "servos.xml"), robot, {})
    np.testing.assert_allclose(law.limit, [says] * N)


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("", [], "no effort was measured; give the law"),
        ("", ["--kp", "20"], "--kp: is of a law; give --law pd"),
        ("", ["--law", "pd", "--kp", "20"], "kd is missing"),
        ("", ["--law", "nowhere.toml"], "is no file, and no law but pd is known"),
        ('kd = 1\ndelay = "5"\n', ["--law", "{file}"], "delay is '5'; give seconds from 0 to 0.1"),
        ("kp = 20\nki = 3\n", ["--law", "{file}"], "ki is not known; known are kp, kd, delay"),
        ("[kp]\nlhip = 20\n", ["--law", "{file}"], "kp has not the joints of"),
        ("kd = [1, 1, 1]\n", ["--law", "{file}"], "gains of 3 joints, the robot has 4"),
    ],
)
def test_refusals_of_the_command(files, tmp_path, text, options, message):
    (tmp_path / "law.toml").write_text(text)
    law = [each.format(file=tmp_path / "law.toml") for each in options]
    done = run("identify", *files, "--out", str(tmp_path / "o"), *law)
    assert done.exit_code == 2
    assert message in " ".join(done.output.split())


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"law": PD(kp=KP, kd=KD), "friction": ("coulomb",)}, "have no place beside it"),
        ({"law": PD(kp=np.full(3, KP), kd=KD)}, "gains of 3 joints, the robot has 4"),
        ({"law": 3}, "give sdpid.controllers.PD"),
        ({"law": LAW, "target": "moon"}, "use one of mujoco, isaac, urdf"),
        ({"target": "moon"}, "use one of mujoco, isaac, urdf"),
        ({}, "no effort was measured"),
        ({"law": LAW, "changes": {"effort": "position", "reference": None}}, "no commanded"),
        ({"changes": {"reference": None}}, "needs time, position and effort, or commanded"),
    ],
)
def test_refusals(legs, how, message):
    path, log = legs
    fields = {name: getattr(log, name) for name in ("time", "position", "reference")}
    how = dict(how)
    changes = how.pop("changes", {})
    for name, value in changes.items():
        fields[name] = None if value is None else fields[value]
    with pytest.raises(DataError, match=message):
        sdpid.identify(path, sdpid.Recording(**fields), **how)


@pytest.mark.parametrize("delay", [2.0, -0.001])
def test_a_delay_that_no_drive_has_is_refused(delay):
    with pytest.raises(DataError, match=r"delay is .*; give seconds from 0 to 0\.1"):
        PD(kp=1.0, kd=1.0, delay=delay)


def calls(text):
    """The calls in a block and their keyword arguments, by names and values."""
    named = {"DELAY_STEPS": "steps"}
    tree = ast.parse(text)
    values = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
            values[node.targets[0].id] = node.value.value

    def value(node):
        return named[node.id] if isinstance(node, ast.Name) else ast.literal_eval(node)

    found = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and node.keywords]
    return values, [
        (x.func.id, {each.arg: value(each.value) for each in x.keywords}) for x in found
    ]


def test_files_to_paste(result, tmp_path):
    notes, fit = [], result.drives
    result.save(tmp_path / "o", report=notes.append)
    text = {name: (tmp_path / "o" / name).read_text() for name in NAMES}
    own = {name: fit.reduced[name] for name in ("kp", "kd", "armature", "damping", "friction")}
    by_joint = {name: dict(zip(fit.joint_names, x, strict=True)) for name, x in own.items()}
    told, ((implicit, first), (delayed, second)) = calls(text["drives_isaaclab.py"])
    assert (implicit, delayed) == ("ImplicitActuatorCfg", "DelayedPDActuatorCfg")
    assert told == {"PHYSICS_STEP": 0.002, "DELAY": fit.delay}
    assert second == {**first, "min_delay": "steps", "max_delay": "steps"}
    assert first.pop("joint_names_expr") == list(fit.joint_names)
    fields = {"stiffness": "kp", "damping": "kd", "armature": "armature"}
    fields |= {"friction": "friction", "dynamic_friction": "friction"}
    fields |= {"viscous_friction": "damping"}
    assert first == {field: by_joint[name] for field, name in fields.items()}
    told, made = calls(text["drives_mjlab.py"])
    assert told["DELAY"] == fit.delay
    fields = {"stiffness": "kp", "damping": "kd", "armature": "armature"}
    fields |= {"frictionloss": "friction", "viscous_damping": "damping"}
    for j, (joint, (name, given)) in enumerate(zip(fit.joint_names, made, strict=True)):
        assert name == "BuiltinPositionActuatorCfg"
        assert given.pop("target_names_expr") == (joint,)
        assert (given.pop("delay_min_lag"), given.pop("delay_max_lag")) == ("steps", "steps")
        assert given == {field: own[kind][j] for field, kind in fields.items()}
    # MuJoCo's servos are the law.
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "o" / "drives_mujoco.xml"))
    data, q, v, wanted = mujoco.MjData(model), *np.random.default_rng(0).uniform(-1, 1, (3, N))
    data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, wanted
    mujoco.mj_forward(model, data)
    expected = own["kp"] * (wanted - q) - own["kd"] * v
    np.testing.assert_allclose(data.qfrc_actuator, expected, rtol=1e-9)
    assert repr(fit.delay) in text["drives_mujoco.xml"]
    motors = json.loads(text["drives_bam.json"])
    for joint, motor in motors.items():
        names = {"armature": "armature", "friction_base": "friction", "friction_viscous": "damping"}
        assert {name: by_joint[kind][joint] for name, kind in names.items()}.items() < motor.items()
        assert (motor["model"], motor["command_delay"]) == ("m1", fit.delay)
    assert [*motors] == list(fit.joint_names)
    assert any("drives_bam.json: without kt and R" in note for note in notes)
    table = pd.read_csv(tmp_path / "o" / "drives.csv").set_index("joint")
    assert table["limit [N.m]"].isna().all()
    for column, numbers in (("armature [kg.m2]", own["armature"]), ("f1 [N.m/rad]", None)):
        numbers = fit.rich["slope"] if numbers is None else numbers
        # pandas before version 3 reads some of the last digits otherwise.
        np.testing.assert_allclose(table[column], numbers, rtol=1e-12)
    np.testing.assert_allclose(table["delay [s]"], fit.delay, rtol=1e-12)
    with np.load(tmp_path / "o" / "drives_samples.npz") as drawn:
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "o" / "identified.xml"))
        names = [model.joint(k).name for k in range(model.njnt)]
        assert drawn["joint_names"].tolist() == names
        assert {drawn[name].shape for name in ("armature", "f0", "friction", "kd")} == {(500, N)}


def test_blocks_of_odd_names_and_limits(result, tmp_path):
    odd = ("l.hip", "l'knee\n", "r\\hip", "rknéé\u2028")
    law = replace(result.drives.law, limit=np.array([1.0, 2.0, 3.0, 4.0]))
    fit = replace(result.drives, joint_names=odd, law=law)
    _, ((_, implicit), (_, delayed)) = calls(isaaclab(fit))
    assert implicit["joint_names_expr"][0] == r"l\.hip"
    assert [*implicit["effort_limit_sim"].values()] == [1.0, 2.0, 3.0, 4.0]
    assert delayed["effort_limit"] == implicit["effort_limit_sim"]
    assert [given["effort_limit"] for _, given in calls(mjlab(fit))[1]] == [1.0, 2.0, 3.0, 4.0]
    servos = ElementTree.fromstring(drive_files.mujoco(fit)).findall("actuator/position")
    assert [servo.get("joint") for servo in servos] == [*odd]
    assert [servo.get("forcerange") for servo in servos][:2] == ["-1.0 1.0", "-2.0 2.0"]
    assert [*json.loads(bam(fit))] == list(odd)
    for text in (isaaclab(fit), mjlab(fit), bam(fit)):
        assert text.isascii()
    constants = replace(fit, choice=replace(fit.choice, rows=("armature", "damping", "friction")))
    write_drives(constants, tmp_path)
    header = (tmp_path / "drives.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header.endswith("friction [N.m],delay [s]")


def test_draws_are_those_of_the_fit(result):
    fit = result.drives
    drawn = draw_drives(fit, 400, joints=fit.joint_names[::-1], seed=3)
    assert drawn["joint_names"].tolist() == list(fit.joint_names[::-1])
    deviations = np.sqrt(np.diag(fit.covariance))
    numbers = np.concatenate([fit.rich[kind] for kind in fit.kinds])
    names = {"armature": "armature", "damping": "damping", "friction": "f0", "slope": "f1"}
    columns = np.concatenate([drawn[names[kind]][:, ::-1] for kind in fit.kinds], axis=1)
    columns = np.column_stack([columns, drawn["delay"]])
    far = np.append(numbers, fit.delay) > 4.0 * deviations
    far[3 * N :] = True
    assert far.mean() > 0.8
    found = np.cov(columns, rowvar=False)[np.ix_(far, far)]
    scale = np.outer(deviations, deviations)[np.ix_(far, far)]
    assert np.abs((found - fit.covariance[np.ix_(far, far)]) / scale).max() < 0.25
    off = (columns.mean(axis=0) - np.append(numbers, fit.delay)) / deviations
    assert np.abs(off[far]).max() < 0.25
    assert min(drawn[name].min() for name in ("armature", "damping", "friction", "delay")) >= 0.0
    given = replace(
        fit, delay_found=False, names=fit.names[:-1], covariance=fit.covariance[:-1, :-1]
    )
    assert np.all(draw_drives(given, 5)["delay"] == fit.delay)


def test_truncated_normal_is_that_of_rejection():
    mean, low = np.array([0.1, -1.0, 3.0]), np.array([0.0, 0.0, 3.0])
    covariance = np.array([[1.0, -0.6, 0.0], [-0.6, 1.0, 0.0], [0.0, 0.0, 0.0]])
    start = np.array([0.5, 0.5, 3.0])
    high = np.array([np.inf, 2.0, 3.0])
    found = truncated_normal(np.tile(mean, (4000, 1)), covariance, low, high, start)
    rng = np.random.default_rng(1)
    free = rng.multivariate_normal(mean[:2], covariance[:2, :2], 400_000)
    kept = free[np.all((free >= low[:2]) & (free <= high[:2]), axis=1)]
    assert len(kept) > 5000
    assert np.all((found >= low) & (found <= high))
    np.testing.assert_allclose(found[:, :2].mean(axis=0), kept.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(np.cov(found[:, :2].T), np.cov(kept.T), atol=0.02)
    # A hundred deviations from the bound little but the bound is left.
    tail = truncated_normal(
        np.full((50, 1), -100.0), np.eye(1), np.zeros(1), np.ones(1), np.ones(1)
    )
    assert 0.0 < tail.mean() < 0.02


@pytest.fixture(scope="module")
def built(legs):
    """The log, and the problem of a law's efforts on it."""
    path, log = legs
    terms = ("coulomb", "viscous", "rotor_inertia")
    how = {"friction": terms, "weighting": "residual", "prior": sdpid.Prior()}
    return log, partial(sdpid.build_problem, sdpid.load_robot(path), **how)


def test_closed_loops_take_the_delay_of_a_law(built, result):
    log, build = built
    law = PD(kp=KP, kd=KD, delay=0.005)
    problem = build(log, law=law)
    assert problem.samples.notes[-1].endswith("5 ms after commands")
    found = sdpid.solve_output_error(problem, log, method="closed_loop", law=law)
    assert found.controller.delay == 0.005
    late = partial(
        sdpid.solve_output_error, problem, log, method="closed_loop", law=replace(law, delay=0.0)
    )
    with pytest.raises(DataError, match="is not that of this log"):
        late()
    missed = late(controller_tolerance=np.inf, start=found).position_error
    assert 2.0 * found.position_error.min() < missed.min()
    of_drives = sdpid.rollout(result, log, (0.1,), law=result.drives.law, baselines=False)
    of_efforts = sdpid.rollout(result.estimate, log, (0.1,), law=law, baselines=False)
    assert of_drives.median[0] < 0.7 * of_efforts.median[0]
    assert "ms after the commands" in of_drives.said[0]


def test_added_efforts_and_lines_act_in_closed_loops(built):
    log, _ = built
    own = np.full_like(log.position, 0.4)
    lines = np.sin(np.asarray(log.time))[:, None] * np.ones(N)
    added = sdpid.Recording(time=log.time, position=log.position, reference=lines, feedforward=own)
    motion = CommandedMotion.under(added, PD(kp=np.full(N, KP), kd=KD, delay=0.003))
    at = np.array([0.5, 0.5012])
    expected = np.sin(at - 0.003) + 0.4 / KP
    np.testing.assert_allclose(motion.at(at)[:, 0, 1], expected, atol=1e-5)
    assert not motion.at(at)[:, 1:].any()


def test_refusals_of_simulations_under_a_law(built):
    log, build = built
    law = PD(kp=KP, kd=KD, delay=0.005)
    problem = build(log, law=PD(kp=KP, kd=KD))
    assert "4 ms after commands, the usual delay" in problem.samples.notes[-1]
    estimate, samples = sdpid.solve_wls(problem), problem.samples
    for call, message in (
        (lambda: build(samples, law=law), "samples hold none; give the recordings"),
        (lambda: build(log, law=PD(kp=None, kd=KD)), "its kp is None, to be found; build_problem"),
        (lambda: build(log, law=3), "law: is 3; give sdpid.controllers.PD"),
        (lambda: sdpid.rollout(estimate, log, law=LAW), "its delay is None, .* rollout needs a"),
        (lambda: sdpid.rollout(estimate, samples, law=law), "samples hold no commands"),
        (lambda: sdpid.solve_output_error(problem, log, law=LAW), "its delay is None"),
        (
            lambda: sdpid.solve_output_error(problem, log, law=law, controller="fit"),
            "leave controller and reference out",
        ),
    ):
        with pytest.raises(DataError, match=message):
            call()


@pytest.mark.parametrize(
    ("target", "friction", "words"),
    [
        ("mujoco", ("rotor_inertia",), "nothing is given up"),
        ("urdf", ("rotor_inertia",), "without RotorInertia Ia1, Ia2: "),
        ("isaac", ("offset",), "without Offset Fo1, Fo2: "),
    ],
)
def test_what_a_target_gives_up_of_measured_efforts(target, friction, words):
    terms = ("coulomb", "viscous", *friction)
    note = world.result(friction=terms, target=target, effects="none").notes[0]
    assert note.startswith(f"for {target}: {words}")
    assert ("recorded efforts are missed by" in note) == ("without" in words)


def test_a_coupled_wrist_is_given_up_where_there_are_no_tendons():
    motors = sdpid.friction.Coupling("a", "b", width=0.05)
    terms = ("coulomb", "viscous", "rotor_inertia", motors)
    estimate = world.result(friction=terms, effects="none").estimate
    values = np.array(estimate.theta)
    values[-9:] = [0.3, 0.3, 0.2, 0.2, 0.5, 0.5, 0.1, 0.05, 0.2]
    estimate = replace(estimate, theta=values)
    without, held = (given_up(estimate, target) for target in ("isaac", "mujoco"))
    assert "without Coupling" in without
    assert "Coupling" not in held
