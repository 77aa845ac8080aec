// Reads and writes the JSON of parts (schema/parts.fbs).
#pragma once

#include "bake/parts.h"
#include "schema/parts_generated.h"

namespace crumple {

// Throws std::runtime_error with a sentence.
schema::PartEntriesT parse_parts(const PartsText&);
std::string write_parts(const schema::PartEntriesT&);

}  // namespace crumple
