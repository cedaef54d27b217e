"""Joint friction as sdpid identified it; made by a program, not to be edited.

To be added to the efforts of the rigid links, such as those of the URDF beside it.
Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.

Arrays hold one state, (n,), or many, (K, n), in the order of JOINTS.
"""

import numpy as np

ROBOT = 'kinova_gen3'
CERTIFICATE = '25a52d8e992ef0b35de87795feb21ddb9c4d70bde63cddb41da826a22f70f90a'
JOINTS = (
    'joint_1',
    'joint_2',
    'joint_3',
    'joint_4',
    'joint_5',
    'joint_6',
    'joint_7',
)


def friction(velocity):
    """Return friction and offsets of all joints."""
    v = _states(velocity)
    effort = np.zeros(v.shape)
    effort[..., 0] = (
        0.0804149001603478 * _tanh(v[..., 0] / 0.005)  # Fs1
        + 0.1560176490859308 * _tanh(v[..., 0] / 0.02)  # Fsg1
        + 0.40286585654030366 * v[..., 0]  # Fv1
        + 0.5220668545769029  # Fo1
    )
    effort[..., 1] = (
        1.029178270384179e-10 * _tanh(v[..., 1] / 0.005)  # Fs2
        + 2.2755103310372635 * _tanh(v[..., 1] / 0.311313249580415)  # Fsg2
        + 0.002327046654935952 * v[..., 1]  # Fv2
        + -0.06635908030075847  # Fo2
    )
    effort[..., 2] = (
        0.02478122160046342 * _tanh(v[..., 2] / 0.005)  # Fs3
        + 0.27088699939798544 * _tanh(v[..., 2] / 0.02)  # Fsg3
        + 1.1140949274235368e-12 * v[..., 2]  # Fv3
        + -0.2249470943241812  # Fo3
    )
    effort[..., 3] = (
        0.8412210664466366 * _tanh(v[..., 3] / 0.005)  # Fs4
        + 0.48214272920155277 * _tanh(v[..., 3] / 0.41493739250423495)  # Fsg4
        + 1.6006085346020882e-12 * v[..., 3]  # Fv4
        + 0.12979018117444588  # Fo4
    )
    effort[..., 4] = (
        0.19909398315044124 * _tanh(v[..., 4] / 0.005)  # Fs5
        + 0.1582406457624259 * _tanh(v[..., 4] / 0.42460641281359096)  # Fsg5
        + 0.026706429545298567 * v[..., 4]  # Fv5
        + 0.1994610350194971  # Fo5
    )
    effort[..., 5] = (
        0.20108925486390242 * _tanh(v[..., 5] / 0.005)  # Fs6
        + 0.1509176353506554 * _tanh(v[..., 5] / 0.15416948072218914)  # Fsg6
        + 4.657294341847695e-11 * v[..., 5]  # Fv6
        + 0.16768414608933388  # Fo6
    )
    effort[..., 6] = (
        0.08046662930713357 * _tanh(v[..., 6] / 0.005)  # Fs7
        + 0.14108945604912743 * _tanh(v[..., 6] / 0.02)  # Fsg7
        + 0.10537382025416218 * v[..., 6]  # Fv7
        + 0.16319024449648864  # Fo7
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

# sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.3.0", "certificate": "25a52d8e992ef0b35de87795feb21ddb9c4d70bde63cddb41da826a22f70f90a", "robot": "kinova_gen3", "joints": ["joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6", "joint_7"], "terms": [{"term": "Coulomb", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [0.0804149001603478, 1.029178270384179e-10, 0.02478122160046342, 0.8412210664466366, 0.19909398315044124, 0.20108925486390242, 0.08046662930713357]}, {"term": "SigmoidFriction", "velocity": [0.02, 0.311313249580415, 0.02, 0.41493739250423495, 0.42460641281359096, 0.15416948072218914, 0.02], "values": [0.1560176490859308, 2.2755103310372635, 0.27088699939798544, 0.48214272920155277, 0.1582406457624259, 0.1509176353506554, 0.14108945604912743]}, {"term": "Viscous", "values": [0.40286585654030366, 0.002327046654935952, 1.1140949274235368e-12, 1.6006085346020882e-12, 0.026706429545298567, 4.657294341847695e-11, 0.10537382025416218]}, {"term": "Offset", "values": [0.5220668545769029, -0.06635908030075847, -0.2249470943241812, 0.12979018117444588, 0.1994610350194971, 0.16768414608933388, 0.16319024449648864]}], "left_out": []}
