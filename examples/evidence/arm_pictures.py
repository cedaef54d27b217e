"""Pictures of the real arms: mass matrices on the motion, and arms that are let go of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from arms import METHODS, MODELS, Arm, Fall, skeleton
from matplotlib.figure import Figure

from sdpid import plots

# Okabe and Ito's colors, which readers with any color vision can tell apart.
COLORS = {
    "URDF as it is": "#9CA3AF",
    "URDF, friction fitted": "#6B7280",
    "least squares": "#D55E00",
    "ridge, our prior": "#CC79A7",
    "ridge, cross-validated": "#E69F00",
    "this package": "#0072B2",
}

# Below this the axis of eigenvalues is linear, kg·m².
LINEAR = 1e-4

# Frames of the animation, s: closer at first, when what is no robot diverges.
SLOW, SLOW_STEP, FAST_STEP = 0.3, 0.01, 0.02
FRAME_MS, LAST_MS = 90, 2500


def summary(arms: Sequence[Arm], falls: Mapping[tuple[str, str], Fall], path: Path) -> None:
    """Draw, arm beside arm, eigenvalues on the motion and the fastest joint after the release."""
    figure = Figure(figsize=(2.9 * len(arms) + 0.6, 6.0), layout="constrained", facecolor="white")
    axes = figure.subplots(2, len(arms), squeeze=False, sharey="row")
    for arm, (upper, lower) in zip(arms, axes.T, strict=True):
        upper.set_title(arm.name, loc="left", fontsize=11, fontweight="bold")
        upper.set_yscale("symlog", linthresh=LINEAR, linscale=0.4)
        upper.axhspan(-10.0, 0.0, color="#FBE9E0", zorder=0)
        upper.axhline(0.0, color="black", linewidth=0.8)
        for method, values in arm.eigenvalues.items():
            upper.plot(arm.time, values, color=COLORS[method], linewidth=1.3, label=method)
        if arm.proven is not None:
            bound = {"color": COLORS["this package"], "linewidth": 1.0, "linestyle": ":"}
            upper.axhline(arm.proven, **bound, label="proven for every posture")
        upper.set(ylim=(-10.0, 0.3), xlabel="time on the recorded motion, s")
        lower.set(yscale="log", ylim=(0.1, 1000.0), xlabel="time after the release, s")
        for method in METHODS:
            color, fall = COLORS[method], falls[arm.name, method]
            time, speed = fall.time, fall.speed
            if fall.diverged is not None:
                lower.plot(fall.diverged, 930.0, "X", color=color, markersize=8, zorder=4)
                time, speed = np.append(time, fall.diverged), np.append(speed, 1000.0)
            lower.plot(time, np.maximum(speed, 1e-3), color=color, linewidth=1.3)
    axes[0, 0].set_ylabel("least eigenvalue of M(q), kg·m²")
    axes[1, 0].set_ylabel("speed of the fastest joint, rad/s")
    for axis in axes.flat:
        axis.grid(visible=True, color="#E5E7EB", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    plots.save_figure(figure, path)


def bars(arms: Sequence[Arm], path: Path) -> None:
    """Draw the effort that four models miss where it was not fitted, and which is no robot."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained", facecolor="white")
    axis = figure.subplots()
    width = 0.8 / len(MODELS)
    places = np.arange(len(arms))
    for k, name in enumerate(MODELS):
        heights = [100.0 * arm.missed[name] for arm in arms]
        at = places + (k - 0.5 * (len(MODELS) - 1)) * width
        drawn = axis.bar(at, heights, 0.94 * width, color=COLORS[name], label=name)
        labels = [f"{each:.0f}" if each >= 10.0 else f"{each:.1f}" for each in heights]
        if name == "least squares":
            labels = [_no_robot(arm) + label for arm, label in zip(arms, labels, strict=True)]
        dark = "#B34700" if name == "least squares" else "black"
        axis.bar_label(drawn, labels, fontsize=8, padding=1, color=dark)
    axis.set_yscale("log")
    axis.set_ylim(1.0, 4.0 * axis.get_ylim()[1])
    axis.set_ylabel("missed effort, not fitted, %")
    axis.set_xticks(places, [arm.name for arm in arms], fontsize=10)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(loc="upper center", ncols=len(MODELS), frameon=False, fontsize=9)
    plots.save_figure(figure, path)


def _no_robot(arm: Arm) -> str:
    """Return what to write over least squares whose mass matrix is indefinite all along."""
    return "no\nrobot\n" if arm.eigenvalues["least squares"].max() < 0.0 else ""


def animation(
    arms: Sequence[Arm],
    falls: Mapping[tuple[str, str], Fall],
    path: Path,
    methods: Sequence[str] = ("least squares", "ridge, cross-validated", "this package"),
) -> None:
    """Write the released arms as an animated picture: a row a method, a column an arm."""
    from PIL import Image

    duration = max(fall.time[-1] for fall in falls.values())
    slow = np.arange(0.0, SLOW, SLOW_STEP)
    instants = np.concatenate([slow, np.arange(SLOW, duration + 1e-9, FAST_STEP)])
    figure = Figure(figsize=(1.55 * len(arms) + 0.9, 1.55 * len(methods) + 0.5), facecolor="white")
    axes = figure.subplots(len(methods), len(arms), squeeze=False)
    figure.subplots_adjust(0.1, 0.01, 0.99, 0.88, 0.03, 0.03)
    clock = figure.text(0.99, 0.985, "", ha="right", va="top", fontsize=9, family="monospace")
    figure.text(0.01, 0.985, "Let go of at rest: gravity and friction alone", va="top", fontsize=9)
    drawn = []
    for j, arm in enumerate(arms):
        shapes = {
            method: _flat(skeleton(arm.result.problem.robot, falls[arm.name, method].position))
            for method in methods
        }
        reach = 1.15 * float(np.abs(shapes[methods[-1]]).max())
        for i, method in enumerate(methods):
            axis = axes[i, j]
            axis.set(xlim=(-reach, reach), ylim=(-reach, reach), xticks=[], yticks=[])
            axis.set_aspect("equal")
            for spine in axis.spines.values():
                spine.set_color("#D1D5DB")
            if i == 0:
                axis.set_title(arm.name, fontsize=10)
            if j == 0:
                axis.set_ylabel(method.replace(", ", ",\n"), fontsize=8, color=COLORS[method])
            line = axis.plot([], [], "o-", color=COLORS[method], linewidth=2.5, markersize=3.5)[0]
            place = (0.5, 0.04)
            text = axis.text(*place, "", transform=axis.transAxes, ha="center", fontsize=8)
            drawn.append((line, text, shapes[method], falls[arm.name, method]))
    frames = []
    for instant in instants:
        clock.set_text(f"{instant:4.2f} s" + ("  slow" if instant < SLOW else "      "))
        for line, text, shape, fall in drawn:
            line.set_data(*shape[min(np.searchsorted(fall.time, instant), len(shape) - 1)].T)
            if fall.diverged is not None and instant >= fall.diverged:
                line.set_alpha(0.25)
                text.set_text(f"diverged at {fall.diverged:.2f} s")
        frames.append(_pixels(figure))
    images = [Image.fromarray(frame).quantize(48, dither=Image.Dither.NONE) for frame in frames]
    durations = [FRAME_MS] * (len(images) - 1) + [LAST_MS]
    images[0].save(path, save_all=True, append_images=images[1:], duration=durations, loop=0)


def _flat(shapes: np.ndarray) -> np.ndarray:
    """Return shapes (K, points, 3) as seen from the side, (K, points, 2)."""
    return np.stack([shapes @ np.array([0.8, 0.6, 0.0]), shapes[..., 2]], axis=-1)


def _pixels(figure: Any) -> np.ndarray:
    """Return a figure as pixels (height, width, 3)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
