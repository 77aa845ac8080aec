#include "bake/names.h"

#include <algorithm>
#include <cctype>

namespace crumple {

std::vector<std::string> words_of(const std::string& name) {
  std::vector<std::string> out(1);
  for (size_t i = 0; i < name.size(); ++i) {
    const auto c = static_cast<unsigned char>(name[i]);
    const bool begins = std::isupper(c) && i > 0 && std::islower(static_cast<unsigned char>(name[i - 1]));
    if (!std::isalpha(c) || begins) out.emplace_back();
    if (std::isalpha(c)) out.back().push_back(static_cast<char>(std::tolower(c)));
  }
  std::erase(out, std::string());
  return out;
}

bool has_word(const std::vector<std::string>& words, const std::regex& wanted) {
  return std::any_of(words.begin(), words.end(), [&](const std::string& word) { return std::regex_match(word, wanted); });
}

}  // namespace crumple
