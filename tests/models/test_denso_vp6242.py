"""The bundled Denso: its files agree with each other, and its plant is a real robot."""

import csv
import importlib.util
from typing import Any

import numpy as np
import pytest

from sdpid._common.files import load_toml
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.description.dh_table import DhTable
from sdpid.robot.inertia import margin

FOLDER = bundled_folder("denso_vp6242")


def test_limit_frequencies_are_those_of_the_amplitudes() -> None:
    for axis in load_toml(FOLDER / "excitation.toml")["axis"]:
        low, high = axis["range_deg"]
        assert axis["amplitude_deg"] == (high - low) / 2
        limit = axis["velocity_deg_s"] / (2 * np.pi * axis["amplitude_deg"])
        assert axis["limit_hz"] == pytest.approx(limit, abs=1e-4)


def test_kinematics_repeat_the_ranges_and_lengths() -> None:
    data = load_toml(FOLDER / "kinematics.toml")
    axes = load_toml(FOLDER / "excitation.toml")["axis"]
    for joint, axis in zip(data["joint"], axes, strict=True):
        assert joint["name"] == axis["name"]
        limits = joint["lower"], joint["upper"]
        np.testing.assert_allclose(limits, np.radians(axis["range_deg"]), rtol=1e-15)
        assert joint["velocity"] == pytest.approx(np.radians(axis["velocity_deg_s"]), rel=1e-15)
    lengths, rows = data["lengths"], data["joint"]
    assert rows[2]["d"] == lengths["l2"]
    assert rows[3]["d"] == -lengths["l3x"]
    assert rows[3]["r"] == lengths["l3z_plus_l4"]
    assert rows[5]["r"] == lengths["l5"]


def test_the_arm_points_up_at_zero() -> None:
    table = DhTable.from_toml(FOLDER / "kinematics.toml")
    flange = table.forward_kinematics(np.zeros(6))[-1]
    np.testing.assert_allclose(flange[:3, 3], [-0.075, 0.0, 0.280 + 0.210 + 0.210 + 0.070])
    np.testing.assert_allclose(flange[:3, 2], [0.0, 0.0, 1.0], atol=1e-15)


def test_tables_iv_and_v() -> None:
    with (FOLDER / "table_iv.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 48
    assert rows[0] == {
        "parameter": "zzr1",
        "unit": "kg.m2",
        "cwls": "7.10",
        "wls": "9.05",
        "sigma": "3.64e-2",
    }
    with (FOLDER / "table_v.csv").open() as file:
        masses = [float(row["mass_kg"]) for row in csv.DictReader(file)]
    assert masses == [6.22, 2.07, 17.99, 20.95, 1.93, 38.45]


def test_true_parameters_are_real() -> None:
    theta = true_parameters("denso_vp6242")
    links = theta[:60].reshape(6, 10)
    # The script's margin of 0.005 kg·m² less its slack.
    assert margin(links, "pseudo_inertia").min() > 0.00499
    assert links[:, 0].min() > 0.5
    assert links[:, 0].max() < 40.01
    assert theta[60:].min() > 0.0


def script() -> Any:
    spec = importlib.util.spec_from_file_location("make", FOLDER / "make_true_parameters.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_true_parameters_are_what_the_script_makes() -> None:
    base, theta = script().true_parameters()
    with (FOLDER / "true_parameters.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(row["parameter"] for row in rows) == base.theta_names
    assert tuple(row["unit"] for row in rows) == base.theta_units
    kept = np.array([float(row["value"]) for row in rows])
    # Interior-point results of another machine or solver version agree to about their tolerance.
    np.testing.assert_allclose(base.matrix @ kept, base.matrix @ theta, atol=1e-4)
    np.testing.assert_allclose(kept, theta, atol=1e-2)
