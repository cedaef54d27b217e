"""Draw the pictures of the guides from simulated and public records.

    python docs/pictures.py               # all of them, a few minutes
    python docs/pictures.py friction logs

Pictures of real arms need the public records: `SDPID_DATA` names their folder (evidence/data.md).
"""

from __future__ import annotations

import csv
import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from matplotlib.figure import Figure

import sdpid
from sdpid import plots
from sdpid.output.robots.repair import repair_urdf
from sdpid.plots.figures import BLUE, GRAY, GREEN, ORANGE, RED
from sdpid.robot.friction.model import FrictionModel

IMAGES = Path(__file__).resolve().parent / "images" / "guides"
DPI = 90.0
RECORDS = Path(os.environ.get("SDPID_DATA", "data"))
UR10, UR10E = RECORDS / "ur10_unisa", RECORDS / "ur10e_innopolis"
URDF, LOG = UR10 / "ur10.urdf", UR10 / "ur10_exciting.npz"
# Of the UR10's record these rows are fitted, and the others predicted.
FITTED, PREDICTED = (1, 2064), (2065, 3441)
SHOULDER = "shoulder_lift_joint"
# Of joint 1 of the simulated arm, in theta.
VISCOUS = -6
# Gains of another UR10, N·m/A: those of the tutorial on payloads.
OTHER_UR10 = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
# The UR10e's logs have no header, and currents.
COLUMNS = {name: [*range(k, k + 6)] for name, k in (("position", 2), ("velocity", 8))}
COLUMNS["effort"] = [*range(14, 20)]


def panels(rows: int = 1, columns: int = 1, *, height: float = 2.6, **options: Any) -> Any:
    """Return the axes of a figure as wide as a page."""
    figure = Figure(figsize=(8.0, height), layout="constrained", facecolor="white")
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for axis in axes.flat:
        axis.grid(visible=True, color="#E5E7EB", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    return axes


def bars(axis: Any, groups: dict[str, Any], names: Any, colors: Any, form: str = "{:.1f}") -> None:
    """Draw groups of values side by side, with their numbers."""
    width = 0.8 / len(groups)
    for k, (label, values) in enumerate(groups.items()):
        at = np.arange(len(names)) + (k - 0.5 * (len(groups) - 1)) * width
        drawn = axis.bar(at, values, 0.94 * width, label=label, color=colors[k])
        told = ["" if np.isnan(each) else form.format(each) for each in values]
        axis.bar_label(drawn, told, fontsize=7, padding=1)
    axis.set_xticks(np.arange(len(names)), names, fontsize=8)
    axis.margins(y=0.15)
    if len(groups) > 1:
        axis.legend(frameon=False, fontsize=8)


@cache
def ur10() -> sdpid.RobotModel:
    """Return the description of the UR10."""
    return sdpid.load_robot(URDF)


def rows(of: tuple[int, int]) -> sdpid.Recording:
    """Return a part of the UR10's record."""
    return sdpid.read_recording(LOG, rows=list(of))


@cache
def identified() -> Any:
    """Return what the first part of the UR10's record says, judged by the rest."""
    return sdpid.identify(ur10(), rows(FITTED), validation=rows(PREDICTED))


@cache
def denso(periods: int = 1) -> tuple[sdpid.RobotModel, Any, sdpid.Recording]:
    """Return a simulated arm, its motion and the log of it."""
    robot = sdpid.load_robot("denso_vp6242")
    motion = sdpid.paper_excitation("denso_vp6242", seed=0, periods=periods, period=10.0)
    return robot, motion, sdpid.simulate(robot, motion, seed=1)


def audit() -> Any:
    """Draw bodies that cannot exist, and repaired."""
    with tempfile.TemporaryDirectory() as folder:
        file, mended = Path(folder) / "hand.urdf", Path(folder) / "repaired.urdf"
        file.write_text(sdpid.load_robot("allegro_right_hand").urdf, encoding="utf-8")
        repair_urdf(file, target=mended)
        found = {
            label: {body.link: body.triangle_ratio for body in sdpid.audit_urdf(each).bodies}
            for label, each in (("as described", file), ("repaired", mended))
        }
    axes = panels()
    for k, (label, ratios) in enumerate(found.items()):
        at = np.arange(len(ratios)) + 0.2 * (2 * k - 1)
        heights = [float(ratio or 0.0) for ratio in ratios.values()]
        axes[0, 0].bar(at, heights, 0.38, color=(RED, BLUE)[k], label=label)
    axes[0, 0].axhline(1.0, color="black", linewidth=1.0, linestyle="--")
    axes[0, 0].set_xticks(np.arange(len(ratios)), [*ratios], fontsize=7, rotation=40)
    axes[0, 0].set(ylabel="largest moment /\nsum of the others", ylim=(0.0, 1.9))
    axes[0, 0].legend(frameon=False, fontsize=8, ncols=2)
    return axes


def certificate() -> Any:
    """Draw local solvers above the proven bound."""
    robot, _, log = denso(4)
    problem = sdpid.build_problem(
        robot, sdpid.process(log), constraints=sdpid.Constraints(margin=0.005)
    )
    axes = panels(height=3.2)
    sdpid.compare(problem, starts=4, seed=0).plot(axes=axes[0, 0])
    return axes


def closed_loop() -> Any:
    """Draw the lag behind the commands, measured and simulated."""
    robot, motion, log = denso()
    law = sdpid.controllers.fit_controller(log, "p").require()
    model = sdpid.solve_sdp(sdpid.build_problem(robot, sdpid.process(log))).model()
    moved = sdpid.simulate_closed_loop(model, motion, law, rate_hz=100.0)
    axes = panels()
    axis = axes[0, 0]
    measured = np.rad2deg(log.reference - log.position)[:, 1]
    wanted = motion.sample()[0][:: round(motion.rate_hz / 100.0)]
    simulated = np.rad2deg(wanted - moved.position)[:, 1]
    axis.plot(log.time - log.time[0], measured, color=ORANGE, linewidth=4.0, label="recorded")
    axis.plot(moved.time, simulated, color=BLUE, linewidth=1.3, label="simulated: model and law")
    axis.set(xlabel="time [s]", ylabel="command less position,\njoint 2 [°]", xlim=(9.0, 19.0))
    axis.legend(frameon=False, fontsize=8)
    return axes


def constraints() -> Any:
    """Draw masses without and with what is known."""
    samples = sdpid.process(rows(FITTED))
    known = sdpid.constraints.TotalMass(25.0, tolerance=0.5)
    estimates = {"as described": ur10().prior[:, 0]}
    for label, others in (("data alone", ()), ("total mass 25 ± 0.5 kg", (known,))):
        problem = sdpid.build_problem(
            ur10(),
            samples,
            friction=("coulomb", "viscous", "offset"),
            weighting="residual",
            constraints=sdpid.Constraints.of_size(ur10(), others=others),
        )
        estimates[label] = sdpid.solve_sdp(problem).theta[: 10 * ur10().n_links : 10]
    axes = panels()
    bars(axes[0, 0], estimates, ur10().link_names, (GRAY, ORANGE, BLUE))
    axes[0, 0].set_ylabel("mass [kg]")
    return axes


def effects() -> Any:
    """Draw what is missed with and without effects."""
    plain = sdpid.identify(ur10(), rows(FITTED), validation=rows(PREDICTED), effects="none")
    missed = {
        label: 100.0 * each.held_out.fit.moving.rmse / np.sqrt(np.mean(measured**2, axis=0))
        for label, each in (("--effects none", plain), ("--effects auto", identified()))
        for measured in [each.held_out.samples.effort]
    }
    axes = panels()
    bars(axes[0, 0], missed, ur10().joint_names, (GRAY, BLUE))
    axes[0, 0].set_ylabel("missed effort, not fitted [%]")
    return axes


def estimation() -> Any:
    """Draw mass matrices along the motion."""
    result, samples, axes = identified(), sdpid.process(rows(FITTED)), panels()
    least = {
        label: np.linalg.eigvalsh(each.mass_matrix(samples.position))[:, 0]
        for label, each in (("least squares", result.wls), ("this estimate", result.estimate))
    }
    plots.plot_mass_matrix(samples.time, least, starts=samples.starts, axes=axes[0, 0])
    return axes


def excitation() -> Any:
    """Draw a planned motion of a joint within its limits."""
    plan = sdpid.design_excitation(ur10(), duration=8, starts=1, time_limit=60.0)
    q, v, a = plan.trajectory.sample()
    time = np.arange(len(q)) / plan.trajectory.rate_hz
    low, high = ur10().position_limits[1]
    speed = ur10().velocity_limits[1]
    axes = panels(3, 1, height=3.4, sharex=True)
    quantities = [
        ("rad", q[:, 1], low, high),
        ("rad/s", v[:, 1], -speed, speed),
        ("rad/s²", a[:, 1], None, None),
    ]
    plots.plot_against_limits(time, quantities, axes=list(axes[:, 0]))
    return axes


def exports() -> Any:
    """Draw friction as it is, and as a URDF can say it."""
    result = identified()
    curve = result.friction_curve(SHOULDER)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "identified.urdf"
        sdpid.write_urdf(result.estimate, target=file)
        found = ElementTree.parse(file).find(f"joint[@name='{SHOULDER}']/dynamics")
    damping, dry = float(found.get("damping")), float(found.get("friction"))
    axes = panels()
    plots.plot_friction_curve(curve, axes=axes[0, 0])
    line = damping * curve.velocity + dry * np.sign(curve.velocity)
    axes[0, 0].plot(curve.velocity, line, color=BLUE, linewidth=1.2, label="identified.urdf")
    axes[0, 0].legend(frameon=False, fontsize=8)
    return axes


def fleet() -> Any:
    """Draw one parameter of six robots alike."""
    robot, motion, _ = denso()
    truth = sdpid.identify(robot, denso()[2], effects="none", intervals=False).estimate.theta
    factors = np.random.default_rng(0).uniform(0.6, 1.4, 6)
    axes = panels()
    for k, factor in enumerate(factors):
        theta = truth.copy()
        theta[VISCOUS:] *= factor
        log = sdpid.simulate(robot, motion, theta=theta, seed=k)
        found = sdpid.identify(robot, log, effects="none").intervals
        j = found.names.index("Fv1")
        middle = found.estimate[j]
        error = [[middle - found.lower[j]], [found.upper[j] - middle]]
        label = "estimate, 95 %" if k == 0 else None
        axes[0, 0].errorbar(k + 1, middle, error, fmt="o", color=BLUE, capsize=4, label=label)
        label = "true" if k == 0 else None
        axes[0, 0].plot(k + 1, theta[VISCOUS], "_", color=RED, markersize=18, label=label)
    axes[0, 0].set(xlabel="robot", ylabel="viscous friction,\njoint 1 [N·m·s/rad]")
    axes[0, 0].legend(frameon=False, fontsize=8)
    return axes


def friction() -> Any:
    """Draw shapes of terms over the velocity."""
    v = np.linspace(-1.0, 1.0, 801)[:, None]
    f = sdpid.friction
    terms = {
        "coulomb": f.Coulomb(),
        "coulomb, width 0.1": f.Coulomb(width=0.1),
        "viscous": f.Viscous(),
        "square_root": f.SquareRootFriction(),
        "stribeck 0.15": f.Stribeck(velocity=0.15),
        "sigmoid 0.3": f.SigmoidFriction(velocity=0.3),
    }
    axes = panels(1, 6, height=1.7, sharey=True)
    for axis, (name, term) in zip(axes.flat, terms.items(), strict=True):
        column = FrictionModel.from_terms((term,), ("joint",)).columns(v, 0.0 * v)[:, 0, 0]
        axis.plot(v, column, color=BLUE, linewidth=1.5)
        axis.set_title(name, fontsize=8)
        axis.set_xlabel("v [rad/s]", fontsize=8)
        axis.tick_params(labelsize=7)
    axes[0, 0].set_ylabel("column", fontsize=8)
    return axes


def currents(name: str) -> sdpid.Recording:
    """Return a log of the UR10e's currents, without the rubbish at the ends of one."""
    lines = (UR10E / name).read_text(encoding="utf-8").splitlines()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / name
        file.write_text("\n".join(lines[10:-1]) + "\n", encoding="utf-8")
        return sdpid.read_recording(
            file, columns={"time": 1, **COLUMNS}, units={"effort": "A"}, currents=True
        )


def gains() -> Any:
    """Draw gains by a weighed load, and those of another robot."""
    arm = UR10E / "ur10e.urdf"
    bare = currents("20_02_19_15harm50sec.csv")
    loaded = currents("20_02_19_15harm50secLoad.csv")
    found = sdpid.identify_drive_gains(arm, bare, loaded, load=2.805).gains
    half = 1.96 * np.sqrt(np.diag(found.covariance))
    axes = panels()
    at, style = np.arange(6), {"fmt": "o", "capsize": 5, "color": BLUE}
    axes[0, 0].errorbar(at, found.gains, half, label="by a load of 2.805 kg, 95 %", **style)
    axes[0, 0].plot(at + 0.15, OTHER_UR10, "s", color=GRAY, label="of another UR10")
    axes[0, 0].set_xticks(at, found.joint_names, fontsize=8)
    axes[0, 0].set_ylabel("gain [N·m/A]")
    axes[0, 0].legend(frameon=False, fontsize=8)
    return axes


def inspection() -> Any:
    """Draw an effort with the wrong sign against what the bodies need."""
    samples = sdpid.process(rows((1, 1500)))
    needed = ur10().regressor(samples.position, samples.velocity, samples.acceleration)
    needed = (needed @ ur10().prior.ravel())[:, 1]
    axes = panels(1, 2, sharey=True)
    for axis, sign, title in zip(axes.flat, (1, -1), ("as logged", "sign flipped"), strict=True):
        axis.plot(samples.time, needed, color=ORANGE, linewidth=1.8, label="described bodies")
        axis.plot(samples.time, sign * samples.effort[:, 1], color=BLUE, linewidth=1, label="log")
        axis.set(xlabel="time [s]", title=title)
    axes[0, 0].set_ylabel("effort of the shoulder [N·m]")
    axes[0, 0].legend(frameon=False, fontsize=8)
    return axes


def intervals() -> Any:
    """Draw base parameters with their intervals."""
    result = identified()
    found = result.intervals
    names = result.problem.base.names[:12]
    places = [found.names.index(name) for name in names]
    values = {"least squares": result.wls.base[:12], "this estimate": result.estimate.base[:12]}
    axes = panels(height=3.6)
    lower, upper = found.lower[places], found.upper[places]
    plots.plot_forest(names, values, lower=lower, upper=upper, axes=axes[0, 0])
    return axes


def law() -> Any:
    """Draw what a log of commands and positions leaves open of a delay."""
    hung = RECORDS / "go2_hung"
    pd = sdpid.controllers.PD(kp=20.0, kd=1.5)
    drives = sdpid.identify(hung / "go2.xml", hung / "first_60_percent.npz", law=pd).drives
    assert drives is not None
    delay, armature = 1e3 * drives.along["delay"], drives.along["armature"]
    left, right = panels(1, 2).flat
    left.plot(delay, 1e3 * drives.along["error"], color=BLUE)
    right.plot(delay, armature, color=GRAY, linewidth=0.7)
    right.plot(delay, armature.mean(axis=1), color=BLUE, linewidth=2.5, label="mean of the joints")
    right.legend(frameon=False, fontsize=8)
    for axis, label in ((left, "error [mrad rms]"), (right, "armature [kg·m²]")):
        axis.axvspan(*(1e3 * x for x in drives.delay_interval), color=BLUE, alpha=0.12)
        axis.set(xlabel="delay [ms]", ylabel=label, ylim=(0.0, None))
    return left


def legged() -> Any:
    """Draw feet and height of a trot."""
    log = sdpid.simulate_legged("solo12", "trot", duration=2.0).recording
    time = log.time - log.time[0]
    axes = panels(2, 1, height=3.0, sharex=True)
    axes[0, 0].plot(time, 1e3 * log.base.position[:, 2], color=BLUE)
    axes[0, 0].set_ylabel("base, height [mm]")
    frames = log.contacts.frames
    for k, down in enumerate(np.asarray(log.contacts.down).T):
        axes[1, 0].fill_between(time, k + 0.1, k + 0.9, where=down, color=GREEN, linewidth=0)
    axes[1, 0].set_yticks(np.arange(len(frames)) + 0.5, frames, fontsize=8)
    axes[1, 0].set_xlabel("time [s]; green: down")
    return axes


def lines() -> Any:
    """Draw what four models miss."""
    every = identified().held_out.every
    axes = panels()
    missed = [100.0 * fit.moving.relative for fit in every.values()]
    bars(axes[0, 0], {"": missed}, [*every], (BLUE,))
    axes[0, 0].set_ylabel("missed effort, not fitted [%]")
    return axes


def logs() -> Any:
    """Draw what a log holds."""
    log = rows((1, 1500))
    joints = {
        name: [
            ("position, rad", log.position[:, j], None, None),
            ("effort, N·m", log.effort[:, j], None, None),
        ]
        for j, name in enumerate(log.joint_names[:3])
    }
    axes = panels(2, 3, height=3.0, sharex=True)
    plots.plot_motion(log.time - log.time[0], joints, axes=axes)
    return axes


def loops() -> Any:
    """Draw the slider-crank of the page, with its cut."""
    axes = panels(1, 3, height=2.0, sharey=True)
    for axis, angle in zip(axes.flat, np.deg2rad([20.0, 80.0, 140.0]), strict=True):
        pin = 0.1 * np.array([np.cos(angle), np.sin(angle)])
        slide = pin[0] + np.sqrt(0.3**2 - pin[1] ** 2)
        axis.plot([0.0, pin[0]], [0.0, pin[1]], color=BLUE, linewidth=4, label="crank")
        axis.plot([pin[0], slide], [pin[1], 0.0], color=GREEN, linewidth=4, label="rod")
        axis.plot([0.0, pin[0]], [0.0, pin[1]], "o", color="black", markersize=6)
        axis.plot(slide, 0.0, "s", color=GRAY, markersize=14, label="slider")
        axis.plot(slide, 0.0, "x", color=RED, markersize=10, markeredgewidth=2.5, label="cut: pin")
        axis.set(xlim=(-0.12, 0.43), ylim=(-0.05, 0.13), xlabel="x [m]")
        axis.set_aspect("equal")
    axes[0, 0].set_ylabel("z [m]")
    axes[0, 2].legend(frameon=False, fontsize=7, loc="upper right")
    return axes


def model() -> Any:
    """Draw parts of an effort."""
    result = identified()
    found, samples = result.model(), result.validation_samples
    q, v, a = samples.position, samples.velocity, samples.acceleration
    j, time = 1, samples.time - samples.time[0]
    parts = {
        "inertia": np.einsum("kij,kj->ki", found.mass_matrix(q), a),
        "Coriolis": np.einsum("kij,kj->ki", found.coriolis(q, v), v),
        "gravity": found.gravity(q),
        "friction": found.friction(v),
    }
    axes = panels()
    axis = axes[0, 0]
    axis.plot(time, samples.effort[:, j], color="black", linewidth=1.0, label="measured")
    for color, (name, values) in zip((ORANGE, RED, BLUE, GREEN), parts.items(), strict=True):
        axis.plot(time, values[:, j], color=color, linewidth=1.2, label=name)
    axis.set(xlabel="time [s]", ylabel="effort of the shoulder [N·m]")
    axis.legend(frameon=False, fontsize=8, ncols=5, loc="upper center")
    axis.margins(y=0.2)
    return axes


def payload() -> Any:
    """Draw one motion without and with a load."""
    axes = panels()
    runs = (("without", "", GRAY), ("with 2.805 kg", "Load", BLUE))
    for label, name, color in runs:
        log = currents(f"20_02_19_15harm50sec{name}.csv")
        begin = np.flatnonzero(np.abs(log.position - log.position[0]).max(axis=1) > 0.05)[0]
        time = log.time - log.time[begin]
        keep = (time > -0.5) & (time < 15.0)
        current = log.effort[keep, 1]
        axes[0, 0].plot(time[keep], current, color=color, linewidth=0.8, label=label)
    axes[0, 0].set(xlabel="time [s]", ylabel="current of the shoulder [A]")
    axes[0, 0].legend(frameon=False, fontsize=8)
    return axes


def processing() -> Any:
    """Draw a position twice differentiated, and an effort, before and after."""
    log = denso()[2]
    samples = sdpid.process(log)
    j, axes = 1, panels(1, 2)
    raw = np.gradient(np.gradient(log.position[:, j], log.time), log.time)
    for axis, before, after, name in (
        (axes[0, 0], log.effort[:, j], samples.effort[:, j], "effort [N·m]"),
        (axes[0, 1], raw, samples.acceleration[:, j], "acceleration [rad/s²]"),
    ):
        axis.plot(log.time, before, color=GRAY, linewidth=0.5, label="recorded, differenced")
        axis.plot(samples.time, after, color=BLUE, linewidth=1.5, label="samples")
        shown = before[(log.time > 10.0) & (log.time < 12.0)]
        axis.set_ylim(1.1 * shown.min(), 1.1 * shown.max())
        axis.set(xlabel="time [s]", ylabel=name, xlim=(10.0, 12.0))
    axes[0, 0].legend(frameon=False, fontsize=8)
    return axes


def recursive() -> Any:
    """Draw friction that changes, tracked."""
    robot, motion, log = denso()
    found = sdpid.identify(robot, log, effects="none", intervals=False)
    theta = found.estimate.theta.copy()
    pieces = []
    for seed, factor in enumerate((1.0, 1.6)):
        changed = theta.copy()
        changed[VISCOUS] *= factor
        run = sdpid.simulate(robot, motion, theta=changed, seed=seed)
        pieces.append(sdpid.process(replace(run, period=None, start=None, periods=None)))
    half = len(pieces[0].time)
    steps = np.linspace(0, half, 11).astype(int)
    problem = sdpid.build_problem(robot, pieces[0].between(0, steps[3]), weighting="residual")
    axes = panels()
    for color, forgetting in ((GRAY, 1.0), (BLUE, 0.99)):
        estimator = sdpid.RecursiveEstimator(problem, forgetting=forgetting)
        times, values = [], []
        for k, samples in enumerate(pieces):
            for begin, end in pairwise(steps):
                if k == 0 and end <= steps[3]:
                    continue
                estimator.update(samples.between(begin, end))
                times.append(10.0 * k + 10.0 * end / half)
                values.append(estimator.solve().named()["Fv1"])
        label = f"forgetting={forgetting:g}"
        axes[0, 0].plot(times, values, "o-", color=color, markersize=4, label=label)
    was = theta[VISCOUS]
    axes[0, 0].step([3.0, 10.0, 20.0], [was, was, 1.6 * was], color=RED, where="pre", label="true")
    axes[0, 0].set(xlabel="time [s]", ylabel="viscous friction [N·m·s/rad]")
    axes[0, 0].legend(frameon=False, fontsize=8)
    return axes


def rollout() -> Any:
    """Draw how simulations go astray."""
    moved = sdpid.rollout(identified().estimate, rows(PREDICTED), horizons=(0.1, 0.5, 1.0))
    axes = panels(height=3.0)
    moved.plot(axes=axes[0, 0])
    return axes


def sampling() -> Any:
    """Draw draws of two parameters, and the ranges that lose what is known."""
    drawn = sdpid.sample_parameters(identified(), 200, seed=0).to_frame()
    pairs = (("Fs2", "Fsg2"), ("mz_2", "m_3"))
    axes = panels(1, 2)
    for axis, (x, y) in zip(axes.flat, pairs, strict=True):
        axis.plot(drawn[x], drawn[y], ".", color=BLUE, markersize=4)
        low, high = (drawn[[x, y]].quantile(p) for p in (0.025, 0.975))
        box = [low[x], high[x], high[x], low[x], low[x]], [low[y], low[y], high[y], high[y], low[y]]
        axis.plot(*box, color=RED, linewidth=1.2)
        axis.set(xlabel=x, ylabel=y)
    return axes


def springs() -> Any:
    """Draw the effort of a simulated spring over the angle, with its band."""
    robot, rng = sdpid.load_robot(URDF), np.random.default_rng(0)
    time = np.arange(0.0, 20.0, 0.01)
    rates = rng.uniform(0.5, 3.0, (4, robot.n))
    angle = rates * time[:, None, None] + rng.uniform(0.0, 6.0, (4, robot.n))
    waves = np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle)
    q, v, a = (0.3 * each.sum(axis=1) for each in waves)
    stiffness, rest, axes = 40.0, 0.2, panels(1, 2, height=2.3, sharey=True)
    effort = robot.inverse_dynamics(robot.prior, q, v, a) + 5.0 * v
    effort[:, 1] += stiffness * (q[:, 1] - rest)
    effort += 5.0 * rng.standard_normal(effort.shape)
    grid = np.linspace(q[:, 1].min(), q[:, 1].max(), 50)
    for axis, count in zip(axes.flat, (200, 2000), strict=True):
        log = {"position": q, "velocity": v, "acceleration": a, "effort": effort}
        samples = sdpid.Samples(**{name: each[:count] for name, each in log.items()})
        spring = sdpid.friction.Spring(SHOULDER, rest=rest)
        problem = sdpid.build_problem(
            robot, samples, friction=("viscous", spring), weighting="residual"
        )
        found = sdpid.confidence_intervals(sdpid.solve_sdp(problem))
        k = found.names.index("K2")
        low, high = (np.array(ends)[k] for ends in (found.lower, found.upper))
        middle = 0.5 * (low + high) * (grid - rest)
        half = 0.5 * (high - low) * np.abs(grid - rest)
        axis.fill_between(grid, middle - half, middle + half, color=BLUE, alpha=0.25)
        axis.plot(grid, middle, color=BLUE, linewidth=1.5, label=f"{count} samples")
        axis.plot(grid, stiffness * (grid - rest), "--", color=GRAY, linewidth=1, label="truth")
        axis.set_xlabel("angle [rad]")
        axis.legend(frameon=False, fontsize=8)
    axes[0, 0].set_ylabel("effort of the spring [N·m]")
    return axes


def transmissions() -> Any:
    """Draw the motion and the efforts of a wrist's motors, and of the joints that follow them."""
    names = ("joint_5", "joint_6")
    wrist = sdpid.Transmission([[0.5, 0.5], [0.5, -0.5]], joints=names, names=("left", "right"))
    robot = sdpid.load_robot("denso_vp6242", transmission=wrist)
    time = np.linspace(0.0, 4.0, 400)
    m = np.stack([np.sin(2.0 * time), 0.6 * np.sin(3.0 * time)], axis=1)
    axes, tau = panels(1, 4, height=2.0), 0.2 * np.cos(np.outer(time, [2.0, 3.0]))
    M = robot.expansion[4:, 4:]
    parts = {"motors [rad]": m, "joints [rad]": m @ M.T}
    parts |= {"effort of joints [N·m]": tau, "effort of motors [N·m]": tau @ M}
    for axis, (name, values) in zip(axes.flat, parts.items(), strict=True):
        labels = names if "joints" in name else ("left", "right")
        for column, label, color in zip(values.T, labels, (BLUE, ORANGE), strict=True):
            axis.plot(time, column, color=color, linewidth=1.2, label=label)
        axis.set_title(name, fontsize=8)
        axis.set_xlabel("time [s]", fontsize=8)
        axis.tick_params(labelsize=7)
        axis.legend(frameon=False, fontsize=7)
    return axes


def ready_models() -> Any:
    """Draw what four models of each arm miss, from the table of evidence/ready_models.md."""
    table = IMAGES.parents[1] / "evidence" / "tables" / "ready_models" / "models.csv"
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    arms, models = (dict.fromkeys(row[key] for row in rows) for key in ("arm", "model"))
    order = ("URDF", "Menagerie", "URDF, friction fitted", "identified")
    assert {*order} >= {*models}
    columns = {
        "missed_percent": "missed effort [%]",
        "released_100_mrad": "0.1 s after the\nrelease [mrad]",
        "tracking_deg": "tracking error of\nthe median joint [°]",
    }
    axes = panels(3, 1, height=6.6, sharex=True)
    for axis, (column, label) in zip(axes.flat, columns.items(), strict=True):
        found = {(row["arm"], row["model"]): float(row[column] or "nan") for row in rows}
        groups = {m: [found.get((arm, m), np.nan) for arm in arms] for m in order if m in models}
        bars(axis, groups, arms, (GRAY, ORANGE, GREEN, BLUE))
        axis.set_yscale("log")
        axis.set_ylabel(label)
        axis.get_legend().remove()
    axes[0, 0].legend(frameon=False, fontsize=8, ncols=4, loc="lower left", bbox_to_anchor=(0, 1))
    return axes


def two_encoders() -> Any:
    """Draw the deflection of two gears over their torque."""
    folder = RECORDS / "kr300"
    logs = [sdpid.read_recording(folder / f"run_{run}.npz") for run in "AB"]
    found = sdpid.identify(
        folder / "kr300.urdf",
        logs,
        constraints=sdpid.Constraints(mass_max=1500.0),
        rotor_inertia=[609.0, 844.0, 751.0, *[np.nan] * 3],
    ).elasticity
    assert found is not None
    axes = panels(1, 2)
    for axis, name in zip(axes.flat, ("joint_2", "joint_3"), strict=True):
        torque, measured, predicted = found.curves[name][:, ::2]
        axis.plot(1e-3 * torque, 1e3 * measured, ".", color=GRAY, markersize=4, label="measured")
        axis.plot(1e-3 * torque, 1e3 * predicted, ".", color=RED, markersize=1, label="predicted")
        stiffness = found.stiffness[found.joint_names.index(name)]
        axis.set(xlabel="torque [kN·m]", ylabel="deflection [mrad]")
        axis.set_title(f"{name}: {1e-6 * stiffness:.1f} MN·m/rad", fontsize=9)
    axes[0, 0].legend(frameon=False, fontsize=8)
    return axes


PICTURES: dict[str, Callable[[], Any]] = {
    each.__name__: each
    for each in (
        *(audit, certificate, closed_loop, constraints, effects, estimation, excitation, exports),
        *(fleet, friction, gains, inspection, intervals, law, legged, lines, logs, loops, model),
        *(payload, processing, ready_models, recursive, rollout, sampling, springs),
        *(transmissions, two_encoders),
    )
}


def main(names: list[str]) -> None:
    """Draw the pictures that are named, or all."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    for name in names or PICTURES:
        plots.save_figure(PICTURES[name](), IMAGES / f"{name}.png", dpi=DPI)
        print(name, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
