// A small reader of comma-separated text (RFC 4180, without line breaks inside fields).
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace crumple {

struct CsvRow {
  size_t line;                     // from 1
  std::vector<std::string> field;  // without blanks at its ends
};

// Gives the rows with at least one field that is not empty. Lines that begin with # are comments. Throws std::runtime_error
// with one sentence: name, line, fact, remedy. most: rows, header included.
std::vector<CsvRow> parse_csv(std::string_view text, const std::string& name, size_t most);

}  // namespace crumple
