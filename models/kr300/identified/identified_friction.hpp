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
#ifndef SDPID_FRICTION_5FC1A514F1874D48
#define SDPID_FRICTION_5FC1A514F1874D48

#include <cmath>

// Define another name where the headers of several robots are included.
#ifndef SDPID_FRICTION_NAMESPACE
#define SDPID_FRICTION_NAMESPACE identified_friction
#endif

namespace SDPID_FRICTION_NAMESPACE {

constexpr int joints = 6;
constexpr const char* robot = "kr300";
constexpr const char* certificate = "a2f2c6be05905b80c9788c0e3f7e05493b272d44c005e5a2b44910e6a022ef52";
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
      + 284.8162748446374 * detail::tanh(v[0] / 0.005)  // Fs1
      + 223.38116016994567 * detail::tanh(v[0] / 0.2078640101349174)  // Fsg1
      + 1569.2756273203477 * v[0]  // Fv1
      + -80.10716187940268;  // Fo1
  effort[1] = 0.0
      + 375.1705561670478 * detail::tanh(v[1] / 0.005)  // Fs2
      + 253.14799552402815 * detail::tanh(v[1] / 0.21858314655410788)  // Fsg2
      + 1538.9498332072635 * v[1]  // Fv2
      + -32.70491150724622;  // Fo2
  effort[2] = 0.0
      + 267.2919929227877 * detail::tanh(v[2] / 0.005)  // Fs3
      + 5.560186397523898e-08 * detail::tanh(v[2] / 0.06496452446228179)  // Fsg3
      + 1524.6588711797183 * v[2]  // Fv3
      + 72.93612671876913;  // Fo3
  effort[3] = 0.0
      + 99.7166518743627 * detail::tanh(v[3] / 0.005)  // Fs4
      + 9.702824925864634e-07 * detail::tanh(v[3] / 0.07525057585526056)  // Fsg4
      + 285.2506861329289 * v[3]  // Fv4
      + 6.269005794722396;  // Fo4
  effort[4] = 0.0
      + 98.79477724886246 * detail::tanh(v[4] / 0.005)  // Fs5
      + 41.77583073291445 * detail::tanh(v[4] / 0.2571569971435931)  // Fsg5
      + 506.4128835363657 * v[4]  // Fv5
      + -40.710499282623935  // Fo5
      + 5.691678819531556 * v[5]  // Fv5_6
      + 10.002778800946334 * detail::tanh((v[4] + v[5]) / 0.005);  // Fs5_6
  effort[5] = 0.0
      + 74.23033280296042 * detail::tanh(v[5] / 0.005)  // Fs6
      + 58.02149196795931 * detail::tanh(v[5] / 0.3799657701896268)  // Fsg6
      + 306.4348284435372 * v[5]  // Fv6
      + 8.804590317451186  // Fo6
      + 5.691678819531556 * v[4]  // Fv5_6
      + 10.002778800946334 * detail::tanh((v[4] + v[5]) / 0.005);  // Fs5_6
}

// Writes the efforts that accelerate the rotors of all joints.
inline void drive_inertia(const double* a, double* effort) noexcept {
  effort[0] = 0.0
      + 1.8348822550251498e-05 * a[0];  // Ia1
  effort[1] = 0.0
      + 4.017852234028396e-06 * a[1];  // Ia2
  effort[2] = 0.0
      + 728.9455772244061 * a[2];  // Ia3
  effort[3] = 0.0
      + 97.26943258237395 * a[3];  // Ia4
  effort[4] = 0.0
      + 136.75696210300106 * a[4]  // Ia5
      + -6.927208334080613 * a[5];  // Ia5_6
  effort[5] = 0.0
      + 58.47358153733866 * a[5]  // Ia6
      + -6.927208334080613 * a[4];  // Ia5_6
}

// Writes friction that grows with load of all joints.
inline void load_friction(const double* v, const double* load, double* effort) noexcept {
  effort[0] = 0.0
      + 0.01843011514981422 * detail::size(load[0]) * (0.5606105670717849 * detail::tanh(v[0] / 0.005) + 0.43938943292821514 * detail::tanh(v[0] / 0.2078640101349174));  // Fl1
  effort[1] = 0.0
      + 0.018924399493108285 * detail::size(load[1]) * (0.597005047296202 * detail::tanh(v[1] / 0.005) + 0.40299495270379804 * detail::tanh(v[1] / 0.21858314655410788));  // Fl2
  effort[2] = 0.0
      + 0.05948373224070021 * detail::size(load[2]) * (0.9999999987386593 * detail::tanh(v[2] / 0.005) + 1.2613407157484614e-09 * detail::tanh(v[2] / 0.06496452446228179));  // Fl3
  effort[3] = 0.0
      + 0.04925231553459907 * detail::size(load[3]) * (0.9999996840462166 * detail::tanh(v[3] / 0.005) + 3.1595378341067157e-07 * detail::tanh(v[3] / 0.07525057585526056));  // Fl4
  effort[4] = 0.0
      + 0.04909360686833906 * detail::size(load[4]) * (0.7039399288952076 * detail::tanh(v[4] / 0.005) + 0.2960600711047924 * detail::tanh(v[4] / 0.2571569971435931));  // Fl5
  effort[5] = 0.0
      + 0.4185156352354412 * detail::size(load[5]) * (0.5559495209309369 * detail::tanh(v[5] / 0.005) + 0.4440504790690631 * detail::tanh(v[5] / 0.3799657701896268));  // Fl6
}

}  // namespace SDPID_FRICTION_NAMESPACE
#undef SDPID_FRICTION_NAMESPACE

// sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.3.0", "certificate": "a2f2c6be05905b80c9788c0e3f7e05493b272d44c005e5a2b44910e6a022ef52", "robot": "kr300", "joints": ["joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"], "terms": [{"term": "Coulomb", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [284.8162748446374, 375.1705561670478, 267.2919929227877, 99.7166518743627, 98.79477724886246, 74.23033280296042]}, {"term": "SigmoidFriction", "velocity": [0.2078640101349174, 0.21858314655410788, 0.06496452446228179, 0.07525057585526056, 0.2571569971435931, 0.3799657701896268], "values": [223.38116016994567, 253.14799552402815, 5.560186397523898e-08, 9.702824925864634e-07, 41.77583073291445, 58.02149196795931]}, {"term": "Viscous", "values": [1569.2756273203477, 1538.9498332072635, 1524.6588711797183, 285.2506861329289, 506.4128835363657, 306.4348284435372]}, {"term": "Offset", "values": [-80.10716187940268, -32.70491150724622, 72.93612671876913, 6.269005794722396, -40.710499282623935, 8.804590317451186]}, {"term": "RotorInertia", "values": [1.8348822550251498e-05, 4.017852234028396e-06, 728.9455772244061, 97.26943258237395, 136.75696210300106, 58.47358153733866]}, {"term": "LoadFriction", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "share": [0.43938943292821514, 0.40299495270379804, 1.2613407157484614e-09, 3.1595378341067157e-07, 0.2960600711047924, 0.4440504790690631], "velocity": [0.2078640101349174, 0.21858314655410788, 0.06496452446228179, 0.07525057585526056, 0.2571569971435931, 0.3799657701896268], "values": [0.01843011514981422, 0.018924399493108285, 0.05948373224070021, 0.04925231553459907, 0.04909360686833906, 0.4185156352354412]}, {"term": "Coupling", "joints": [4, 5], "width": [0.005], "values": [-6.927208334080613, 5.691678819531556, 10.002778800946334]}], "left_out": ["Tilt"]}

#endif  // SDPID_FRICTION_5FC1A514F1874D48
