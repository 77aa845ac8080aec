// Names in a file that somebody else made.
#pragma once

#include <regex>
#include <string>
#include <vector>

namespace crumple {

// Splits a name into its words, in small letters: "wheelFront_L.001" is wheel, front, l.
std::vector<std::string> words_of(const std::string& name);

// Whether one of the words is `wanted`, whole.
bool has_word(const std::vector<std::string>& words, const std::regex& wanted);

}  // namespace crumple
