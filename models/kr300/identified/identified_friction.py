"""Joint friction as sdpid identified it; made by a program, not to be edited.

To be added to the efforts of the rigid links, such as those of the URDF beside it.
Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.

Not in it is the tilt of the base that was identified: turn gravity to have it.

Arrays hold one state, (n,), or many, (K, n), in the order of JOINTS.
"""

import numpy as np

ROBOT = 'kr300'
CERTIFICATE = 'a2f2c6be05905b80c9788c0e3f7e05493b272d44c005e5a2b44910e6a022ef52'
JOINTS = (
    'joint_1',
    'joint_2',
    'joint_3',
    'joint_4',
    'joint_5',
    'joint_6',
)


def friction(velocity):
    """Return friction and offsets of all joints."""
    v = _states(velocity)
    effort = np.zeros(v.shape)
    effort[..., 0] = (
        284.8162748446374 * _tanh(v[..., 0] / 0.005)  # Fs1
        + 223.38116016994567 * _tanh(v[..., 0] / 0.2078640101349174)  # Fsg1
        + 1569.2756273203477 * v[..., 0]  # Fv1
        + -80.10716187940268  # Fo1
    )
    effort[..., 1] = (
        375.1705561670478 * _tanh(v[..., 1] / 0.005)  # Fs2
        + 253.14799552402815 * _tanh(v[..., 1] / 0.21858314655410788)  # Fsg2
        + 1538.9498332072635 * v[..., 1]  # Fv2
        + -32.70491150724622  # Fo2
    )
    effort[..., 2] = (
        267.2919929227877 * _tanh(v[..., 2] / 0.005)  # Fs3
        + 5.560186397523898e-08 * _tanh(v[..., 2] / 0.06496452446228179)  # Fsg3
        + 1524.6588711797183 * v[..., 2]  # Fv3
        + 72.93612671876913  # Fo3
    )
    effort[..., 3] = (
        99.7166518743627 * _tanh(v[..., 3] / 0.005)  # Fs4
        + 9.702824925864634e-07 * _tanh(v[..., 3] / 0.07525057585526056)  # Fsg4
        + 285.2506861329289 * v[..., 3]  # Fv4
        + 6.269005794722396  # Fo4
    )
    effort[..., 4] = (
        98.79477724886246 * _tanh(v[..., 4] / 0.005)  # Fs5
        + 41.77583073291445 * _tanh(v[..., 4] / 0.2571569971435931)  # Fsg5
        + 506.4128835363657 * v[..., 4]  # Fv5
        + -40.710499282623935  # Fo5
        + 5.691678819531556 * v[..., 5]  # Fv5_6
        + 10.002778800946334 * _tanh((v[..., 4] + v[..., 5]) / 0.005)  # Fs5_6
    )
    effort[..., 5] = (
        74.23033280296042 * _tanh(v[..., 5] / 0.005)  # Fs6
        + 58.02149196795931 * _tanh(v[..., 5] / 0.3799657701896268)  # Fsg6
        + 306.4348284435372 * v[..., 5]  # Fv6
        + 8.804590317451186  # Fo6
        + 5.691678819531556 * v[..., 4]  # Fv5_6
        + 10.002778800946334 * _tanh((v[..., 4] + v[..., 5]) / 0.005)  # Fs5_6
    )
    return effort


def drive_inertia(acceleration):
    """Return the efforts that accelerate the rotors of all joints."""
    a = _states(acceleration)
    effort = np.zeros(a.shape)
    effort[..., 0] = (
        1.8348822550251498e-05 * a[..., 0]  # Ia1
    )
    effort[..., 1] = (
        4.017852234028396e-06 * a[..., 1]  # Ia2
    )
    effort[..., 2] = (
        728.9455772244061 * a[..., 2]  # Ia3
    )
    effort[..., 3] = (
        97.26943258237395 * a[..., 3]  # Ia4
    )
    effort[..., 4] = (
        136.75696210300106 * a[..., 4]  # Ia5
        + -6.927208334080613 * a[..., 5]  # Ia5_6
    )
    effort[..., 5] = (
        58.47358153733866 * a[..., 5]  # Ia6
        + -6.927208334080613 * a[..., 4]  # Ia5_6
    )
    return effort


def load_friction(velocity, load):
    """Return friction that grows with load of all joints."""
    v = _states(velocity)
    load = _states(load)
    effort = np.zeros(v.shape)
    effort[..., 0] = (
        0.01843011514981422 * _size(load[..., 0]) * (0.5606105670717849 * _tanh(v[..., 0] / 0.005) + 0.43938943292821514 * _tanh(v[..., 0] / 0.2078640101349174))  # Fl1
    )
    effort[..., 1] = (
        0.018924399493108285 * _size(load[..., 1]) * (0.597005047296202 * _tanh(v[..., 1] / 0.005) + 0.40299495270379804 * _tanh(v[..., 1] / 0.21858314655410788))  # Fl2
    )
    effort[..., 2] = (
        0.05948373224070021 * _size(load[..., 2]) * (0.9999999987386593 * _tanh(v[..., 2] / 0.005) + 1.2613407157484614e-09 * _tanh(v[..., 2] / 0.06496452446228179))  # Fl3
    )
    effort[..., 3] = (
        0.04925231553459907 * _size(load[..., 3]) * (0.9999996840462166 * _tanh(v[..., 3] / 0.005) + 3.1595378341067157e-07 * _tanh(v[..., 3] / 0.07525057585526056))  # Fl4
    )
    effort[..., 4] = (
        0.04909360686833906 * _size(load[..., 4]) * (0.7039399288952076 * _tanh(v[..., 4] / 0.005) + 0.2960600711047924 * _tanh(v[..., 4] / 0.2571569971435931))  # Fl5
    )
    effort[..., 5] = (
        0.4185156352354412 * _size(load[..., 5]) * (0.5559495209309369 * _tanh(v[..., 5] / 0.005) + 0.4440504790690631 * _tanh(v[..., 5] / 0.3799657701896268))  # Fl6
    )
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

# sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.3.0", "certificate": "a2f2c6be05905b80c9788c0e3f7e05493b272d44c005e5a2b44910e6a022ef52", "robot": "kr300", "joints": ["joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"], "terms": [{"term": "Coulomb", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [284.8162748446374, 375.1705561670478, 267.2919929227877, 99.7166518743627, 98.79477724886246, 74.23033280296042]}, {"term": "SigmoidFriction", "velocity": [0.2078640101349174, 0.21858314655410788, 0.06496452446228179, 0.07525057585526056, 0.2571569971435931, 0.3799657701896268], "values": [223.38116016994567, 253.14799552402815, 5.560186397523898e-08, 9.702824925864634e-07, 41.77583073291445, 58.02149196795931]}, {"term": "Viscous", "values": [1569.2756273203477, 1538.9498332072635, 1524.6588711797183, 285.2506861329289, 506.4128835363657, 306.4348284435372]}, {"term": "Offset", "values": [-80.10716187940268, -32.70491150724622, 72.93612671876913, 6.269005794722396, -40.710499282623935, 8.804590317451186]}, {"term": "RotorInertia", "values": [1.8348822550251498e-05, 4.017852234028396e-06, 728.9455772244061, 97.26943258237395, 136.75696210300106, 58.47358153733866]}, {"term": "LoadFriction", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "share": [0.43938943292821514, 0.40299495270379804, 1.2613407157484614e-09, 3.1595378341067157e-07, 0.2960600711047924, 0.4440504790690631], "velocity": [0.2078640101349174, 0.21858314655410788, 0.06496452446228179, 0.07525057585526056, 0.2571569971435931, 0.3799657701896268], "values": [0.01843011514981422, 0.018924399493108285, 0.05948373224070021, 0.04925231553459907, 0.04909360686833906, 0.4185156352354412]}, {"term": "Coupling", "joints": [4, 5], "width": [0.005], "values": [-6.927208334080613, 5.691678819531556, 10.002778800946334]}], "left_out": ["Tilt"]}
