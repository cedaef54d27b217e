// Joint friction as sdpid identified it; made by a program, not to be edited.
//
// To be added to the efforts of the rigid links, such as those of the URDF beside it.
// Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
// m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.
//
// Arrays have one entry a joint, in the order of joint_names; `effort` must not
// overlap the others. For C++11 and later.
#ifndef SDPID_FRICTION_CF8A24E1AB71E303
#define SDPID_FRICTION_CF8A24E1AB71E303

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
      + 0.319606121249346 * detail::sign(v[0]);  // Fs1
  effort[1] = 0.0
      + 0.18621668657531382 * detail::sign(v[1])  // Fs2
      + 0.15691320644327242 * v[1];  // Fv2
  effort[2] = 0.0
      + 0.977082431062875 * detail::sign(v[2])  // Fs3
      + 0.029254511012514032 * v[2];  // Fv3
  effort[3] = 0.0
      + 0.18441811935186797 * detail::sign(v[3])  // Fs4
      + 0.18824083663271185 * v[3];  // Fv4
  effort[4] = 0.0
      + 0.1896778464383232 * detail::sign(v[4])  // Fs5
      + 0.08316075863831293 * v[4];  // Fv5
  effort[5] = 0.0
      + 0.6446502926129982 * detail::sign(v[5])  // Fs6
      + 0.0003161201208082892 * v[5];  // Fv6
  effort[6] = 0.0
      + 0.1585604245384029 * detail::sign(v[6])  // Fs7
      + 0.10289727519330298 * v[6];  // Fv7
  effort[7] = 0.0
      + 0.1487276950483451 * detail::sign(v[7])  // Fs8
      + 0.11955138190124737 * v[7];  // Fv8
  effort[8] = 0.0
      + 1.369338842588392 * detail::sign(v[8]);  // Fs9
  effort[9] = 0.0
      + 0.22638514692460537 * detail::sign(v[9])  // Fs10
      + 0.12095707997576555 * v[9];  // Fv10
  effort[10] = 0.0
      + 0.2690865008183077 * detail::sign(v[10])  // Fs11
      + 0.08715833796353159 * v[10];  // Fv11
  effort[11] = 0.0
      + 0.8142550245811224 * detail::sign(v[11])  // Fs12
      + 0.012821230084205978 * v[11];  // Fv12
}

// Writes the efforts that accelerate the rotors of all joints.
inline void drive_inertia(const double* a, double* effort) noexcept {
  effort[0] = 0.0
      + 1.8395266852450394e-09 * a[0];  // Ia1
  effort[1] = 0.0;
  effort[2] = 0.0
      + 0.02460906731546353 * a[2];  // Ia3
  effort[3] = 0.0;
  effort[4] = 0.0
      + 0.018135787381977134 * a[4];  // Ia5
  effort[5] = 0.0
      + 0.02101289168586064 * a[5];  // Ia6
  effort[6] = 0.0;
  effort[7] = 0.0
      + 0.009096595484036447 * a[7];  // Ia8
  effort[8] = 0.0
      + 0.02045786533474168 * a[8];  // Ia9
  effort[9] = 0.0;
  effort[10] = 0.0
      + 0.0036864207309337976 * a[10];  // Ia11
  effort[11] = 0.0
      + 0.0219713568031612 * a[11];  // Ia12
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

// sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.1.0", "certificate": null, "robot": "go2_description", "joints": ["FL_hip_joint", "FL_thigh_joint", "FL_calf_joint", "FR_hip_joint", "FR_thigh_joint", "FR_calf_joint", "RL_hip_joint", "RL_thigh_joint", "RL_calf_joint", "RR_hip_joint", "RR_thigh_joint", "RR_calf_joint"], "terms": [{"term": "Coulomb", "width": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [0.319606121249346, 0.18621668657531382, 0.977082431062875, 0.18441811935186797, 0.1896778464383232, 0.6446502926129982, 0.1585604245384029, 0.1487276950483451, 1.369338842588392, 0.22638514692460537, 0.2690865008183077, 0.8142550245811224]}, {"term": "Viscous", "values": [0.0, 0.15691320644327242, 0.029254511012514032, 0.18824083663271185, 0.08316075863831293, 0.0003161201208082892, 0.10289727519330298, 0.11955138190124737, 0.0, 0.12095707997576555, 0.08715833796353159, 0.012821230084205978]}, {"term": "RotorInertia", "values": [1.8395266852450394e-09, 0.0, 0.02460906731546353, 0.0, 0.018135787381977134, 0.02101289168586064, 0.0, 0.009096595484036447, 0.02045786533474168, 0.0, 0.0036864207309337976, 0.0219713568031612]}], "left_out": []}

#endif  // SDPID_FRICTION_CF8A24E1AB71E303
