#include <pinocchio/autodiff/casadi.hpp>
#include <pinocchio/algorithm/center-of-mass.hpp>
#include <pinocchio/algorithm/centroidal.hpp>
#include <pinocchio/algorithm/energy.hpp>

#include "functions.hpp"
#include "motion.hpp"

namespace trajopt {

std::string centre_of_mass(const Description& description) {
  Motion motion(description, Motion::velocity);
  pinocchio::centerOfMass(motion.model, motion.data, pinocchio::VELOCITY, false);
  return function("centre_of_mass", motion, Motion::velocity,
                  {dense(motion.data.com[0]), dense(motion.data.vcom[0])}, {"c", "dc"});
}

std::string centroidal_momentum(const Description& description) {
  Motion motion(description, Motion::velocity);
  pinocchio::computeCentroidalMomentum(motion.model, motion.data);
  return function("centroidal_momentum", motion, Motion::velocity,
                  {dense(motion.data.hg.toVector())}, {"h"});
}

std::string centroidal_momentum_rate(const Description& description) {
  Motion motion(description, Motion::acceleration);
  pinocchio::computeCentroidalMomentumTimeVariation(motion.model, motion.data);
  return function("centroidal_momentum_rate", motion, Motion::acceleration,
                  {dense(motion.data.hg.toVector()), dense(motion.data.dhg.toVector())},
                  {"h", "dh"});
}

std::string kinetic_energy(const Description& description) {
  Motion motion(description, Motion::velocity);
  const Scalar energy = pinocchio::computeKineticEnergy(motion.model, motion.data);
  return function("kinetic_energy", motion, Motion::velocity, {energy}, {"energy"});
}

std::string potential_energy(const Description& description) {
  Motion motion(description, Motion::position);
  const Scalar energy = pinocchio::computePotentialEnergy(motion.model, motion.data);
  return function("potential_energy", motion, Motion::position, {energy}, {"energy"});
}

}  // namespace trajopt
