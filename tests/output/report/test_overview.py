"""The figure of all joints of a result."""

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from sdpid.errors import DataError
from tests.helpers.identified import arm_theta, identified, moved
from tests.helpers.refusals import refuses


def test_every_joint_has_effort_error_and_friction() -> None:
    theta = arm_theta()
    result = identified(moved(theta, 1), moved(theta, 2))
    axes = result.plot(title="all joints")
    assert axes.shape == (2, 3)
    names = result.problem.robot.joint_names
    assert [row[0].get_title(loc="left") for row in axes] == list(names)
    for row in axes:
        assert [line.get_label() for line in row[0].get_lines()] == ["measured", "predicted"]
        assert row[1].get_ylabel() == "error [N·m]"
        assert row[2].get_xlabel() == "velocity [rad/s]"
    # What was held out, not what was fitted.
    drawn = axes[0, 0].get_lines()[0].get_ydata()
    assert set(np.round(drawn, 9)) <= set(np.round(result.validation_samples.effort[:, 0], 9))
    # A notebook shows axes as their figure, but for a figure that belongs to others.
    assert axes._repr_png_().startswith(b"\x89PNG")
    assert not hasattr(result.plot(axes=np.array(axes)), "_repr_png_")
    refuses(DataError, "2 axes were given to draw in, 6 are needed", result.plot, axes=axes[0, :2])
