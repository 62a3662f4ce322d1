// What an object of Python's wrappers of Pinocchio and Coal holds.
#pragma once

#include <nanobind/nanobind.h>

#include <boost/python/converter/from_python.hpp>
#include <boost/python/converter/registry.hpp>
#include <boost/python/type_id.hpp>

#include <string>

template <class Held>
Held& held_by(const nanobind::object& object, const char* expected) {
  namespace converter = boost::python::converter;
  const auto* registration = converter::registry::query(boost::python::type_id<Held>());
  void* held = registration ? converter::get_lvalue_from_python(object.ptr(), *registration) : nullptr;
  if (held == nullptr) throw nanobind::type_error((std::string("a ") + expected + " is needed").c_str());
  return *static_cast<Held*>(held);
}
