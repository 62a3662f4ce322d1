#pragma once

#include <string>
#include <vector>

#include "description.hpp"

// Each function returns casadi::Function::serialize() of a graph in Pinocchio's
// conventions. `reference` is "world_aligned", "local" or "world".
namespace trajopt {

// (q, v, a, w) -> (tau, rotation, position, velocity, acceleration), one column per frame.
std::string fused(const Description& description, const std::vector<Frame>& frames);

std::string rnea(const Description& description);           // (q, v, a) -> tau
std::string bias_forces(const Description& description);    // (q, v) -> h
std::string mass_matrix(const Description& description);    // q -> M

std::string frame_placement(const Description& description, const Frame& frame);  // q -> (R, p)
std::string frame_velocity(const Description& description, const Frame& frame,
                           const std::string& reference);  // (q, v) -> velocity
std::string frame_acceleration(const Description& description, const Frame& frame,
                               const std::string& reference);  // (q, v, a) -> acceleration

std::string centre_of_mass(const Description& description);          // (q, v) -> (c, dc)
std::string centroidal_momentum(const Description& description);     // (q, v) -> h
std::string centroidal_momentum_rate(const Description& description);  // (q, v, a) -> (h, dh)
std::string kinetic_energy(const Description& description);          // (q, v) -> energy, without rotors
std::string potential_energy(const Description& description);        // q -> energy

}  // namespace trajopt
