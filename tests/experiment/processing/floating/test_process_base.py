"""Recordings with a base: their states against those of the motion, and the equation of motion."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.preparation.for_robot import prepare
from sdpid.experiment.preparation.joined_contacts import join_samples
from sdpid.experiment.preparation.several import prepare_recordings
from sdpid.experiment.processing.choose import choose_processing
from sdpid.experiment.processing.filters import low_pass
from sdpid.experiment.processing.floating.rotations import body_rate, unit
from tests.experiment.processing.floating.crawl import FEET, RADIUS, Crawl, crawl

SETTINGS = {"cutoff_hz": 25.0, "order": 2, "decimation": 10, "reversal_time": None}


def rows(samples: sdpid.Samples, walk: Crawl) -> Array:
    return np.round(np.asarray(samples.time) / (walk.time[1] - walk.time[0])).astype(int)


@pytest.mark.parametrize("kind", ["imu", "twist", "own_twist", "pose"])
def test_every_source_gives_the_motion_of_the_base(kind: str) -> None:
    walk = crawl()
    samples = sdpid.process(walk.log(kind), SETTINGS)
    at = rows(samples, walk)
    assert (samples.position.shape[1], samples.velocity.shape[1]) == (19, 18)
    assert not samples.velocity[:, :3].any()
    assert not samples.effort[:, :6].any()
    # What the filter takes from motion of 1 to 2 Hz.
    assert np.abs(samples.velocity[:, 3:6] - walk.v[at, 3:6]).max() < 0.02
    assert np.abs(samples.acceleration[:, 3:6] - walk.a[at, 3:6]).max() < 0.2
    classical = walk.a[at, :3] + np.cross(walk.v[at, 3:6], walk.v[at, :3])
    assert np.abs(samples.acceleration[:, :3] - classical).max() < 0.05
    turned = np.abs(np.einsum("ki,ki->k", samples.position[:, 3:7], walk.q[at, 3:7]))
    assert turned.min() > 1.0 - 1e-5


def residuals(walk: Crawl, samples: sdpid.Samples, *, forces: bool, widened: bool = True) -> Array:
    """Return what is left of the equation of motion with the true parameters, by Pinocchio."""
    model = walk.robot.pin_model.copy()
    model.armature[:] = 0.0
    data = model.createData()
    frames = [model.getFrameId(name) for name in FEET]
    contacts = samples.contacts
    assert contacts is not None
    down = contacts.down if widened else walk.down[rows(samples, walk)]
    left = []
    for k in range(samples.n_samples):
        q = samples.position[k]
        error = pin.rnea(model, data, q, samples.velocity[k], samples.acceleration[k])
        error = error - samples.effort[k]
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        J = [pin.getFrameJacobian(model, data, f, pin.LOCAL_WORLD_ALIGNED) for f in frames]
        feet = np.array([each[:3] - pin.skew(RADIUS) @ each[3:] for each in J])
        if forces:
            error = error - np.einsum("cij,ci->j", feet, contacts.forces[k, :, :3])
        else:
            basis = np.linalg.qr(feet[down[k]].reshape(-1, 18).T)[0]
            error = error - basis @ (basis.T @ error)
        left.append(error)
    return np.array(left)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_the_equation_of_motion_holds_between_filtered_channels() -> None:
    walk = crawl()
    samples = sdpid.process(walk.log(), {**SETTINGS, "contact_force_std": 0.0})
    size = rms(walk.effort[:, 6:])
    known = residuals(walk, samples, forces=True)
    # In N, N·m and N·m; of 25 N of weight and 0.63 N·m of effort.
    assert rms(known[:, :3]) < 0.002
    assert rms(known[:, 3:6]) < 0.005
    assert rms(known[:, 6:]) < 0.006 * size
    projected = rms(residuals(walk, samples, forces=False))
    assert projected < 0.003 * size
    # A filter remembers feet that have left the ground.
    assert rms(residuals(walk, samples, forces=False, widened=False)) > 20.0 * projected


def test_wrenches_are_moved_to_the_contact_point() -> None:
    walk = crawl()
    settings = {**SETTINGS, "contact_force_std": 1.0, "contact_moment_std": 0.1}
    plain = sdpid.process(walk.log(), settings).contacts
    moment = np.cross(RADIUS, walk.forces)
    wrenches = np.concatenate([walk.forces, moment], axis=-1)
    moved = sdpid.process(walk.log(forces=None, wrenches=wrenches), settings).contacts
    np.testing.assert_allclose(moved.forces, plain.forces, atol=1e-12)
    told = sdpid.process(walk.log(down=None), settings).contacts
    assert np.mean(told.down == plain.down) > 0.95


def test_what_a_sensor_shows_of_a_foot_in_the_air_is_left_out() -> None:
    walk = crawl()
    processing = sdpid.Processing(filter="finite", contact_force_std=0.2)
    shown = np.where(walk.down[:, :, None], walk.forces, [3.0, -2.0, 5.0])
    plain, offset = (
        prepare(walk.robot, walk.log(forces=each), processing).contacts
        for each in (walk.forces, shown)
    )
    assert np.array_equal(plain.forces, offset.forces)  # type: ignore[arg-type]


def test_a_time_around_landings_is_left_out() -> None:
    walk = crawl()
    samples = sdpid.process(walk.log(), {**SETTINGS, "impact_s": 0.01})
    landing = walk.time[1:][(walk.down[1:] & ~walk.down[:-1]).any(axis=1)]
    distance = np.abs(np.asarray(samples.time)[:, None] - landing).min(axis=1)
    assert samples.used[distance > 0.051].all()
    assert not samples.used[distance < 0.049].any()
    near = float(np.mean(distance < 0.05))
    all_of_them = {**SETTINGS, "impact_s": 0.01, "kept_share": 1.0 - 0.9 * near}
    assert sdpid.process(walk.log(), all_of_them).used.all()
    # Chosen by how many samples would go: of one landing few, of one every 50 ms most.
    once = np.tile(walk.time[:, None] > 0.5 * walk.time[-1], len(FEET))
    often = np.tile(np.sin(2.0 * np.pi * walk.time[:, None] / 0.05) > 0.0, len(FEET))
    for down, chosen in ((once, 0.0), (often, None)):
        found = choose_processing(walk.log(down=down))
        assert found.processing.impact_s == chosen
        assert any("sees a landing" in reason for reason in found.reasons)


def test_recordings_with_other_contacts_are_put_together() -> None:
    walk = crawl()
    log = walk.log()
    held = sdpid.Contacts(frames=["base_link"], kind="plane", down=np.ones((len(walk.time), 1)))
    for settings in ({}, {"contact_force_std": 2.0}):
        processing = sdpid.Processing(filter="finite", **settings)
        logs = [log, replace(log, contacts=held), replace(log, contacts=None)]
        standing, hanging, flying = (prepare(walk.robot, each, processing) for each in logs)
        both = join_samples([standing, hanging, flying]).contacts
        assert both.frames == (*FEET, "base_link")
        K = standing.n_samples
        assert both.down[:, 4].tolist() == [False] * K + [True] * K + [False] * K
        assert not both.down[K:, :4].any()
        assert both.measured == bool(settings)
        if both.force_covariance is not None:
            assert np.isinf(np.diagonal(both.force_covariance[4])).all()
            assert np.isfinite(both.force_covariance[:4]).all()


def test_what_does_not_fit_is_refused() -> None:
    walk = crawl()
    log = walk.log("pose")
    with pytest.raises(DataError, match="'butterworth', whose memory has no end"):
        sdpid.process(log, {"filter": "butterworth"})
    with pytest.raises(DataError, match="'imu', and the recording has no accelerometer"):
        sdpid.process(log, {"base_motion": "imu"})
    with pytest.raises(DataError, match="'twist', and the recording has no angular velocity"):
        sdpid.process(log, {"base_motion": "twist"})
    with pytest.raises(DataError, match="no contact forces"):
        sdpid.process(walk.log(forces=None), {"contact_force_std": 1.0})
    fused = sdpid.Processing(filter="finite", contact_force_std=0.2)
    without = walk.log("pose", forces=None)
    with pytest.raises(
        DataError, match="recording 2 of 2: contact_force_std: the recording has no"
    ):
        prepare_recordings(walk.robot, [log, without], fused)
    # What is predicted needs no forces.
    predicted = prepare_recordings(walk.robot, log, fused).others(without).samples
    assert not predicted.contacts.measured
    with pytest.raises(DataError, match=r"fixed to the ground.*root='free_flyer'"):
        prepare(sdpid.load_robot("solo12"), log)
    with pytest.raises(DataError, match="no motion of the base"):
        prepare(walk.robot, replace(log, base=None, contacts=None))


def test_a_finite_filter_sees_no_farther_than_it_says() -> None:
    for order in (1, 2, 3):
        finite = low_pass("finite", 20.0, order, 1000.0)
        assert finite.reach == 25 * order
        assert finite.gain(20.0, 1000.0)[0] == pytest.approx(0.5, abs=1e-6)
        pulse = np.zeros((301, 2))
        pulse[150] = 1.0
        seen = finite.apply(pulse)
        assert not seen[: 150 - finite.reach].any()
        np.testing.assert_allclose(seen.sum(axis=0), 1.0)
        np.testing.assert_allclose(seen, seen[::-1])


def test_angular_velocities_are_those_of_pinocchio() -> None:
    rng = np.random.default_rng(1)
    axis, step = rng.normal(size=3), 0.01
    turns = [pin.exp3(axis * t) @ pin.exp3(np.array([0.3, -0.5, 2.0])) for t in step * np.arange(9)]
    quaternions = unit(np.array([pin.Quaternion(R).coeffs() for R in turns]))
    expected = [R.T @ axis for R in turns]
    weights = np.array([1 / 12, -2 / 3, 0.0, 2 / 3, -1 / 12])
    np.testing.assert_allclose(
        body_rate(quaternions, weights, step)[2:-2], expected[2:-2], rtol=1e-9
    )
    np.testing.assert_allclose(
        body_rate(quaternions * [[-1.0] if k % 2 else [1.0] for k in range(9)], weights, step)[
            2:-2
        ],
        expected[2:-2],
        rtol=1e-9,
    )


@pytest.mark.parametrize("frame", ["twist", "own_twist"])
@pytest.mark.parametrize(
    ("pose", "velocity"), [(3e-5, 3e-2), (3e-4, 1e-3), (1e-6, 1e-2), (1e-3, 1e-2)]
)
def test_accelerations_come_from_what_has_the_less_noise(
    frame: str, pose: float, velocity: float
) -> None:
    walk, random = crawl(), np.random.default_rng(1)
    log = walk.log(frame)

    def noise(table: Array | None, size: float) -> Array:
        return np.asarray(table) + size * random.normal(size=np.shape(table))

    base = replace(
        log.base,
        position=noise(log.base.position, pose),
        orientation=unit(noise(log.base.orientation, 0.5 * pose)),
        linear_velocity=noise(log.base.linear_velocity, velocity),
        angular_velocity=noise(log.base.angular_velocity, velocity),
    )
    log = replace(log, base=base)
    found = {
        source: sdpid.process(log, {**SETTINGS, "base_motion": source})
        for source in ("auto", "twist", "pose")
    }
    at = rows(found["auto"], walk)
    classical = walk.a[at, :3] + np.cross(walk.v[at, 3:6], walk.v[at, :3])
    truth = np.hstack([classical, walk.a[at, 3:6]])
    for part in (slice(0, 3), slice(3, 6)):
        error = {
            source: rms(samples.acceleration[:, part] - truth[:, part])
            for source, samples in found.items()
        }
        assert error["auto"] <= 1.01 * min(error["twist"], error["pose"]), error
    said = next(note for note in found["auto"].notes if "accelerations of the base" in note)
    assert "noise of" in said
