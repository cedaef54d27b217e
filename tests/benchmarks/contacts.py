"""From samples of a quadruped in contact to the compressed cost, against robots without contacts.

    python -m tests.benchmarks.contacts [--repeat 5]

The same states are compressed with four feet that are down for 60 % of the time, without contacts,
and as those of the legs alone on a base that is fixed: leg by leg, and as all one chain.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdpid.estimation.compression.branches import NO_BRANCHES
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import compress
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.benchmarks.timing import Row, print_table, side_by_side
from tests.helpers.legged import FEET, NOISE, RADIUS, gait, quadruped

# Samples that are compressed: so many different ones, again and again.
DIFFERENT, TIMES = 400, 25

FRICTION = ("coulomb", "viscous")


def source(robot: RobotModel, samples: Samples) -> RowSource:
    """Return the rows of a robot."""
    friction = FrictionModel.from_terms(FRICTION, robot.joint_names, first=robot.n_base)
    return RowSource(robot, friction, structural_base(robot, friction), samples)


def measure(repeats: int) -> Iterator[Row]:
    """Measure a sample of compression and of the Jacobians."""
    samples = replace(Samples.join([gait(DIFFERENT).samples] * TIMES), starts=(0,))
    fixed = load_robot("solo12")
    legs = Samples(
        position=samples.position[:, 7:],
        velocity=samples.velocity[:, 6:],
        acceleration=samples.acceleration[:, 6:],
        effort=samples.effort[:, 6:],
    )
    sigma, count = np.diag(NOISE**2), samples.n_samples
    touching = source(quadruped(), samples)
    flying = source(quadruped(), replace(samples, contacts=None))
    held = source(fixed, legs)
    chain = source(fixed, legs)
    # As a chain without branches is compressed.
    chain.__dict__["branches"] = NO_BRANCHES
    contacts, alone, plain, single, jacobians = (
        side_by_side(
            (
                lambda: compress(touching, sigma),
                lambda: compress(flying, sigma),
                lambda: compress(held, sigma[6:, 6:]),
                lambda: compress(chain, sigma[6:, 6:]),
                lambda: contact_jacobians(quadruped(), samples.position, FEET, RADIUS),
            ),
            repeats,
        )
        / count
    )
    yield Row.of("compress, 4 feet, per sample", contacts, "its base fixed, one chain", single)
    yield Row.of("compress, 4 feet, per sample", contacts, "its base fixed, leg by leg", plain)
    yield Row.of("compress, 4 feet, per sample", contacts, "no contacts", alone)
    yield Row.of("contact_jacobians, 4 feet, per sample", jacobians, "compress, 4 feet", contacts)


if __name__ == "__main__":
    sys.exit(print_table("tests.benchmarks.contacts", measure))
