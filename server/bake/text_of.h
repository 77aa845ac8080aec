// Formats a number for a report or a refusal.
#pragma once

#include <cstdio>
#include <string>

namespace crumple {

inline std::string text_of(double value, const char* format = "%.4g") {
  char text[32];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

}  // namespace crumple
