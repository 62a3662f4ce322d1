// From Python's keyword arguments to a Problem, with every size and index checked.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <string>

#include "engine.hpp"
#include "require.hpp"

namespace trajopt {

using RealArray = nanobind::ndarray<const double, nanobind::c_contig, nanobind::device::cpu>;
using IndexArray = nanobind::ndarray<const int, nanobind::c_contig, nanobind::device::cpu>;

Reals reals(const RealArray& array);
Indices indices(const IndexArray& array);

Problem read_problem(const nanobind::kwargs& given);

}  // namespace trajopt
