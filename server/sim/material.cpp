#include "sim/material.h"

#include <cstdio>

namespace crumple {
namespace {

template <auto Field>
float of_region(const Parameters& parameters, int region) {
  return parameters.region[size_t(region)].*Field;
}
template <auto Field>
float of_car(const Parameters& parameters, int) {
  return parameters.*Field;
}

constexpr Range ranges[] = {
    {"iterations", 1, 1000, "", false, true, of_car<&Parameters::iterations>},
    {"tolerance", 0, 0.1f, " m", false, false, of_car<&Parameters::tolerance>},
    {"substeps", 1, 64, "", false, true, of_car<&Parameters::substeps>},
    {"young_modulus", 1e4f, 1e10f, " Pa", true, false, of_region<&Material::young_modulus>},
    {"poisson_ratio", 0, 0.45f, "", true, false, of_region<&Material::poisson_ratio>},
    {"yield_strain", 0, 1, "", true, false, of_region<&Material::yield_strain>},
    {"hardening", 0, 1, "", true, false, of_region<&Material::hardening>},
    {"hardening_strain", 1e-3f, 1e3f, "", true, false, of_region<&Material::hardening_strain>},
    {"densification", 0, 100, "", true, false, of_region<&Material::densification>},
    {"densification_strain", 0, 3, "", true, false, of_region<&Material::densification_strain>},
    {"plastic_limit", 0, 3, "", true, false, of_region<&Material::plastic_limit>},
    {"drag", 0, 1e9f, " N s/m^4", true, false, of_region<&Material::drag>},
    {"friction", 0, 2, "", true, false, of_region<&Material::friction>},
    {"distance_stiffness", 0, 1, "", true, false, of_region<&Material::distance_stiffness>},
    {"volume_stiffness", 0, 1, "", true, false, of_region<&Material::volume_stiffness>},
    {"plasticity", 0, 1, "", true, false, of_region<&Material::plasticity>},
};

}  // namespace

std::span<const Range> parameter_ranges() { return ranges; }

std::optional<std::string> out_of_range(const Parameters& parameters) {
  for (int region = 0; region < region_limit; ++region) {
    for (const Range& range : ranges) {
      const float value = range.value(parameters, region);
      if (value >= range.low && value <= range.high) continue;  // NaN does not pass either
      const std::string of = range.of_region ? " of region " + std::to_string(region) : "";
      char text[160];
      std::snprintf(text, sizeof text, "%s%s is %g%s; allowed are %g to %g%s", range.name, of.c_str(), double(value),
                    range.unit, double(range.low), double(range.high), range.unit);
      return text;
    }
  }
  return std::nullopt;
}

}  // namespace crumple
