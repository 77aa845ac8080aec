// `crumple recover FILE -o FILE`: what is whole of a recording that was cut off or damaged, as a whole recording: with the
// summary, index and footer by which any MCAP tool opens it.
#pragma once

#include <string>

namespace crumple {

struct RecoverOptions {
  std::string input, output;
};

// Returns the exit code. Throws std::runtime_error with one sentence: file, fact, remedy.
int recover(const RecoverOptions&);

}  // namespace crumple
