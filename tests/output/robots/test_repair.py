"""Repaired descriptions: nearest, nothing else changed, and every loader takes them."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid.assurance.descriptions.nearest_body import (
    NEAREST,
    moment_floor,
    prove_nearest,
)
from sdpid.errors import CertificateError, ExportError
from sdpid.output.robots.repair import TOKEN_MASS, repair_urdf
from sdpid.robot.consistent import raise_eigenvalues
from sdpid.robot.description.bodies import read_urdf_bodies
from sdpid.robot.inertia import second_moment_from_inertia
from tests.helpers.descriptions import box, chain, diagonal, inertial, inertial_of
from tests.helpers.refusals import refuses
from tests.helpers.strategies import SEEDS, bodies, reals

GOOD = diagonal(1.0, 0.01, 0.01, 0.012)
BAD = diagonal(1.0, 0.01, 0.01, 0.03)


@st.composite
def wrong(draw: st.DrawFn) -> tuple[float, np.ndarray]:
    """A mass, and a symmetric tensor of any signature whose second moments are not positive."""
    rng = np.random.default_rng(draw(SEEDS))
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    values = rng.uniform(-1.0, 1.0, 3) * 10.0 ** rng.uniform(-6.0, 0.0)
    values[0] = -abs(values[0])
    tensor = Q @ (values.sum() * np.eye(3) - np.diag(values)) @ Q.T
    return draw(reals(0.01, 10.0)), 0.5 * (tensor + tensor.T)


def load_everywhere(text: str) -> Any:
    """Load with Pinocchio and with MuJoCo, without geometry."""
    import pinocchio as pin

    mujoco = pytest.importorskip("mujoco")
    mujoco.MjModel.from_xml_string(text)
    return pin.buildModelFromXML(text)


def tensors(text: str) -> dict[str, np.ndarray]:
    _, described = read_urdf_bodies(text, "test")
    return {body.name: body.tensor for body in described if body.tensor is not None}


@given(wrong())
def test_repaired_is_nearest_loads_and_stays(case: tuple[float, np.ndarray]) -> None:
    mass, tensor = case
    com = np.array([0.1, -0.02, 0.3])
    text = chain(GOOD, inertial(mass, com, tensor, rpy="0.3 -1 0.2"), GOOD)
    assert not sdpid.audit_urdf(text).passed
    report = repair_urdf(text)
    (body,) = report.bodies
    assert body.link == "link2"
    assert body.mass == body.new_mass == mass
    # Weyl: nothing that is positive can be nearer than the most negative eigenvalues.
    P = second_moment_from_inertia(tensor)
    negative = np.minimum(np.linalg.eigvalsh(P), 0.0)
    assert body.proof.distance >= np.linalg.norm(negative) * (1.0 - 1e-9)
    assert body.proof.lower_bound <= body.proof.distance
    assert body.proof.distance <= (1.0 + NEAREST) * body.proof.lower_bound
    found = tensors(report.text)["link2"]
    moved = np.linalg.norm(second_moment_from_inertia(found) - P)
    assert moved == pytest.approx(body.proof.distance, rel=1e-9)
    assert sdpid.audit_urdf(report.text).passed
    again = repair_urdf(report.text)
    assert again.text == report.text
    assert not again.bodies
    load_everywhere(report.text)


@settings(max_examples=6)
@given(wrong())
def test_closed_form_is_what_a_solver_finds(case: tuple[float, np.ndarray]) -> None:
    import cvxpy as cp

    mass, tensor = case
    P = second_moment_from_inertia(tensor)
    size = float(np.abs(P).max())
    floor = moment_floor(P, mass) / size
    X = cp.Variable((3, 3), symmetric=True)
    # The norm itself, not its square: its value is then as exact as the solver is.
    problem = cp.Problem(cp.Minimize(cp.norm(X - P / size, "fro")), [X >> floor * np.eye(3)])
    problem.solve(solver=cp.CLARABEL)
    closed = raise_eigenvalues(P / size, floor)
    assert np.linalg.norm(closed - P / size) == pytest.approx(problem.value, rel=1e-6, abs=1e-7)
    assert np.allclose(closed, X.value, atol=1e-3)


@given(st.lists(bodies(), min_size=1, max_size=3))
def test_consistent_descriptions_keep_every_byte(several: list[np.ndarray]) -> None:
    text = chain(*(inertial_of(body) for body in several))
    report = repair_urdf(text)
    assert report.text == text
    assert not report.bodies


def test_only_the_numbers_change(tmp_path: Path) -> None:
    text = chain(GOOD + box(0.2), BAD + box(0.3, "visual"), GOOD).replace("\n", "\r\n")
    text = "\ufeff" + text.replace("</robot>", "<!-- kept --><gazebo a='1'  b=\"2\" /></robot>")
    source, target = tmp_path / "in.urdf", tmp_path / "out.urdf"
    source.write_bytes(text.encode("utf-8"))
    report = repair_urdf(source, target=target)
    written = target.read_bytes().decode("utf-8")
    assert written == report.text
    before, after = text.split('"'), written.split('"')
    changed = [k for k, (a, b) in enumerate(zip(before, after, strict=True)) if a != b]
    # Second moments 0.015, 0.015, -0.005: the last is raised to the floor, which leaves izz.
    assert [before[k - 1].split()[-1] for k in changed] == ["ixx=", "iyy="]
    assert "link2 (impossible)" in report.describe()
    assert report.to_dict()["path"] == str(target)


def test_edges_and_points_and_nothing() -> None:
    text = chain(
        diagonal(1.0, 0.0, 0.1, 0.1),
        diagonal(2.0, 0.0, 0.0, 0.0),
        "",
        diagonal(0.0, 0.0, 0.0, 0.0),
        diagonal(0.0, 0.01, 0.01, 0.01),
        GOOD,
        diagonal(0.1, 0.0, 0.0, 0.0),
        joints=("continuous",) * 6 + ("fixed",),
    )
    report = repair_urdf(text)
    reasons = ["no thickness", "point", "no mass", "no mass", "no mass"]
    assert [body.reason for body in report.bodies] == reasons
    assert [body.new_mass for body in report.bodies] == [1.0, 2.0, *[TOKEN_MASS] * 3]
    model = load_everywhere(report.text)
    # What had inertia without mass keeps the inertia.
    assert np.allclose(model.inertias[5].inertia, 0.01 * np.eye(3), rtol=1e-6)
    assert sdpid.audit_urdf(report.text).passed
    assert repair_urdf(report.text).text == report.text


def test_what_cannot_be_known_is_left() -> None:
    text = chain(BAD, diagonal(-1.0, 0.01, 0.01, 0.01), GOOD.replace('ixx="0.01"', 'ixx="?"'))
    report = repair_urdf(text)
    assert report.left == ("link2", "link3")
    assert [body.link for body in report.bodies] == ["link1"]
    assert "link2" in report.describe()


def test_mjcf_is_refused() -> None:
    refuses(ExportError, "MJCF", repair_urdf, "<mujoco/>")


def exact(matrix: np.ndarray) -> list[list[Fraction]]:
    return [[Fraction(float(x)) for x in row] for row in matrix]


def test_proofs_refuse_what_is_not_nearest() -> None:
    P, floor = np.diag([-1.0, 2.0, 3.0]), Fraction(1, 1000)
    right = np.diag([1.1e-3, 2.0, 3.0])
    assert prove_nearest(exact(P), exact(np.diag([1.0000001e-3, 2.0, 3.0])), floor).distance > 1.0
    refuses(CertificateError, "proven", prove_nearest, exact(P), exact(right), floor)
    with pytest.raises(CertificateError, match="below"):
        prove_nearest(exact(P), exact(np.diag([0.9e-3, 2.0, 3.0])), floor)
    with pytest.raises(CertificateError, match="proven"):
        prove_nearest(exact(P), exact(right + 1e-3 * (np.ones((3, 3)) - np.eye(3))), floor)


def test_a_robot_of_others() -> None:
    from sdpid.robot.description.catalog import find_robot

    path = find_robot("finger_edu_description/finger_edu")
    report = repair_urdf(path)
    assert [body.link for body in report.bodies] == ["finger_lower_link"]
