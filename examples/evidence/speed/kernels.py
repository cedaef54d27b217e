"""The regressor, whitening and compression, against what they cannot be faster than.

Of a regressor in new memory every page is cleared by the system before it is written; `out` is
memory used before. The bandwidth is that of filling memory used before with a number. Samples of a
quadruped with four feet that are down for 60 % of the time are compressed beside the same states
without contacts, and those of the legs alone on a base that is fixed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from harness import Bench, ratio

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import compress, whitened_chunks
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model import regressor_kernel as kernels
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.jacobians import contact_jacobians

ARM, HUMANOID = "denso_vp6242", "talos_reduced"

# Samples; a hundred thousand of a humanoid would be 8 GB.
COUNTS = ((ARM, 1_000), (ARM, 100_000), (HUMANOID, 1_000), (HUMANOID, 10_000))
FEW = ((ARM, 100), (HUMANOID, 100))

# Bytes of the memory whose filling measures the bandwidth: no second-level cache holds it.
FILLED = 1 << 27

# Samples that are compressed.
COMPRESSED = 50_000

FRICTION = ("coulomb", "viscous")


def regressor(bench: Bench) -> Iterator[tuple[object, ...]]:
    """Measure a sample of the regressor against Pinocchio's warm loop and against its bytes."""
    target = np.ones(FILLED // 8)
    for name, count in bench.size(COUNTS, FEW):
        robot = sdpid.load_robot(name)
        rng = np.random.default_rng(0)
        states = list(rng.uniform(-1.0, 1.0, (3, count, robot.n)))
        model, q = robot.pin_model, robot.configuration(states[0])
        out = np.ones((count, robot.n, 10 * robot.n_links))

        def bare(model: Any = model, rows: tuple[Array, ...] = (q, states[1], states[2])) -> None:
            data, compute = model.createData(), pin.computeJointTorqueRegressor
            for state in zip(*rows, strict=True):
                compute(model, data, *state)

        def new(robot: Any = robot, states: list[Array] = states, out: Any = None) -> None:
            robot.regressor(*states, out=out)

        used = partial(new, out=out)

        def single(action: Any = used) -> None:
            before, kernels.threads = kernels.threads, lambda: 1
            try:
                action()
            finally:
                kernels.threads = before

        found = bench.seconds(
            new=new, used=used, single=single, bare=bare, fill=lambda: target.fill(0.5)
        )
        each = {name: seconds / count for name, seconds in found.items()}
        what = f"regressor, {robot.n} axes, {count} samples"
        for how, action in (("", "new"), (", out=", "used"), (", out=, one thread", "single")):
            yield ratio(what + how, each[action], "Pinocchio's warm loop", each["bare"])
        written = found["fill"] * out[0].nbytes / FILLED
        yield ratio(what + how, each["single"], "its bytes / bandwidth", written)


def problem_rows(count: int) -> tuple[RowSource, Array]:
    """Return rows of a motion of many harmonics of the arm, and a covariance."""
    robot = sdpid.load_robot(ARM)
    rng = np.random.default_rng(0)
    time = np.linspace(0.0, 60.0, count)[:, None]
    q, v, a = (np.zeros((count, robot.n)) for _ in range(3))
    for _ in range(8):
        w, size = rng.uniform(0.3, 6.0, robot.n), rng.uniform(0.05, 0.3, robot.n)
        phase = w * time + rng.uniform(0.0, 2.0 * np.pi, robot.n)
        q += size * np.sin(phase)
        v += size * w * np.cos(phase)
        a -= size * w**2 * np.sin(phase)
    friction = FrictionModel.from_terms(FRICTION, robot.joint_names)
    theta = rng.standard_normal(10 * robot.n_links + len(friction.parameters))
    root = rng.standard_normal((robot.n, robot.n))
    sigma = np.asarray(root @ root.T + np.eye(robot.n))
    effort = robot.regressor(q, v, a) @ theta[: 10 * robot.n_links]
    effort += friction.columns(v, a) @ theta[10 * robot.n_links :]
    effort += 0.1 * rng.standard_normal((count, robot.n)) @ np.linalg.cholesky(sigma).T
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort, covariance=sigma)
    return RowSource(robot, friction, structural_base(robot, friction), samples), sigma


def compression(bench: Bench) -> Iterator[tuple[object, ...]]:
    """Measure a sample of each step from samples to the triangle."""
    count = bench.size(COMPRESSED, 1_000)
    rows, sigma = problem_rows(count)
    columns = rows.base.count + 1
    blocks = [x.reshape(-1, columns).copy() for _, x, _ in whitened_chunks(rows, sigma)]

    def fold() -> None:
        triangle = Triangle(columns)
        for block in blocks:
            triangle.add(block)
        assert len(triangle.R) == columns

    def multiply() -> None:
        for block in blocks:
            block.T @ block

    def factorize() -> None:
        R = np.zeros((0, columns))
        for block in blocks:
            R = np.linalg.qr(np.vstack([R, block]), mode="r")

    found = bench.seconds(
        multiply=multiply,
        fold=fold,
        factorize=factorize,
        compress=lambda: compress(rows, sigma),
    )
    each = {name: seconds / count for name, seconds in found.items()}
    for what, action, against, reference in (
        ("Triangle.add", "fold", "X^T·X of its rows", "multiply"),
        ("compress", "compress", "numpy QR of its rows, in chunks", "factorize"),
    ):
        yield ratio(f"{what}, per sample", each[action], against, each[reference])


def measure(bench: Bench) -> Iterator[tuple[object, ...]]:
    """Measure everything here."""
    yield from regressor(bench)
    yield from compression(bench)


# Samples of the quadruped: so many different ones, again and again.
DIFFERENT, TIMES = 400, 25


def contacts(bench: Bench) -> Iterator[tuple[object, ...]]:
    """Measure a sample of compression with feet on the ground, and of the Jacobians."""
    from tests.helpers.legged import FEET, NOISE, RADIUS, gait, quadruped

    def source(robot: sdpid.RobotModel, samples: sdpid.Samples) -> RowSource:
        friction = FrictionModel.from_terms(FRICTION, robot.joint_names, first=robot.n_base)
        return RowSource(robot, friction, structural_base(robot, friction), samples)

    again = [gait(DIFFERENT).samples] * bench.size(TIMES, 1)
    samples = replace(sdpid.Samples.join(again), starts=(0,))
    names, first = ("position", "velocity", "acceleration", "effort"), (7, 6, 6, 6)
    legs = sdpid.Samples(
        **{name: getattr(samples, name)[:, k:] for name, k in zip(names, first, strict=True)}
    )
    sigma = np.diag(NOISE**2)
    touching = source(quadruped(), samples)
    flying = source(quadruped(), replace(samples, contacts=None))
    held = source(sdpid.load_robot("solo12"), legs)
    found = bench.seconds(
        contacts=lambda: compress(touching, sigma),
        alone=lambda: compress(flying, sigma),
        plain=lambda: compress(held, sigma[6:, 6:]),
        jacobians=lambda: contact_jacobians(quadruped(), samples.position, FEET, RADIUS),
    )
    each = {name: seconds / samples.n_samples for name, seconds in found.items()}
    for what, own, against, reference in (
        ("compress, 4 feet, per sample", "contacts", "its base fixed", "plain"),
        ("compress, 4 feet, per sample", "contacts", "no contacts", "alone"),
        ("contact_jacobians, 4 feet, per sample", "jacobians", "compress, 4 feet", "contacts"),
    ):
        yield ratio(what, each[own], against, each[reference])
