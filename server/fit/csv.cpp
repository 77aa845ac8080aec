#include "fit/csv.h"

#include <algorithm>
#include <stdexcept>

namespace crumple {
namespace {

constexpr size_t most_columns = 100;

std::string trimmed(std::string_view text) {
  const auto first = text.find_first_not_of(" \t");
  if (first == std::string_view::npos) return "";
  return std::string(text.substr(first, text.find_last_not_of(" \t") - first + 1));
}

// Splits one line at its commas.
std::vector<std::string> fields_of(std::string_view line, const auto& refuse) {
  std::vector<std::string> out;
  for (;;) {
    std::string field;
    const auto first = line.find_first_not_of(" \t");
    if (first != std::string_view::npos && line[first] == '"') {
      line.remove_prefix(first + 1);
      for (;;) {
        const auto quote = line.find('"');
        if (quote == std::string_view::npos) refuse("a field begins with a quotation mark and does not end with one; add it");
        field += line.substr(0, quote);
        line.remove_prefix(quote + 1);
        if (!line.starts_with('"')) break;
        field += '"', line.remove_prefix(1);
      }
      const auto after = line.substr(0, line.find(','));
      if (!trimmed(after).empty()) refuse("text follows a quoted field; put a comma between them");
    } else {
      field = trimmed(line.substr(0, line.find(',')));
    }
    out.push_back(std::move(field));
    if (out.size() > most_columns) refuse("it has more than 100 fields; remove those that are not needed");
    const auto comma = line.find(',');
    if (comma == std::string_view::npos) return out;
    line.remove_prefix(comma + 1);
  }
}

}  // namespace

std::vector<CsvRow> parse_csv(std::string_view text, const std::string& name, size_t most) {
  std::vector<CsvRow> rows;
  if (text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);  // spreadsheets write this mark
  for (size_t line = 1; !text.empty(); ++line) {
    const auto end = std::min(text.find('\n'), text.size());
    std::string_view content = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    if (content.ends_with('\r')) content.remove_suffix(1);
    const auto refuse = [&](const std::string& fact) {
      throw std::runtime_error(name + ":" + std::to_string(line) + ": " + fact + ".");
    };
    if (content.find('\0') != std::string_view::npos)
      refuse("it holds a zero byte; save the table as text, separated by commas");
    if (content.starts_with('#')) continue;
    CsvRow row{line, fields_of(content, refuse)};
    if (std::all_of(row.field.begin(), row.field.end(), [](const std::string& each) { return each.empty(); })) continue;
    if (rows.size() == most) refuse("it has more than " + std::to_string(most - 1) + " rows; divide the file");
    rows.push_back(std::move(row));
  }
  return rows;
}

}  // namespace crumple
