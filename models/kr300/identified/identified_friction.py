"""Joint friction as sdpid identified it; made by a program, not to be edited.

To be added to the efforts of the rigid links, such as those of the URDF beside it.
Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.

Not in it is the tilt of the base that was identified: turn gravity to have it.

Arrays hold one state, (n,), or many, (K, n), in the order of JOINTS.
"""

import numpy as np

ROBOT = 'kr300'
CERTIFICATE = 'c952b13ba7adb9bcbba0bd71cb966881babcdbabc9b727483e1cfe313c4fe6d2'
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
        284.81628314186435 * _tanh(v[..., 0] / 0.005)  # Fs1
        + 223.38112848950902 * _tanh(v[..., 0] / 0.2078640101349174)  # Fsg1
        + 1569.2756434539874 * v[..., 0]  # Fv1
        + -80.10735884077121  # Fo1
    )
    effort[..., 1] = (
        375.17055994700445 * _tanh(v[..., 1] / 0.005)  # Fs2
        + 253.14801863928415 * _tanh(v[..., 1] / 0.21858314655410788)  # Fsg2
        + 1538.9497591292165 * v[..., 1]  # Fv2
        + -32.70455465992244  # Fo2
    )
    effort[..., 2] = (
        267.2920424783168 * _tanh(v[..., 2] / 0.005)  # Fs3
        + 5.559153611561228e-08 * _tanh(v[..., 2] / 0.06496452446228179)  # Fsg3
        + 1524.6589384794925 * v[..., 2]  # Fv3
        + 72.93620976154732  # Fo3
    )
    effort[..., 3] = (
        99.71665427298433 * _tanh(v[..., 3] / 0.005)  # Fs4
        + 9.700924024546555e-07 * _tanh(v[..., 3] / 0.07525057585526056)  # Fsg4
        + 285.25069143356546 * v[..., 3]  # Fv4
        + 6.269023388954421  # Fo4
    )
    effort[..., 4] = (
        98.79478653151232 * _tanh(v[..., 4] / 0.005)  # Fs5
        + 41.77576969634873 * _tanh(v[..., 4] / 0.2571569971435931)  # Fsg5
        + 506.4130387591749 * v[..., 4]  # Fv5
        + -40.710425186221336  # Fo5
        + 5.691659047345428 * v[..., 5]  # Fv5_6
        + 10.00277987413124 * _tanh((v[..., 4] + v[..., 5]) / 0.005)  # Fs5_6
    )
    effort[..., 5] = (
        74.23033841098825 * _tanh(v[..., 5] / 0.005)  # Fs6
        + 58.02148071497377 * _tanh(v[..., 5] / 0.3799657701896268)  # Fsg6
        + 306.4348457664611 * v[..., 5]  # Fv6
        + 8.80459888748723  # Fo6
        + 5.691659047345428 * v[..., 4]  # Fv5_6
        + 10.00277987413124 * _tanh((v[..., 4] + v[..., 5]) / 0.005)  # Fs5_6
    )
    return effort


def drive_inertia(acceleration):
    """Return the efforts that accelerate the rotors of all joints."""
    a = _states(acceleration)
    effort = np.zeros(a.shape)
    effort[..., 0] = (
        3.114283117611194e-06 * a[..., 0]  # Ia1
    )
    effort[..., 1] = (
        5.0806749527509965e-06 * a[..., 1]  # Ia2
    )
    effort[..., 2] = (
        728.9457165356717 * a[..., 2]  # Ia3
    )
    effort[..., 3] = (
        97.26943396231083 * a[..., 3]  # Ia4
    )
    effort[..., 4] = (
        136.7569577929755 * a[..., 4]  # Ia5
        + -6.927211698708138 * a[..., 5]  # Ia5_6
    )
    effort[..., 5] = (
        58.47358575748108 * a[..., 5]  # Ia6
        + -6.927211698708138 * a[..., 4]  # Ia5_6
    )
    return effort


def load_friction(velocity, load):
    """Return friction that grows with load of all joints."""
    v = _states(velocity)
    load = _states(load)
    effort = np.zeros(v.shape)
    effort[..., 0] = (
        0.01843011307428654 * _size(load[..., 0]) * (0.5606105669811006 * _tanh(v[..., 0] / 0.005) + 0.4393894330188994 * _tanh(v[..., 0] / 0.2078640101349174))  # Fl1
    )
    effort[..., 1] = (
        0.01892439274619435 * _size(load[..., 1]) * (0.5970050479686348 * _tanh(v[..., 1] / 0.005) + 0.40299495203136515 * _tanh(v[..., 1] / 0.21858314655410788))  # Fl2
    )
    effort[..., 2] = (
        0.0594837121719272 * _size(load[..., 2]) * (0.9999999987198618 * _tanh(v[..., 2] / 0.005) + 1.2801382166987538e-09 * _tanh(v[..., 2] / 0.06496452446228179))  # Fl3
    )
    effort[..., 3] = (
        0.04925232527829347 * _size(load[..., 3]) * (0.9999996794871243 * _tanh(v[..., 3] / 0.005) + 3.205128756840685e-07 * _tanh(v[..., 3] / 0.07525057585526056))  # Fl4
    )
    effort[..., 4] = (
        0.049093595415342126 * _size(load[..., 4]) * (0.7039399239049472 * _tanh(v[..., 4] / 0.005) + 0.2960600760950528 * _tanh(v[..., 4] / 0.2571569971435931))  # Fl5
    )
    effort[..., 5] = (
        0.4185149980556322 * _size(load[..., 5]) * (0.5559495204222538 * _tanh(v[..., 5] / 0.005) + 0.44405047957774624 * _tanh(v[..., 5] / 0.3799657701896268))  # Fl6
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

# sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.1.0", "certificate": "c952b13ba7adb9bcbba0bd71cb966881babcdbabc9b727483e1cfe313c4fe6d2", "robot": "kr300", "joints": ["joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"], "terms": [{"term": "Coulomb", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [284.81628314186435, 375.17055994700445, 267.2920424783168, 99.71665427298433, 98.79478653151232, 74.23033841098825]}, {"term": "SigmoidFriction", "velocity": [0.2078640101349174, 0.21858314655410788, 0.06496452446228179, 0.07525057585526056, 0.2571569971435931, 0.3799657701896268], "values": [223.38112848950902, 253.14801863928415, 5.559153611561228e-08, 9.700924024546555e-07, 41.77576969634873, 58.02148071497377]}, {"term": "Viscous", "values": [1569.2756434539874, 1538.9497591292165, 1524.6589384794925, 285.25069143356546, 506.4130387591749, 306.4348457664611]}, {"term": "Offset", "values": [-80.10735884077121, -32.70455465992244, 72.93620976154732, 6.269023388954421, -40.710425186221336, 8.80459888748723]}, {"term": "RotorInertia", "values": [3.114283117611194e-06, 5.0806749527509965e-06, 728.9457165356717, 97.26943396231083, 136.7569577929755, 58.47358575748108]}, {"term": "LoadFriction", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "share": [0.4393894330188994, 0.40299495203136515, 1.2801382166987538e-09, 3.205128756840685e-07, 0.2960600760950528, 0.44405047957774624], "velocity": [0.2078640101349174, 0.21858314655410788, 0.06496452446228179, 0.07525057585526056, 0.2571569971435931, 0.3799657701896268], "values": [0.01843011307428654, 0.01892439274619435, 0.0594837121719272, 0.04925232527829347, 0.049093595415342126, 0.4185149980556322]}, {"term": "Coupling", "joints": [4, 5], "width": [0.005], "values": [-6.927211698708138, 5.691659047345428, 10.00277987413124]}], "left_out": ["Tilt"]}
