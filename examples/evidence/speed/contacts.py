"""From samples of a quadruped in contact to the compressed cost, against robots without contacts.

The same states are compressed with four feet that are down for 60 % of the time, without contacts,
and as those of the legs alone on a base that is fixed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from harness import Bench, Row

from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import compress
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.jacobians import contact_jacobians
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.legged import FEET, NOISE, RADIUS, gait, quadruped

# Samples that are compressed: so many different ones, again and again.
DIFFERENT, TIMES = 400, 25

FRICTION = ("coulomb", "viscous")


def source(robot: RobotModel, samples: Samples) -> RowSource:
    """Return the rows of a robot."""
    friction = FrictionModel.from_terms(FRICTION, robot.joint_names, first=robot.n_base)
    return RowSource(robot, friction, structural_base(robot, friction), samples)


def measure(bench: Bench) -> Iterator[Row]:
    """Measure a sample of compression and of the Jacobians."""
    again = [gait(DIFFERENT).samples] * bench.size(TIMES, 1)
    samples = replace(Samples.join(again), starts=(0,))
    fixed = load_robot("solo12")
    legs = Samples(
        position=samples.position[:, 7:],
        velocity=samples.velocity[:, 6:],
        acceleration=samples.acceleration[:, 6:],
        effort=samples.effort[:, 6:],
    )
    sigma = np.diag(NOISE**2)
    touching = source(quadruped(), samples)
    flying = source(quadruped(), replace(samples, contacts=None))
    held = source(fixed, legs)
    found = bench.seconds(
        contacts=lambda: compress(touching, sigma),
        alone=lambda: compress(flying, sigma),
        plain=lambda: compress(held, sigma[6:, 6:]),
        jacobians=lambda: contact_jacobians(quadruped(), samples.position, FEET, RADIUS),
    )
    each = {name: seconds / samples.n_samples for name, seconds in found.items()}
    for against, reference in (
        ("its base fixed", "plain"),
        ("no contacts", "alone"),
    ):
        yield Row.of("compress, 4 feet, per sample", each["contacts"], against, each[reference])
    what = "contact_jacobians, 4 feet, per sample"
    yield Row.of(what, each["jacobians"], "compress, 4 feet", each["contacts"])
