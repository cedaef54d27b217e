// Joint friction as sdpid identified it; made by a program, not to be edited.
//
// To be added to the efforts of the rigid links, such as those of the URDF beside it.
// Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
// m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.
//
// Not in it is the tilt of the base that was identified: turn gravity to have it.
//
// Arrays have one entry a joint, in the order of joint_names; `effort` must not
// overlap the others. For C++11 and later.
#ifndef SDPID_FRICTION_1A4229E1B9D983D1
#define SDPID_FRICTION_1A4229E1B9D983D1

#include <cmath>

// Define another name where the headers of several robots are included.
#ifndef SDPID_FRICTION_NAMESPACE
#define SDPID_FRICTION_NAMESPACE identified_friction
#endif

namespace SDPID_FRICTION_NAMESPACE {

constexpr int joints = 6;
constexpr const char* robot = "kr300";
constexpr const char* certificate = "c952b13ba7adb9bcbba0bd71cb966881babcdbabc9b727483e1cfe313c4fe6d2";
constexpr const char* joint_names[joints] = {
    "joint_1",
    "joint_2",
    "joint_3",
    "joint_4",
    "joint_5",
    "joint_6",
};

namespace detail {

inline double sign(double x) { return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x; }
inline double tanh(double x) { return std::tanh(x); }
inline double size(double x) { return std::fabs(x); }
inline double outside(double v, double dead_zone, double value) {
  return std::fabs(v) < dead_zone ? 0.0 : value;
}
inline double ahead(double x) { return x < 0.0 ? 0.0 : x; }
inline double back(double x) { return x > 0.0 ? 0.0 : x; }
inline double root(double v) { return sign(v) * std::sqrt(std::fabs(v)); }
inline double peak(double ratio, double exponent) {
  const double speed = std::fabs(ratio);
  return std::exp(-std::pow(speed > 1e3 ? 1e3 : speed, exponent));
}

}  // namespace detail

// Writes friction and offsets of all joints.
inline void friction(const double* v, double* effort) noexcept {
  effort[0] = 0.0
      + 284.81628314186435 * detail::tanh(v[0] / 0.005)  // Fs1
      + 223.38112848950902 * detail::tanh(v[0] / 0.2078640101349174)  // Fsg1
      + 1569.2756434539874 * v[0]  // Fv1
      + -80.10735884077121;  // Fo1
  effort[1] = 0.0
      + 375.17055994700445 * detail::tanh(v[1] / 0.005)  // Fs2
      + 253.14801863928415 * detail::tanh(v[1] / 0.21858314655410788)  // Fsg2
      + 1538.9497591292165 * v[1]  // Fv2
      + -32.70455465992244;  // Fo2
  effort[2] = 0.0
      + 267.2920424783168 * detail::tanh(v[2] / 0.005)  // Fs3
      + 5.559153611561228e-08 * detail::tanh(v[2] / 0.06496452446228179)  // Fsg3
      + 1524.6589384794925 * v[2]  // Fv3
      + 72.93620976154732;  // Fo3
  effort[3] = 0.0
      + 99.71665427298433 * detail::tanh(v[3] / 0.005)  // Fs4
      + 9.700924024546555e-07 * detail::tanh(v[3] / 0.07525057585526056)  // Fsg4
      + 285.25069143356546 * v[3]  // Fv4
      + 6.269023388954421;  // Fo4
  effort[4] = 0.0
      + 98.79478653151232 * detail::tanh(v[4] / 0.005)  // Fs5
      + 41.77576969634873 * detail::tanh(v[4] / 0.2571569971435931)  // Fsg5
      + 506.4130387591749 * v[4]  // Fv5
      + -40.710425186221336  // Fo5
      + 5.691659047345428 * v[5]  // Fv5_6
      + 10.00277987413124 * detail::tanh((v[4] + v[5]) / 0.005);  // Fs5_6
  effort[5] = 0.0
      + 74.23033841098825 * detail::tanh(v[5] / 0.005)  // Fs6
      + 58.02148071497377 * detail::tanh(v[5] / 0.3799657701896268)  // Fsg6
      + 306.4348457664611 * v[5]  // Fv6
      + 8.80459888748723  // Fo6
      + 5.691659047345428 * v[4]  // Fv5_6
      + 10.00277987413124 * detail::tanh((v[4] + v[5]) / 0.005);  // Fs5_6
}

// Writes the efforts that accelerate the rotors of all joints.
inline void drive_inertia(const double* a, double* effort) noexcept {
  effort[0] = 0.0
      + 3.114283117611194e-06 * a[0];  // Ia1
  effort[1] = 0.0
      + 5.0806749527509965e-06 * a[1];  // Ia2
  effort[2] = 0.0
      + 728.9457165356717 * a[2];  // Ia3
  effort[3] = 0.0
      + 97.26943396231083 * a[3];  // Ia4
  effort[4] = 0.0
      + 136.7569577929755 * a[4]  // Ia5
      + -6.927211698708138 * a[5];  // Ia5_6
  effort[5] = 0.0
      + 58.47358575748108 * a[5]  // Ia6
      + -6.927211698708138 * a[4];  // Ia5_6
}

// Writes friction that grows with load of all joints.
inline void load_friction(const double* v, const double* load, double* effort) noexcept {
  effort[0] = 0.0
      + 0.01843011307428654 * detail::size(load[0]) * (0.5606105669811006 * detail::tanh(v[0] / 0.005) + 0.4393894330188994 * detail::tanh(v[0] / 0.2078640101349174));  // Fl1
  effort[1] = 0.0
      + 0.01892439274619435 * detail::size(load[1]) * (0.5970050479686348 * detail::tanh(v[1] / 0.005) + 0.40299495203136515 * detail::tanh(v[1] / 0.21858314655410788));  // Fl2
  effort[2] = 0.0
      + 0.0594837121719272 * detail::size(load[2]) * (0.9999999987198618 * detail::tanh(v[2] / 0.005) + 1.2801382166987538e-09 * detail::tanh(v[2] / 0.06496452446228179));  // Fl3
  effort[3] = 0.0
      + 0.04925232527829347 * detail::size(load[3]) * (0.9999996794871243 * detail::tanh(v[3] / 0.005) + 3.205128756840685e-07 * detail::tanh(v[3] / 0.07525057585526056));  // Fl4
  effort[4] = 0.0
      + 0.049093595415342126 * detail::size(load[4]) * (0.7039399239049472 * detail::tanh(v[4] / 0.005) + 0.2960600760950528 * detail::tanh(v[4] / 0.2571569971435931));  // Fl5
  effort[5] = 0.0
      + 0.4185149980556322 * detail::size(load[5]) * (0.5559495204222538 * detail::tanh(v[5] / 0.005) + 0.44405047957774624 * detail::tanh(v[5] / 0.3799657701896268));  // Fl6
}

}  // namespace SDPID_FRICTION_NAMESPACE
#undef SDPID_FRICTION_NAMESPACE

// sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.1.0", "certificate": "c952b13ba7adb9bcbba0bd71cb966881babcdbabc9b727483e1cfe313c4fe6d2", "robot": "kr300", "joints": ["joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"], "terms": [{"term": "Coulomb", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [284.81628314186435, 375.17055994700445, 267.2920424783168, 99.71665427298433, 98.79478653151232, 74.23033841098825]}, {"term": "SigmoidFriction", "velocity": [0.2078640101349174, 0.21858314655410788, 0.06496452446228179, 0.07525057585526056, 0.2571569971435931, 0.3799657701896268], "values": [223.38112848950902, 253.14801863928415, 5.559153611561228e-08, 9.700924024546555e-07, 41.77576969634873, 58.02148071497377]}, {"term": "Viscous", "values": [1569.2756434539874, 1538.9497591292165, 1524.6589384794925, 285.25069143356546, 506.4130387591749, 306.4348457664611]}, {"term": "Offset", "values": [-80.10735884077121, -32.70455465992244, 72.93620976154732, 6.269023388954421, -40.710425186221336, 8.80459888748723]}, {"term": "RotorInertia", "values": [3.114283117611194e-06, 5.0806749527509965e-06, 728.9457165356717, 97.26943396231083, 136.7569577929755, 58.47358575748108]}, {"term": "LoadFriction", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "share": [0.4393894330188994, 0.40299495203136515, 1.2801382166987538e-09, 3.205128756840685e-07, 0.2960600760950528, 0.44405047957774624], "velocity": [0.2078640101349174, 0.21858314655410788, 0.06496452446228179, 0.07525057585526056, 0.2571569971435931, 0.3799657701896268], "values": [0.01843011307428654, 0.01892439274619435, 0.0594837121719272, 0.04925232527829347, 0.049093595415342126, 0.4185149980556322]}, {"term": "Coupling", "joints": [4, 5], "width": [0.005], "values": [-6.927211698708138, 5.691659047345428, 10.00277987413124]}], "left_out": ["Tilt"]}

#endif  // SDPID_FRICTION_1A4229E1B9D983D1
