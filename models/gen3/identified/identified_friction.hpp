// Joint friction as sdpid identified it; made by a program, not to be edited.
//
// To be added to the efforts of the rigid links, such as those of the URDF beside it.
// Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
// m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.
//
// Arrays have one entry a joint, in the order of joint_names; `effort` must not
// overlap the others. For C++11 and later.
#ifndef SDPID_FRICTION_E57E7503DEAC4718
#define SDPID_FRICTION_E57E7503DEAC4718

#include <cmath>

// Define another name where the headers of several robots are included.
#ifndef SDPID_FRICTION_NAMESPACE
#define SDPID_FRICTION_NAMESPACE identified_friction
#endif

namespace SDPID_FRICTION_NAMESPACE {

constexpr int joints = 7;
constexpr const char* robot = "kinova_gen3";
constexpr const char* certificate = "25a52d8e992ef0b35de87795feb21ddb9c4d70bde63cddb41da826a22f70f90a";
constexpr const char* joint_names[joints] = {
    "joint_1",
    "joint_2",
    "joint_3",
    "joint_4",
    "joint_5",
    "joint_6",
    "joint_7",
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
      + 0.0804149001603478 * detail::tanh(v[0] / 0.005)  // Fs1
      + 0.1560176490859308 * detail::tanh(v[0] / 0.02)  // Fsg1
      + 0.40286585654030366 * v[0]  // Fv1
      + 0.5220668545769029;  // Fo1
  effort[1] = 0.0
      + 1.029178270384179e-10 * detail::tanh(v[1] / 0.005)  // Fs2
      + 2.2755103310372635 * detail::tanh(v[1] / 0.311313249580415)  // Fsg2
      + 0.002327046654935952 * v[1]  // Fv2
      + -0.06635908030075847;  // Fo2
  effort[2] = 0.0
      + 0.02478122160046342 * detail::tanh(v[2] / 0.005)  // Fs3
      + 0.27088699939798544 * detail::tanh(v[2] / 0.02)  // Fsg3
      + 1.1140949274235368e-12 * v[2]  // Fv3
      + -0.2249470943241812;  // Fo3
  effort[3] = 0.0
      + 0.8412210664466366 * detail::tanh(v[3] / 0.005)  // Fs4
      + 0.48214272920155277 * detail::tanh(v[3] / 0.41493739250423495)  // Fsg4
      + 1.6006085346020882e-12 * v[3]  // Fv4
      + 0.12979018117444588;  // Fo4
  effort[4] = 0.0
      + 0.19909398315044124 * detail::tanh(v[4] / 0.005)  // Fs5
      + 0.1582406457624259 * detail::tanh(v[4] / 0.42460641281359096)  // Fsg5
      + 0.026706429545298567 * v[4]  // Fv5
      + 0.1994610350194971;  // Fo5
  effort[5] = 0.0
      + 0.20108925486390242 * detail::tanh(v[5] / 0.005)  // Fs6
      + 0.1509176353506554 * detail::tanh(v[5] / 0.15416948072218914)  // Fsg6
      + 4.657294341847695e-11 * v[5]  // Fv6
      + 0.16768414608933388;  // Fo6
  effort[6] = 0.0
      + 0.08046662930713357 * detail::tanh(v[6] / 0.005)  // Fs7
      + 0.14108945604912743 * detail::tanh(v[6] / 0.02)  // Fsg7
      + 0.10537382025416218 * v[6]  // Fv7
      + 0.16319024449648864;  // Fo7
}

// Writes the efforts that accelerate the rotors of all joints.
inline void drive_inertia(const double* a, double* effort) noexcept {
  (void)a;
  effort[0] = 0.0;
  effort[1] = 0.0;
  effort[2] = 0.0;
  effort[3] = 0.0;
  effort[4] = 0.0;
  effort[5] = 0.0;
  effort[6] = 0.0;
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
}

}  // namespace SDPID_FRICTION_NAMESPACE
#undef SDPID_FRICTION_NAMESPACE

// sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.3.0", "certificate": "25a52d8e992ef0b35de87795feb21ddb9c4d70bde63cddb41da826a22f70f90a", "robot": "kinova_gen3", "joints": ["joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6", "joint_7"], "terms": [{"term": "Coulomb", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [0.0804149001603478, 1.029178270384179e-10, 0.02478122160046342, 0.8412210664466366, 0.19909398315044124, 0.20108925486390242, 0.08046662930713357]}, {"term": "SigmoidFriction", "velocity": [0.02, 0.311313249580415, 0.02, 0.41493739250423495, 0.42460641281359096, 0.15416948072218914, 0.02], "values": [0.1560176490859308, 2.2755103310372635, 0.27088699939798544, 0.48214272920155277, 0.1582406457624259, 0.1509176353506554, 0.14108945604912743]}, {"term": "Viscous", "values": [0.40286585654030366, 0.002327046654935952, 1.1140949274235368e-12, 1.6006085346020882e-12, 0.026706429545298567, 4.657294341847695e-11, 0.10537382025416218]}, {"term": "Offset", "values": [0.5220668545769029, -0.06635908030075847, -0.2249470943241812, 0.12979018117444588, 0.1994610350194971, 0.16768414608933388, 0.16319024449648864]}], "left_out": []}

#endif  // SDPID_FRICTION_E57E7503DEAC4718
