"""A plan draws its motion against its limits."""

import numpy as np
import pytest

from tests.helpers.plans import small_plan

pytest.importorskip("matplotlib")


def test_a_plan_is_drawn_against_its_limits() -> None:
    plan = small_plan()
    axes = plan.plot()
    assert axes.shape == (5, plan.robot.n)
    assert [axis.get_title(loc="left") for axis in axes[0]] == list(plan.robot.joint_names)
    assert [axis.get_ylabel() for axis in axes[:, 0]] == ["rad", "rad/s", "rad/s²", "rad/s³", "N·m"]
    for j in range(plan.robot.n):
        motion, *limits = axes[2, j].get_lines()
        most = plan.joint_limits.acceleration[j]
        assert np.abs(motion.get_ydata()).max() <= most * (1.0 + 1e-9)
        assert sorted(line.get_ydata()[0] for line in limits) == pytest.approx([-most, most])
