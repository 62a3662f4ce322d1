#pragma once

#include <array>
#include <string>
#include <vector>

namespace trajopt {

// A numeric model as plain data; matrices are row-major, SI units, Pinocchio's
// joint frames. Joint 0 is the universe and is not listed.
struct Joint {
  std::string name;
  std::string kind;                    // Pinocchio's shortname without "JointModel"
  int parent;
  std::array<double, 9> rotation;      // placement in the parent joint's frame
  std::array<double, 3> translation;
  std::array<double, 3> axis;          // of unaligned joints
  double mass;
  std::array<double, 3> lever;
  std::array<double, 9> inertia;       // about the centre of mass
};

struct Frame {
  int joint = 0;
  std::array<double, 9> rotation;
  std::array<double, 3> translation;
  int wrench_size = 0;                     // 0, 3 (force) or 6 (force, moment)
};

struct Description {
  std::vector<Joint> joints;
  std::vector<double> armature;
  std::array<double, 3> gravity;
};

}  // namespace trajopt
