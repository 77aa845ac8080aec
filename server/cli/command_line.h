// The program's verbs: one per thing to do, each with its options.
#pragma once

namespace crumple {

// Options in, exit code out: 0 done, 1 differs, 2 wrong usage (said on stderr). Throws std::exception with one sentence.
int run(int argc, const char* const* argv);

}  // namespace crumple
