// Shared by tests of refusals: the sentence that a function throws, and files that must be refused.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>

#include "bake/script.h"

namespace crumple {

// Returns the sentence of a refusal; empty if the function does not refuse.
template <class Function>
std::string refusal(Function function) {
  try {
    function();
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "";
}

inline bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

// The sentence must name the file, be one line, and end like a sentence.
inline void expect_sentence(const std::string& text, const std::string& file, const std::string& fact) {
  EXPECT_TRUE(contains(text, file)) << text;
  EXPECT_TRUE(contains(text, fact)) << text;
  EXPECT_FALSE(contains(text, "\n")) << text;
  EXPECT_TRUE(text.ends_with(".")) << text;
}

struct Files {
  TemporaryFolder folder;
  std::filesystem::path write(const std::string& name, const std::string& text) const {
    const auto path = folder.path / name;
    std::ofstream(path, std::ios::binary) << text;
    return path;
  }
};

}  // namespace crumple
