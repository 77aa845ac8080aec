#include "sim/material.h"

#include <cstdio>

namespace crumple {
namespace {

struct Range {
  const char* name;
  float Material::*field;
  float low, high;
  const char* unit;
};
constexpr Range ranges[] = {
    {"young_modulus", &Material::young_modulus, 1e4f, 1e10f, " Pa"},
    {"poisson_ratio", &Material::poisson_ratio, 0, 0.45f, ""},
    {"yield", &Material::yield, 0, 1, ""},
    {"hardening", &Material::hardening, 0, 1, ""},
    {"plastic_limit", &Material::plastic_limit, 0, 3, ""},
    {"viscosity", &Material::viscosity, 0, 1e9f, " N s/m^4"},
    {"distance_stiffness", &Material::distance_stiffness, 0, 1, ""},
    {"volume_stiffness", &Material::volume_stiffness, 0, 1, ""},
    {"plasticity", &Material::plasticity, 0, 1, ""},
};

}  // namespace

std::optional<std::string> out_of_range(const Parameters& parameters) {
  if (parameters.iterations < 1 || parameters.iterations > 1000) {
    return "iterations is " + std::to_string(parameters.iterations) + "; allowed are 1 to 1000";
  }
  if (!(parameters.tolerance >= 0 && parameters.tolerance <= 0.1f)) {
    return "tolerance is " + std::to_string(parameters.tolerance) + " m; allowed are 0 to 0.1 m";
  }
  if (parameters.substeps < 1 || parameters.substeps > 64) {
    return "substeps is " + std::to_string(parameters.substeps) + "; allowed are 1 to 64";
  }
  for (int region = 0; region < region_limit; ++region) {
    for (const Range& range : ranges) {
      const float value = parameters.region[region].*range.field;
      if (value >= range.low && value <= range.high) continue;  // false for NaN too
      char text[160];
      std::snprintf(text, sizeof text, "%s of region %d is %g%s; allowed are %g to %g%s", range.name, region, double(value),
                    range.unit, double(range.low), double(range.high), range.unit);
      return text;
    }
  }
  return std::nullopt;
}

}  // namespace crumple
