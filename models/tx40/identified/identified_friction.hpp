// Joint friction as sdpid identified it; made by a program, not to be edited.
//
// To be added to the efforts of the rigid links, such as those of the URDF beside it.
// Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
// m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.
//
// Arrays have one entry a joint, in the order of joint_names; `effort` must not
// overlap the others. For C++11 and later.
#ifndef SDPID_FRICTION_0BD92EAE60906453
#define SDPID_FRICTION_0BD92EAE60906453

#include <cmath>

// Define another name where the headers of several robots are included.
#ifndef SDPID_FRICTION_NAMESPACE
#define SDPID_FRICTION_NAMESPACE identified_friction
#endif

namespace SDPID_FRICTION_NAMESPACE {

constexpr int joints = 6;
constexpr const char* robot = "staubli_tx40";
constexpr const char* certificate = "8ffe38f50e0592a06d98a3b20eb2151e092d17b6ac81675872301cafecd1a95d";
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
      + 4.231193362098112 * detail::tanh(v[0] / 0.005)  // Fs1
      + 5.3450189211317065 * detail::tanh(v[0] / 1.0922320924812805)  // Fsg1
      + 7.4428790519947325 * v[0]  // Fv1
      + 0.3460993557875489;  // Fo1
  effort[1] = 0.0
      + 5.333234457284048 * detail::tanh(v[1] / 0.005)  // Fs2
      + 5.582840527625374 * detail::tanh(v[1] / 0.9811195432836913)  // Fsg2
      + 4.822032972829961 * v[1]  // Fv2
      + 0.5325642071639707;  // Fo2
  effort[2] = 0.0
      + 3.4368517786871884 * detail::tanh(v[2] / 0.005)  // Fs3
      + 3.0779987628972827 * detail::tanh(v[2] / 0.9556285349452571)  // Fsg3
      + 1.6322025819425392 * v[2]  // Fv3
      + 0.49678977240716415;  // Fo3
  effort[3] = 0.0
      + 2.0684403486328984 * detail::tanh(v[3] / 0.005)  // Fs4
      + 1.968107577241302 * detail::tanh(v[3] / 2.6075875794040315)  // Fsg4
      + 0.8112807354203406 * v[3]  // Fv4
      + -0.1397082494106187;  // Fo4
  effort[4] = 0.0
      + 2.661836062873621 * detail::tanh(v[4] / 0.005)  // Fs5
      + 3.976673384656382 * detail::tanh(v[4] / 2.797743719083409)  // Fsg5
      + 1.1157220965938595 * v[4]  // Fv5
      + 0.020262763480697544  // Fo5
      + 0.5335291226632931 * v[5]  // Fv5_6
      + 2.0648134900220536 * detail::tanh((v[4] + v[5]) / 0.005);  // Fs5_6
  effort[5] = 0.0
      + 2.5208612974836342e-11 * detail::tanh(v[5] / 0.005)  // Fs6
      + 1.4732727399399481 * detail::tanh(v[5] / 2.7358586425950993)  // Fsg6
      + 0.49513544430191714 * v[5]  // Fv6
      + 0.20942900078120474  // Fo6
      + 0.5335291226632931 * v[4]  // Fv5_6
      + 2.0648134900220536 * detail::tanh((v[4] + v[5]) / 0.005);  // Fs5_6
}

// Writes the efforts that accelerate the rotors of all joints.
inline void drive_inertia(const double* a, double* effort) noexcept {
  effort[0] = 0.0
      + 0.6393155322138664 * a[0];  // Ia1
  effort[1] = 0.0
      + 0.6115463936612079 * a[1];  // Ia2
  effort[2] = 0.0
      + 0.09125178821674022 * a[2];  // Ia3
  effort[3] = 0.0
      + 0.02890862368141777 * a[3];  // Ia4
  effort[4] = 0.0
      + 0.050703134604503014 * a[4]  // Ia5
      + 0.008801142320566786 * a[5];  // Ia5_6
  effort[5] = 0.0
      + 0.012334192417319116 * a[5]  // Ia6
      + 0.008801142320566786 * a[4];  // Ia5_6
}

// Writes friction that grows with load of all joints.
inline void load_friction(const double* v, const double* load, double* effort) noexcept {
  effort[0] = 0.0
      + 0.04106718550152296 * detail::size(load[0]) * (0.4418657628729823 * detail::tanh(v[0] / 0.005) + 0.5581342371270177 * detail::tanh(v[0] / 1.0922320924812805));  // Fl1
  effort[1] = 0.0
      + 0.0029606072743580676 * detail::size(load[1]) * (0.4886601258572991 * detail::tanh(v[1] / 0.005) + 0.5113398741427009 * detail::tanh(v[1] / 0.9811195432836913));  // Fl2
  effort[2] = 0.0
      + 0.3050661492961649 * detail::size(load[2]) * (0.528384613063084 * detail::tanh(v[2] / 0.005) + 0.47161538693691596 * detail::tanh(v[2] / 0.9556285349452571));  // Fl3
  effort[3] = 0.0
      + 0.01717015522087916 * detail::size(load[3]) * (0.5124302574581112 * detail::tanh(v[3] / 0.005) + 0.4875697425418888 * detail::tanh(v[3] / 2.6075875794040315));  // Fl4
  effort[4] = 0.0
      + 2.4181837608716616e-10 * detail::size(load[4]) * (0.40095855391815804 * detail::tanh(v[4] / 0.005) + 0.599041446081842 * detail::tanh(v[4] / 2.797743719083409));  // Fl5
  effort[5] = 0.0
      + 0.00020367329648636036 * detail::size(load[5]) * (1.6335488517427166e-11 * detail::tanh(v[5] / 0.005) + 0.9999999999836645 * detail::tanh(v[5] / 2.7358586425950993));  // Fl6
}

}  // namespace SDPID_FRICTION_NAMESPACE
#undef SDPID_FRICTION_NAMESPACE

// sdpid-friction: {"schema": "sdpid-friction", "version": 1, "software": "sdpid 0.3.0", "certificate": "8ffe38f50e0592a06d98a3b20eb2151e092d17b6ac81675872301cafecd1a95d", "robot": "staubli_tx40", "joints": ["joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"], "terms": [{"term": "Coulomb", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "dead_zone": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "values": [4.231193362098112, 5.333234457284048, 3.4368517786871884, 2.0684403486328984, 2.661836062873621, 2.5208612974836342e-11]}, {"term": "SigmoidFriction", "velocity": [1.0922320924812805, 0.9811195432836913, 0.9556285349452571, 2.6075875794040315, 2.797743719083409, 2.7358586425950993], "values": [5.3450189211317065, 5.582840527625374, 3.0779987628972827, 1.968107577241302, 3.976673384656382, 1.4732727399399481]}, {"term": "Viscous", "values": [7.4428790519947325, 4.822032972829961, 1.6322025819425392, 0.8112807354203406, 1.1157220965938595, 0.49513544430191714]}, {"term": "Offset", "values": [0.3460993557875489, 0.5325642071639707, 0.49678977240716415, -0.1397082494106187, 0.020262763480697544, 0.20942900078120474]}, {"term": "RotorInertia", "values": [0.6393155322138664, 0.6115463936612079, 0.09125178821674022, 0.02890862368141777, 0.050703134604503014, 0.012334192417319116]}, {"term": "Coupling", "joints": [4, 5], "width": [0.005], "values": [0.008801142320566786, 0.5335291226632931, 2.0648134900220536]}, {"term": "LoadFriction", "width": [0.005, 0.005, 0.005, 0.005, 0.005, 0.005], "share": [0.5581342371270177, 0.5113398741427009, 0.47161538693691596, 0.4875697425418888, 0.599041446081842, 0.9999999999836645], "velocity": [1.0922320924812805, 0.9811195432836913, 0.9556285349452571, 2.6075875794040315, 2.797743719083409, 2.7358586425950993], "values": [0.04106718550152296, 0.0029606072743580676, 0.3050661492961649, 0.01717015522087916, 2.4181837608716616e-10, 0.00020367329648636036]}], "left_out": []}

#endif  // SDPID_FRICTION_0BD92EAE60906453
