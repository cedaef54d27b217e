// Joint friction as sdpid identified it; made by a program, not to be edited.
//
// To be added to the efforts of the rigid links, such as those of the URDF beside it.
// Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
// m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.
//
// Arrays have one entry a joint, in the order of joint_names; `effort` must not
// overlap the others. For C++11 and later.
#ifndef SDPID_FRICTION_EFC0688FC76B6C43
#define SDPID_FRICTION_EFC0688FC76B6C43

#include <cmath>

// Define another name where the headers of several robots are included.
#ifndef SDPID_FRICTION_NAMESPACE
#define SDPID_FRICTION_NAMESPACE identified_friction
#endif

namespace SDPID_FRICTION_NAMESPACE {

constexpr int joints = 12;
constexpr const char* robot = "go2_description";
constexpr const char* certificate = "";
constexpr const char* joint_names[joints] = {
    "FL_hip_joint",
    "FL_thigh_joint",
    "FL_calf_joint",
    "FR_hip_joint",
    "FR_thigh_joint",
    "FR_calf_joint",
    "RL_hip_joint",
    "RL_thigh_joint",
    "RL_calf_joint",
    "RR_hip_joint",
    "RR_thigh_joint",
    "RR_calf_joint",
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
      + 0.31960611395620936 * detail::sign(v[0]);  // Fs1
  effort[1] = 0.0
      + 0.18621666426670544 * detail::sign(v[1])  // Fs2
      + 0.15691323226793874 * v[1];  // Fv2
  effort[2] = 0.0
      + 0.9770824384061414 * detail::sign(v[2])  // Fs3
      + 0.02925448745997778 * v[2];  // Fv3
  effort[3] = 0.0
      + 0.1844181755665087 * detail::sign(v[3])  // Fs4
      + 0.18824069187296621 * v[3];  // Fv4
  effort[4] = 0.0
      + 0.18967784507574997 * detail::sign(v[4])  // Fs5
      + 0.08316074530370576 * v[4];  // Fv5
  effort[5] = 0.0
      + 0.6446502902536357 * detail::sign(v[5])  // Fs6
      + 0.0003161064759372844 * v[5];  // Fv6
  effort[6] = 0.0
      + 0.158560413340505 * detail::sign(v[6])  // Fs7
      + 0.10289728374263898 * v[6];  // Fv7
  effort[7] = 0.0
      + 0.148727691078564 * detail::sign(v[7])  // Fs8
      + 0.11955137283846473 * v[7];  // Fv8
  effort[8] = 0.0
      + 1.3693388277275922 * detail::sign(v[8]);  // Fs9
  effort[9] = 0.0
      + 0.22638516435254977 * detail::sign(v[9])  // Fs10
      + 0.12095702560032448 * v[9];  // Fv10
  effort[10] = 0.0
      + 0.2690865117037735 * detail::sign(v[10])  // Fs11
      + 0.08715830138684012 * v[10];  // Fv11
  effort[11] = 0.0
      + 0.8142550282451764 * detail::sign(v[11])  // Fs12
      + 0.012821209821002945 * v[11];  // Fv12
}

// Writes the efforts that accelerate the rotors of all joints.
inline void drive_inertia(const double* a, double* effort) noexcept {
  effort[0] = 0.0
      + 1.8377807096188814e-09 * a[0];  // Ia1
  effort[1] = 0.0;
  effort[2] = 0.0
      + 0.02460906585825924 * a[2];  // Ia3
  effort[3] = 0.0;
  effort[4] = 0.0
      + 0.018135787977185173 * a[4];  // Ia5
  effort[5] = 0.0
      + 0.021012889542995756 * a[5];  // Ia6
  effort[6] = 0.0;
  effort[7] = 0.0
      + 0.009096593300170592 * a[7];  // Ia8
  effort[8] = 0.0
      + 0.020457864057291313 * a[8];  // Ia9
  effort[9] = 0.0;
  effort[10] = 0.0
      + 0.0036864218369458087 * a[10];  // Ia11
  effort[11] = 0.0
      + 0.02197135511215772 * a[11];  // Ia12
}

// Writes friction that grows with load of all joints.
inline void load_friction(const double* v, const double* load, double* effort) noexcept {
  (void)v;
  (void)load;
  effort[0] = 0.0;
  effort[1] = 0.0;
  effort[2] = 0.0;
  effort[3] = 0.0;
  effort[4] = 0.0;
  effort[5] = 0.0;
  effort[6] = 0.0;
  effort[7] = 0.0;
  effort[8] = 0.0;
  effort[9] = 0.0;
  effort[10] = 0.0;
  effort[11] = 0.0;
}

}  // namespace SDPID_FRICTION_NAMESPACE
#undef SDPID_FRICTION_NAMESPACE

// sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.3.0", "certificate": null, "robot": "go2_description", "joints": ["FL_hip_joint", "FL_thigh_joint", "FL_calf_joint", "FR_hip_joint", "FR_thigh_joint", "FR_calf_joint", "RL_hip_joint", "RL_thigh_joint", "RL_calf_joint", "RR_hip_joint", "RR_thigh_joint", "RR_calf_joint"], "terms": [{"term": "Coulomb", "width": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [0.31960611395620936, 0.18621666426670544, 0.9770824384061414, 0.1844181755665087, 0.18967784507574997, 0.6446502902536357, 0.158560413340505, 0.148727691078564, 1.3693388277275922, 0.22638516435254977, 0.2690865117037735, 0.8142550282451764]}, {"term": "Viscous", "values": [0.0, 0.15691323226793874, 0.02925448745997778, 0.18824069187296621, 0.08316074530370576, 0.0003161064759372844, 0.10289728374263898, 0.11955137283846473, 0.0, 0.12095702560032448, 0.08715830138684012, 0.012821209821002945]}, {"term": "RotorInertia", "values": [1.8377807096188814e-09, 0.0, 0.02460906585825924, 0.0, 0.018135787977185173, 0.021012889542995756, 0.0, 0.009096593300170592, 0.020457864057291313, 0.0, 0.0036864218369458087, 0.02197135511215772]}], "left_out": []}

#endif  // SDPID_FRICTION_EFC0688FC76B6C43
