#pragma once

#include <vector>

#include "model.hpp"

namespace trajopt {

using Forces = std::vector<Model::Force>;

// Pinocchio's Newton-Euler algorithm in its two halves, so that the wrenches
// given in world axes can use the placements of the forward half.

// Fills liMi, oMi, v, a_gf (gravity included), a (gravity excluded), h, f.
void forward_pass(const Model& model, Data& data, const Vector& q, const Vector& v, const Vector& a);

// Generalised forces (nv), with `external` subtracted: one force per joint, in its frame.
Vector backward_pass(const Model& model, Data& data, const Vector& a, const Forces& external);

}  // namespace trajopt
