"""Joint friction as sdpid identified it; made by a program, not to be edited.

To be added to the efforts of the rigid links, such as those of the URDF beside it.
Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.

Arrays hold one state, (n,), or many, (K, n), in the order of JOINTS.
"""

import numpy as np

ROBOT = 'panda'
CERTIFICATE = 'dbe5106b3f0ef1954e9f48f54ea0857f5ad095a034f51df1cd9d56731fcb8a21'
JOINTS = (
    'panda_joint1',
    'panda_joint2',
    'panda_joint3',
    'panda_joint4',
    'panda_joint5',
    'panda_joint6',
    'panda_joint7',
)


def friction(velocity):
    """Return friction and offsets of all joints."""
    v = _states(velocity)
    effort = np.zeros(v.shape)
    effort[..., 0] = (
        0.10485430624200417 * _tanh(v[..., 0] / 0.005)  # Fs1
        + 0.2716391255798113 * _tanh(v[..., 0] / 0.07147472622080726)  # Fsg1
        + 1.3209816573933608e-10 * v[..., 0]  # Fv1
        + -0.2435725346420505  # Fo1
    )
    effort[..., 1] = (
        0.19664668585689773 * _tanh(v[..., 1] / 0.005)  # Fs2
        + 2.6307971426331456e-11 * _tanh(v[..., 1] / 0.34505398211069777)  # Fsg2
        + 3.572302176291231e-11 * v[..., 1]  # Fv2
        + 0.1664197816044404  # Fo2
    )
    effort[..., 2] = (
        0.18669810589987057 * _tanh(v[..., 2] / 0.005)  # Fs3
        + 0.03693334601799847 * _tanh(v[..., 2] / 0.03472176095009769)  # Fsg3
        + 6.139903169222194e-11 * v[..., 2]  # Fv3
        + 0.08396324805362439  # Fo3
    )
    effort[..., 3] = (
        0.10192016440706538 * _tanh(v[..., 3] / 0.005)  # Fs4
        + 9.07585118170573e-12 * _tanh(v[..., 3] / 0.41640830483545294)  # Fsg4
        + 7.312817018600981e-12 * v[..., 3]  # Fv4
        + 0.16558042586936472  # Fo4
    )
    effort[..., 4] = (
        0.25019852494457256 * _tanh(v[..., 4] / 0.005)  # Fs5
        + 0.19148459606130472 * _tanh(v[..., 4] / 0.16708715916905245)  # Fsg5
        + 0.006295678964475036 * v[..., 4]  # Fv5
        + -0.014825203858237396  # Fo5
    )
    effort[..., 5] = (
        9.068091000319356e-10 * _tanh(v[..., 5] / 0.005)  # Fs6
        + 0.25765187830740677 * _tanh(v[..., 5] / 0.02)  # Fsg6
        + 0.11643853547460355 * v[..., 5]  # Fv6
        + -0.006029376408367184  # Fo6
    )
    effort[..., 6] = (
        0.14391298203456754 * _tanh(v[..., 6] / 0.005)  # Fs7
        + 0.1263763342771675 * _tanh(v[..., 6] / 0.1007605490755835)  # Fsg7
        + 0.014803329886605716 * v[..., 6]  # Fv7
        + -0.004918034291032047  # Fo7
    )
    return effort


def drive_inertia(acceleration):
    """Return the efforts that accelerate the rotors of all joints."""
    a = _states(acceleration)
    effort = np.zeros(a.shape)
    return effort


def load_friction(velocity, load):
    """Return friction that grows with load of all joints."""
    v = _states(velocity)
    load = _states(load)
    effort = np.zeros(v.shape)
    return effort


def _states(values):
    """Return states (n,) or (K, n) as an array."""
    array = np.asarray(values, dtype=float)
    if array.ndim not in (1, 2) or array.shape[-1] != len(JOINTS):
        raise ValueError(f"states have shape {array.shape}, expected (..., {len(JOINTS)})")
    return array


_sign = np.sign
_tanh = np.tanh
_size = np.abs


def _outside(v, dead_zone, value):
    """Return a value, zero within the dead zone."""
    return np.where(np.abs(v) < dead_zone, 0.0, value)


def _ahead(x):
    """Return what is positive, else zero."""
    return np.maximum(x, 0.0)


def _back(x):
    """Return what is negative, else zero."""
    return np.minimum(x, 0.0)


def _root(v):
    """Return the signed square root of the speed."""
    return np.sign(v) * np.sqrt(np.abs(v))


def _peak(ratio, exponent):
    """Return the Stribeck peak about standstill."""
    return np.exp(-(np.minimum(np.abs(ratio), 1e3) ** exponent))

# sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.3.0", "certificate": "dbe5106b3f0ef1954e9f48f54ea0857f5ad095a034f51df1cd9d56731fcb8a21", "robot": "panda", "joints": ["panda_joint1", "panda_joint2", "panda_joint3", "panda_joint4", "panda_joint5", "panda_joint6", "panda_joint7"], "terms": [{"term": "Coulomb", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [0.10485430624200417, 0.19664668585689773, 0.18669810589987057, 0.10192016440706538, 0.25019852494457256, 9.068091000319356e-10, 0.14391298203456754]}, {"term": "SigmoidFriction", "velocity": [0.07147472622080726, 0.34505398211069777, 0.03472176095009769, 0.41640830483545294, 0.16708715916905245, 0.02, 0.1007605490755835], "values": [0.2716391255798113, 2.6307971426331456e-11, 0.03693334601799847, 9.07585118170573e-12, 0.19148459606130472, 0.25765187830740677, 0.1263763342771675]}, {"term": "Viscous", "values": [1.3209816573933608e-10, 3.572302176291231e-11, 6.139903169222194e-11, 7.312817018600981e-12, 0.006295678964475036, 0.11643853547460355, 0.014803329886605716]}, {"term": "Offset", "values": [-0.2435725346420505, 0.1664197816044404, 0.08396324805362439, 0.16558042586936472, -0.014825203858237396, -0.006029376408367184, -0.004918034291032047]}], "left_out": []}
