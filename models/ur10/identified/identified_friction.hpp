// Joint friction as sdpid identified it; made by a program, not to be edited.
//
// To be added to the efforts of the rigid links, such as those of the URDF beside it.
// Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
// m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.
//
// Arrays have one entry a joint, in the order of joint_names; `effort` must not
// overlap the others. For C++11 and later.
#ifndef SDPID_FRICTION_26D97DF617F0C7B4
#define SDPID_FRICTION_26D97DF617F0C7B4

#include <cmath>

// Define another name where the headers of several robots are included.
#ifndef SDPID_FRICTION_NAMESPACE
#define SDPID_FRICTION_NAMESPACE identified_friction
#endif

namespace SDPID_FRICTION_NAMESPACE {

constexpr int joints = 6;
constexpr const char* robot = "ur10";
constexpr const char* certificate = "5207c97515382abc4b7205836cde13e4add2521d28fd1055303ef3cc0f03aa95";
constexpr const char* joint_names[joints] = {
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
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
      + 1.9539925233402755e-14 * detail::tanh(v[0] / 0.005)  // Fs1
      + 15.74269119659734 * detail::tanh(v[0] / 0.0870973192499724)  // Fsg1
      + 14.44960368891217 * v[0]  // Fv1
      + 0.4662608355492981;  // Fo1
  effort[1] = 0.0
      + 7.815970093361102e-14 * detail::tanh(v[1] / 0.005)  // Fs2
      + 12.952539032810641 * detail::tanh(v[1] / 0.02)  // Fsg2
      + 20.518343339659744 * v[1]  // Fv2
      + -0.22087575060763462;  // Fo2
  effort[2] = 0.0
      + 5.876784240170379 * detail::tanh(v[2] / 0.005)  // Fs3
      + 9.14384647679118 * detail::tanh(v[2] / 0.832980213218481)  // Fsg3
      + 3.730973001347937 * v[2]  // Fv3
      + 0.03444750154657844;  // Fo3
  effort[3] = 0.0
      + 0.0078584271310819 * detail::tanh(v[3] / 0.005)  // Fs4
      + 3.2623814755908436 * detail::tanh(v[3] / 0.0699929179522325)  // Fsg4
      + 2.8619825733361424 * v[3]  // Fv4
      + 0.7065930417300571;  // Fo4
  effort[4] = 0.0
      + 2.1938006966593093e-13 * detail::tanh(v[4] / 0.005)  // Fs5
      + 2.581708814103794 * detail::tanh(v[4] / 0.02)  // Fsg5
      + 2.832138892242164 * v[4]  // Fv5
      + 0.8696538125115071;  // Fo5
  effort[5] = 0.0
      + 5.619726906047617e-12 * detail::tanh(v[5] / 0.005)  // Fs6
      + 3.013739996288767 * detail::tanh(v[5] / 0.029754316802776255)  // Fsg6
      + 2.944901585877908 * v[5]  // Fv6
      + 0.8656906589990455;  // Fo6
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
}

// Writes friction that grows with load of all joints.
inline void load_friction(const double* v, const double* load, double* effort) noexcept {
  effort[0] = 0.0
      + 1.8758432307475204e-14 * detail::size(load[0]) * (6.661338147750939e-16 * detail::tanh(v[0] / 0.005) + 0.9999999999999993 * detail::tanh(v[0] / 0.0870973192499724));  // Fl1
  effort[1] = 0.0
      + 0.045154301301681916 * detail::size(load[1]) * (3.885780586188048e-15 * detail::tanh(v[1] / 0.005) + 0.9999999999999961 * detail::tanh(v[1] / 0.02));  // Fl2
  effort[2] = 0.0
      + 0.027736649696259816 * detail::size(load[2]) * (0.39123285956805187 * detail::tanh(v[2] / 0.005) + 0.6087671404319481 * detail::tanh(v[2] / 0.832980213218481));  // Fl3
  effort[3] = 0.0
      + 0.04652820552163365 * detail::size(load[3]) * (0.002240262586509889 * detail::tanh(v[3] / 0.005) + 0.9977597374134901 * detail::tanh(v[3] / 0.0699929179522325));  // Fl4
  effort[4] = 0.0
      + 7.253993098473716e-11 * detail::size(load[4]) * (5.417888360170764e-14 * detail::tanh(v[4] / 0.005) + 0.9999999999999458 * detail::tanh(v[4] / 0.02));  // Fl5
  effort[5] = 0.0
      + 0.00027414209758890555 * detail::size(load[5]) * (1.1767253838002034e-12 * detail::tanh(v[5] / 0.005) + 0.9999999999988233 * detail::tanh(v[5] / 0.029754316802776255));  // Fl6
}

}  // namespace SDPID_FRICTION_NAMESPACE
#undef SDPID_FRICTION_NAMESPACE

// sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.3.0", "certificate": "5207c97515382abc4b7205836cde13e4add2521d28fd1055303ef3cc0f03aa95", "robot": "ur10", "joints": ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"], "terms": [{"term": "Coulomb", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [1.9539925233402755e-14, 7.815970093361102e-14, 5.876784240170379, 0.0078584271310819, 2.1938006966593093e-13, 5.619726906047617e-12]}, {"term": "SigmoidFriction", "velocity": [0.0870973192499724, 0.02, 0.832980213218481, 0.0699929179522325, 0.02, 0.029754316802776255], "values": [15.74269119659734, 12.952539032810641, 9.14384647679118, 3.2623814755908436, 2.581708814103794, 3.013739996288767]}, {"term": "Viscous", "values": [14.44960368891217, 20.518343339659744, 3.730973001347937, 2.8619825733361424, 2.832138892242164, 2.944901585877908]}, {"term": "Offset", "values": [0.4662608355492981, -0.22087575060763462, 0.03444750154657844, 0.7065930417300571, 0.8696538125115071, 0.8656906589990455]}, {"term": "LoadFriction", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "share": [0.9999999999999993, 0.9999999999999961, 0.6087671404319481, 0.9977597374134901, 0.9999999999999458, 0.9999999999988233], "velocity": [0.0870973192499724, 0.02, 0.832980213218481, 0.0699929179522325, 0.02, 0.029754316802776255], "values": [1.8758432307475204e-14, 0.045154301301681916, 0.027736649696259816, 0.04652820552163365, 7.253993098473716e-11, 0.00027414209758890555]}], "left_out": []}

#endif  // SDPID_FRICTION_26D97DF617F0C7B4
