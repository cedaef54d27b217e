"""Joint friction as sdpid identified it; made by a program, not to be edited.

To be added to the efforts of the rigid links, such as those of the URDF beside it.
Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.

Arrays hold one state, (n,), or many, (K, n), in the order of JOINTS.
"""

import numpy as np

ROBOT = 'go2_description'
CERTIFICATE = None
JOINTS = (
    'FL_hip_joint',
    'FL_thigh_joint',
    'FL_calf_joint',
    'FR_hip_joint',
    'FR_thigh_joint',
    'FR_calf_joint',
    'RL_hip_joint',
    'RL_thigh_joint',
    'RL_calf_joint',
    'RR_hip_joint',
    'RR_thigh_joint',
    'RR_calf_joint',
)


def friction(velocity):
    """Return friction and offsets of all joints."""
    v = _states(velocity)
    effort = np.zeros(v.shape)
    effort[..., 0] = (
        0.31960611395620936 * _sign(v[..., 0])  # Fs1
    )
    effort[..., 1] = (
        0.18621666426670544 * _sign(v[..., 1])  # Fs2
        + 0.15691323226793874 * v[..., 1]  # Fv2
    )
    effort[..., 2] = (
        0.9770824384061414 * _sign(v[..., 2])  # Fs3
        + 0.02925448745997778 * v[..., 2]  # Fv3
    )
    effort[..., 3] = (
        0.1844181755665087 * _sign(v[..., 3])  # Fs4
        + 0.18824069187296621 * v[..., 3]  # Fv4
    )
    effort[..., 4] = (
        0.18967784507574997 * _sign(v[..., 4])  # Fs5
        + 0.08316074530370576 * v[..., 4]  # Fv5
    )
    effort[..., 5] = (
        0.6446502902536357 * _sign(v[..., 5])  # Fs6
        + 0.0003161064759372844 * v[..., 5]  # Fv6
    )
    effort[..., 6] = (
        0.158560413340505 * _sign(v[..., 6])  # Fs7
        + 0.10289728374263898 * v[..., 6]  # Fv7
    )
    effort[..., 7] = (
        0.148727691078564 * _sign(v[..., 7])  # Fs8
        + 0.11955137283846473 * v[..., 7]  # Fv8
    )
    effort[..., 8] = (
        1.3693388277275922 * _sign(v[..., 8])  # Fs9
    )
    effort[..., 9] = (
        0.22638516435254977 * _sign(v[..., 9])  # Fs10
        + 0.12095702560032448 * v[..., 9]  # Fv10
    )
    effort[..., 10] = (
        0.2690865117037735 * _sign(v[..., 10])  # Fs11
        + 0.08715830138684012 * v[..., 10]  # Fv11
    )
    effort[..., 11] = (
        0.8142550282451764 * _sign(v[..., 11])  # Fs12
        + 0.012821209821002945 * v[..., 11]  # Fv12
    )
    return effort


def drive_inertia(acceleration):
    """Return the efforts that accelerate the rotors of all joints."""
    a = _states(acceleration)
    effort = np.zeros(a.shape)
    effort[..., 0] = (
        1.8377807096188814e-09 * a[..., 0]  # Ia1
    )
    effort[..., 2] = (
        0.02460906585825924 * a[..., 2]  # Ia3
    )
    effort[..., 4] = (
        0.018135787977185173 * a[..., 4]  # Ia5
    )
    effort[..., 5] = (
        0.021012889542995756 * a[..., 5]  # Ia6
    )
    effort[..., 7] = (
        0.009096593300170592 * a[..., 7]  # Ia8
    )
    effort[..., 8] = (
        0.020457864057291313 * a[..., 8]  # Ia9
    )
    effort[..., 10] = (
        0.0036864218369458087 * a[..., 10]  # Ia11
    )
    effort[..., 11] = (
        0.02197135511215772 * a[..., 11]  # Ia12
    )
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

# sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.3.0", "certificate": null, "robot": "go2_description", "joints": ["FL_hip_joint", "FL_thigh_joint", "FL_calf_joint", "FR_hip_joint", "FR_thigh_joint", "FR_calf_joint", "RL_hip_joint", "RL_thigh_joint", "RL_calf_joint", "RR_hip_joint", "RR_thigh_joint", "RR_calf_joint"], "terms": [{"term": "Coulomb", "width": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [0.31960611395620936, 0.18621666426670544, 0.9770824384061414, 0.1844181755665087, 0.18967784507574997, 0.6446502902536357, 0.158560413340505, 0.148727691078564, 1.3693388277275922, 0.22638516435254977, 0.2690865117037735, 0.8142550282451764]}, {"term": "Viscous", "values": [0.0, 0.15691323226793874, 0.02925448745997778, 0.18824069187296621, 0.08316074530370576, 0.0003161064759372844, 0.10289728374263898, 0.11955137283846473, 0.0, 0.12095702560032448, 0.08715830138684012, 0.012821209821002945]}, {"term": "RotorInertia", "values": [1.8377807096188814e-09, 0.0, 0.02460906585825924, 0.0, 0.018135787977185173, 0.021012889542995756, 0.0, 0.009096593300170592, 0.020457864057291313, 0.0, 0.0036864218369458087, 0.02197135511215772]}], "left_out": []}
