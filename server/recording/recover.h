// `crumple recover FILE -o FILE`: copies what is whole of a cut off or damaged recording to a whole recording, with the
// summary, index and footer that any MCAP tool needs.
#pragma once

#include <string>

namespace crumple {

struct RecoverOptions {
  std::string input, output;
};

// Returns the exit code. Throws std::runtime_error with one sentence: file, fact, remedy.
int recover(const RecoverOptions&);

}  // namespace crumple
