// The program's verbs and their options.
#pragma once

namespace crumple {

// Runs the command line. Returns the exit code: 0 done, 1 differs, 2 wrong usage (reported on stderr). Throws std::exception
// with one sentence.
int run(int argc, const char* const* argv);

}  // namespace crumple
