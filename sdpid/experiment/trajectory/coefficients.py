"""The numbers that make a curve as entries of a file, written and read without loss."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ExportError
from sdpid.experiment.trajectory.curve import Curve
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.experiment.trajectory.sampled import SampledCurve
from sdpid.experiment.trajectory.spline import Spline

_SERIES = ("harmonics", "amplitudes", "phases")
_SAMPLES = ("position", "velocity", "acceleration")


def entries(curve: Curve) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the entries of the whole curve, and those of each joint.

    Raises
    ------
    ExportError
        When the curve is of another kind than those of this folder.
    """
    if isinstance(curve, Spline):
        whole = {"period": curve.duration, "degree": curve.degree}
        return whole, [{"control_points": points.tolist()} for points in curve.control_points.T]
    joints: list[dict[str, Any]] = []
    if isinstance(curve, FourierSeries):
        for j, center in enumerate(curve.center):
            rows = {key: np.asarray(getattr(curve, key))[j].tolist() for key in _SERIES}
            joints.append({"center": float(center), **rows})
        return {"period": curve.period}, joints
    if isinstance(curve, SampledCurve):
        given = {key: getattr(curve, key) for key in _SAMPLES if getattr(curve, key) is not None}
        joints = [{key: given[key][:, j].tolist() for key in given} for j in range(curve.n)]
        return {"time": curve.time.tolist()}, joints
    raise ExportError(f"trajectory: a curve of type {type(curve).__name__} cannot be written.")


def curve_of(table: Mapping[str, Any]) -> Curve:
    """Return the curve of a file's table, whose joints are its list ``joint``."""
    joints = table["joint"]

    def rows(key: str) -> Array:
        return np.array([joint[key] for joint in joints])

    if joints and "control_points" in joints[0]:
        points = rows("control_points").T
        return Spline(duration=table["period"], control_points=points, degree=table["degree"])
    if joints and "position" in joints[0]:
        given = {key: rows(key).T for key in _SAMPLES if key in joints[0]}
        return SampledCurve(time=table["time"], **given)
    return FourierSeries(
        period=table["period"], center=rows("center"), **{key: rows(key) for key in _SERIES}
    )
