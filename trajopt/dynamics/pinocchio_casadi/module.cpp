#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "functions.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace trajopt;

namespace {

void bind_description(nb::module_& module) {
  nb::class_<Joint>(module, "Joint")
      .def(nb::init<>())
      .def_rw("name", &Joint::name)
      .def_rw("kind", &Joint::kind)
      .def_rw("parent", &Joint::parent)
      .def_rw("rotation", &Joint::rotation)
      .def_rw("translation", &Joint::translation)
      .def_rw("axis", &Joint::axis)
      .def_rw("mass", &Joint::mass)
      .def_rw("lever", &Joint::lever)
      .def_rw("inertia", &Joint::inertia);
  nb::class_<Frame>(module, "Frame")
      .def(nb::init<>())
      .def_rw("joint", &Frame::joint)
      .def_rw("rotation", &Frame::rotation)
      .def_rw("translation", &Frame::translation)
      .def_rw("wrench_size", &Frame::wrench_size);
  nb::class_<Description>(module, "Description")
      .def(nb::init<>())
      .def_rw("joints", &Description::joints)
      .def_rw("armature", &Description::armature)
      .def_rw("gravity", &Description::gravity);
}

}  // namespace

NB_MODULE(_pinocchio, module) {
  module.doc() = "Pinocchio's algorithms on casadi::SX, returned as serialised casadi functions.";
  bind_description(module);
  module.def("fused", &fused, "description"_a, "frames"_a);
  module.def("rnea", &rnea, "description"_a);
  module.def("bias_forces", &bias_forces, "description"_a);
  module.def("mass_matrix", &mass_matrix, "description"_a);
  module.def("frame_placement", &frame_placement, "description"_a, "frame"_a);
  module.def("frame_velocity", &frame_velocity, "description"_a, "frame"_a, "reference"_a);
  module.def("frame_acceleration", &frame_acceleration, "description"_a, "frame"_a, "reference"_a);
  module.def("centre_of_mass", &centre_of_mass, "description"_a);
  module.def("centroidal_momentum", &centroidal_momentum, "description"_a);
  module.def("centroidal_momentum_rate", &centroidal_momentum_rate, "description"_a);
  module.def("kinetic_energy", &kinetic_energy, "description"_a);
  module.def("potential_energy", &potential_energy, "description"_a);
}
