// Joint friction as sdpid identified it; made by a program, not to be edited.
//
// To be added to the efforts of the rigid links, such as those of the URDF beside it.
// Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
// m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.
//
// Arrays have one entry a joint, in the order of joint_names; `effort` must not
// overlap the others. For C++11 and later.
#ifndef SDPID_FRICTION_37AB4EC0733DEBF6
#define SDPID_FRICTION_37AB4EC0733DEBF6

#include <cmath>

// Define another name where the headers of several robots are included.
#ifndef SDPID_FRICTION_NAMESPACE
#define SDPID_FRICTION_NAMESPACE identified_friction
#endif

namespace SDPID_FRICTION_NAMESPACE {

constexpr int joints = 6;
constexpr const char* robot = "staubli_tx40";
constexpr const char* certificate = "3a74b3400310f43bdedeb78cd6b6e121d82ff77eac314d1ced5e5066b6a940eb";
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
      + 4.231193362098226 * detail::tanh(v[0] / 0.005)  // Fs1
      + 5.345018921133522 * detail::tanh(v[0] / 1.0922320924812805)  // Fsg1
      + 7.442879051994338 * v[0]  // Fv1
      + 0.34609935578733303;  // Fo1
  effort[1] = 0.0
      + 5.33323445728492 * detail::tanh(v[1] / 0.005)  // Fs2
      + 5.5828405276254935 * detail::tanh(v[1] / 0.9811195432836913)  // Fsg2
      + 4.822032972830352 * v[1]  // Fv2
      + 0.5325642071792244;  // Fo2
  effort[2] = 0.0
      + 3.436851778687422 * detail::tanh(v[2] / 0.005)  // Fs3
      + 3.077998762900249 * detail::tanh(v[2] / 0.9556285349452571)  // Fsg3
      + 1.6322025819416328 * v[2]  // Fv3
      + 0.4967897724069618;  // Fo3
  effort[3] = 0.0
      + 2.0684403486330494 * detail::tanh(v[3] / 0.005)  // Fs4
      + 1.9681075772416197 * detail::tanh(v[3] / 2.6075875794040315)  // Fsg4
      + 0.8112807354202489 * v[3]  // Fv4
      + -0.13970824941057397;  // Fo4
  effort[4] = 0.0
      + 2.6618360628736406 * detail::tanh(v[4] / 0.005)  // Fs5
      + 3.9766733846566154 * detail::tanh(v[4] / 2.797743719083409)  // Fsg5
      + 1.1157220965938026 * v[4]  // Fv5
      + 0.020262763480709402  // Fo5
      + 0.5335291226632953 * v[5]  // Fv5_6
      + 2.0648134900220834 * detail::tanh((v[4] + v[5]) / 0.005);  // Fs5_6
  effort[5] = 0.0
      + 2.518515257454723e-11 * detail::tanh(v[5] / 0.005)  // Fs6
      + 1.4732727399399892 * detail::tanh(v[5] / 2.7358586425950993)  // Fsg6
      + 0.4951354443019165 * v[5]  // Fv6
      + 0.20942900078123006  // Fo6
      + 0.5335291226632953 * v[4]  // Fv5_6
      + 2.0648134900220834 * detail::tanh((v[4] + v[5]) / 0.005);  // Fs5_6
}

// Writes the efforts that accelerate the rotors of all joints.
inline void drive_inertia(const double* a, double* effort) noexcept {
  effort[0] = 0.0
      + 0.639315532214414 * a[0];  // Ia1
  effort[1] = 0.0
      + 0.6115463936614968 * a[1];  // Ia2
  effort[2] = 0.0
      + 0.09125178821677644 * a[2];  // Ia3
  effort[3] = 0.0
      + 0.028908623681416893 * a[3];  // Ia4
  effort[4] = 0.0
      + 0.05070313460449973 * a[4]  // Ia5
      + 0.008801142320565673 * a[5];  // Ia5_6
  effort[5] = 0.0
      + 0.01233419241731998 * a[5]  // Ia6
      + 0.008801142320565673 * a[4];  // Ia5_6
}

// Writes friction that grows with load of all joints.
inline void load_friction(const double* v, const double* load, double* effort) noexcept {
  effort[0] = 0.0
      + 0.0410671855015285 * detail::size(load[0]) * (0.4418657628708209 * detail::tanh(v[0] / 0.005) + 0.5581342371291791 * detail::tanh(v[0] / 1.0922320924812805));  // Fl1
  effort[1] = 0.0
      + 0.0029606072742554995 * detail::size(load[1]) * (0.4886601258579307 * detail::tanh(v[1] / 0.005) + 0.5113398741420693 * detail::tanh(v[1] / 0.9811195432836913));  // Fl2
  effort[2] = 0.0
      + 0.3050661492963339 * detail::size(load[2]) * (0.528384613063301 * detail::tanh(v[2] / 0.005) + 0.471615386936699 * detail::tanh(v[2] / 0.9556285349452571));  // Fl3
  effort[3] = 0.0
      + 0.017170155220988276 * detail::size(load[3]) * (0.5124302574579979 * detail::tanh(v[3] / 0.005) + 0.48756974254200214 * detail::tanh(v[3] / 2.6075875794040315));  // Fl4
  effort[4] = 0.0
      + 2.41592432257548e-10 * detail::size(load[4]) * (0.40095855391795665 * detail::tanh(v[4] / 0.005) + 0.5990414460820433 * detail::tanh(v[4] / 2.797743719083409));  // Fl5
  effort[5] = 0.0
      + 0.00020367329313276497 * detail::size(load[5]) * (1.6298074001497298e-11 * detail::tanh(v[5] / 0.005) + 0.9999999999837019 * detail::tanh(v[5] / 2.7358586425950993));  // Fl6
}

}  // namespace SDPID_FRICTION_NAMESPACE
#undef SDPID_FRICTION_NAMESPACE

// sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.1.0", "certificate": "3a74b3400310f43bdedeb78cd6b6e121d82ff77eac314d1ced5e5066b6a940eb", "robot": "staubli_tx40", "joints": ["joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"], "terms": [{"term": "Coulomb", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [4.231193362098226, 5.33323445728492, 3.436851778687422, 2.0684403486330494, 2.6618360628736406, 2.518515257454723e-11]}, {"term": "SigmoidFriction", "velocity": [1.0922320924812805, 0.9811195432836913, 0.9556285349452571, 2.6075875794040315, 2.797743719083409, 2.7358586425950993], "values": [5.345018921133522, 5.5828405276254935, 3.077998762900249, 1.9681075772416197, 3.9766733846566154, 1.4732727399399892]}, {"term": "Viscous", "values": [7.442879051994338, 4.822032972830352, 1.6322025819416328, 0.8112807354202489, 1.1157220965938026, 0.4951354443019165]}, {"term": "Offset", "values": [0.34609935578733303, 0.5325642071792244, 0.4967897724069618, -0.13970824941057397, 0.020262763480709402, 0.20942900078123006]}, {"term": "RotorInertia", "values": [0.639315532214414, 0.6115463936614968, 0.09125178821677644, 0.028908623681416893, 0.05070313460449973, 0.01233419241731998]}, {"term": "Coupling", "joints": [4, 5], "width": [0.005], "values": [0.008801142320565673, 0.5335291226632953, 2.0648134900220834]}, {"term": "LoadFriction", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "share": [0.5581342371291791, 0.5113398741420693, 0.471615386936699, 0.48756974254200214, 0.5990414460820433, 0.9999999999837019], "velocity": [1.0922320924812805, 0.9811195432836913, 0.9556285349452571, 2.6075875794040315, 2.797743719083409, 2.7358586425950993], "values": [0.0410671855015285, 0.0029606072742554995, 0.3050661492963339, 0.017170155220988276, 2.41592432257548e-10, 0.00020367329313276497]}], "left_out": []}

#endif  // SDPID_FRICTION_37AB4EC0733DEBF6
