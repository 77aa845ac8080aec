// The rules of the house that a compiler does not keep: who may include whom, what the tick may not know, where files may lie,
// and what documents say of files.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <string>
#include <vector>

namespace {

namespace fs = std::filesystem;
const fs::path root = CRUMPLE_SOURCE_DIR;

struct Source {
  std::string name;  // relative to the root
  std::string text;
};

std::vector<Source> sources(const std::string& folder) {
  std::vector<Source> found;
  for (const auto& entry : fs::recursive_directory_iterator(root / folder)) {
    const auto extension = entry.path().extension();
    if (extension != ".cpp" && extension != ".h") continue;
    std::ifstream file(entry.path());
    found.push_back({fs::relative(entry.path(), root).string(), {std::istreambuf_iterator<char>(file), {}}});
  }
  return found;
}

// The room that a path below server/ or a quoted include belongs to; files directly in server/ are "server".
std::string room_of(const std::string& path) {
  const size_t slash = path.find('/');
  return slash == std::string::npos ? "server" : path.substr(0, slash);
}

TEST(Layout, EachRoomIncludesOnlyTheRoomsItMay) {
  const std::map<std::string, std::set<std::string>> allowed = {
      {"sim", {"sim"}},
      {"asset", {"asset", "sim", "schema", "files"}},
      {"files", {"files"}},
      {"wire", {"wire", "sim", "schema", "protocol"}},
      {"transport", {"transport"}},
      {"protocol", {"protocol"}},
      {"server", {"server", "sim", "asset", "wire", "schema", "transport", "protocol", "cpp", "files"}},
  };
  const std::regex include("#include \"([^\"]+)\"");
  int checked = 0;
  for (const Source& source : sources("server")) {
    const std::string room = room_of(source.name.substr(7));
    for (std::sregex_iterator i(source.text.begin(), source.text.end(), include), end; i != end; ++i) {
      EXPECT_TRUE(allowed.at(room).count(room_of((*i)[1]))) << source.name << " includes " << (*i)[1];
      ++checked;
    }
  }
  EXPECT_GT(checked, 100);
}

TEST(Layout, ClientsKnowNothingOfTheServerButItsTransportProtocolAndFiles) {
  const std::regex include("#include \"([^\"]+)\"");
  for (const Source& source : sources("clients")) {
    for (std::sregex_iterator i(source.text.begin(), source.text.end(), include), end; i != end; ++i) {
      const std::string room = room_of((*i)[1]);
      EXPECT_TRUE(room == "server" || room == "cpp" || room == "schema" || room == "transport" || room == "protocol" ||
                  room == "files")
          << source.name << " includes " << (*i)[1];
      // A bare name is a file beside it, but for one that Unreal makes.
      if (room == "server" && !(*i)[1].str().ends_with(".generated.h")) {
        EXPECT_TRUE(fs::exists((root / source.name).parent_path() / (*i)[1].str())) << source.name << " includes " << (*i)[1];
      }
    }
  }
}

TEST(Layout, TheSimulationKnowsNoClockThreadFileOrRandomNumber) {
  const std::regex forbidden(
      "#include "
      "<(chrono|thread|mutex|atomic|fstream|iostream|filesystem|random|ctime|tbb/"
      "[^>]*)>|\\bstd::time\\(|\\brand\\(|\\bgetenv\\(");
  for (const std::string room : {"server/sim", "server/wire", "server/protocol"}) {
    for (const Source& source : sources(room)) {
      if (source.name.starts_with("server/sim/team.")) continue;  // who does a piece of work, never what it comes to
      std::smatch hit;
      EXPECT_FALSE(std::regex_search(source.text, hit, forbidden)) << source.name << ": " << hit.str();
    }
  }
}

TEST(Layout, NothingBreaksThePromiseOfTheSameBits) {
  const std::regex forbidden("ffast-math|fp-contract=fast|_mm_rsqrt|std::(log|exp|pow|sin|cos|tan|atan2|cbrt)\\(");
  for (const Source& source : sources("server/sim")) {
    std::smatch hit;
    EXPECT_FALSE(std::regex_search(source.text, hit, forbidden)) << source.name << ": " << hit.str();
  }
  std::ifstream file(root / "CMakeLists.txt");
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  EXPECT_NE(text.find("-ffp-contract=off"), std::string::npos);
  EXPECT_EQ(text.find("fast-math"), std::string::npos);
}

// "`Suite.Name…`" or "`Suite.*`" in the table of bounds: of each there is one.
TEST(Layout, TheTestsThatTheTableOfBoundsNamesAreThere) {
  std::set<std::string> tests;
  const std::regex test("TEST(?:_F|_P)?\\((\\w+), (\\w+)\\)");
  for (const Source& source : sources("tests"))
    for (std::sregex_iterator i(source.text.begin(), source.text.end(), test), end; i != end; ++i)
      tests.insert((*i)[1].str() + "." + (*i)[2].str());
  std::ifstream file(root / "server/README.md");
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  const std::regex named("`([A-Z]\\w+\\.)([A-Z]\\w*|)(\\*|…)?`");
  int checked = 0;
  for (std::sregex_iterator i(text.begin(), text.end(), named), end; i != end; ++i, ++checked) {
    const std::string name = (*i)[1].str() + (*i)[2].str();
    const auto at = tests.lower_bound(name);
    EXPECT_TRUE(at != tests.end() && ((*i)[3].matched ? at->starts_with(name) : *at == name)) << i->str();
  }
  EXPECT_GT(checked, 25);
}

// A file in Markdown without what its fences enclose: code links nowhere and has no headings.
struct Document {
  fs::path path;
  std::vector<std::string> lines;
};

Document read_document(const fs::path& path) {
  Document document{path, {}};
  std::ifstream file(path);
  bool code = false;
  for (std::string line; std::getline(file, line);) {
    const bool fence =
        line.find_first_not_of(' ') != std::string::npos && line.compare(line.find_first_not_of(' '), 3, "```") == 0;
    code = code != fence;
    document.lines.push_back(code || fence ? "" : line);
  }
  return document;
}

std::vector<Document> documents() {
  std::vector<Document> found;
  for (fs::recursive_directory_iterator i(root), end; i != end; ++i) {
    const std::string name = i->path().filename().string();
    if (i->is_directory() && (name[0] == '.' || name == "build" || name == "node_modules")) i.disable_recursion_pending();
    if (i->is_regular_file() && i->path().extension() == ".md") found.push_back(read_document(i->path()));
  }
  return found;
}

// The anchors of its headings, as GitHub makes them: small letters, no punctuation, a hyphen for a blank, -1 for the second
// one.
std::set<std::string> anchors(const Document& document) {
  std::set<std::string> found;
  std::map<std::string, int> times;
  const std::string punctuation = "!\"#$%&'()*+,./:;<=>?@[\\]^`{|}~";
  const std::regex heading("#{1,6} +(.*?) *"), link("\\[([^\\]]*)\\]\\([^)]*\\)");
  for (const std::string& line : document.lines) {
    std::smatch match;
    if (!std::regex_match(line, match, heading)) continue;
    std::string anchor;
    for (const char c : std::regex_replace(match[1].str(), link, "$1")) {
      if (punctuation.find(c) == std::string::npos) anchor += c == ' ' ? '-' : c >= 'A' && c <= 'Z' ? char(c - 'A' + 'a') : c;
    }
    const int before = times[anchor]++;
    found.insert(before == 0 ? anchor : anchor + "-" + std::to_string(before));
  }
  return found;
}

TEST(Layout, TheReadmeIsAFrontPage) {
  constexpr int most_lines = 150, most_columns = 120;  // what a reader takes in before going on
  std::ifstream file(root / "README.md");
  int lines = 0;
  for (std::string line; std::getline(file, line);) {
    ++lines;
    const auto columns = std::count_if(line.begin(), line.end(), [](char c) { return (c & 0xc0) != 0x80; });  // of UTF-8
    EXPECT_LE(columns, most_columns) << "README.md:" << lines;
  }
  EXPECT_GT(lines, 0);
  EXPECT_LE(lines, most_lines);
}

TEST(Layout, EveryLinkOfADocumentLeadsToAPlaceThatIsThere) {
  const std::regex code("`[^`]*`"), link("\\]\\(([^)\\s]+)[^)]*\\)|(?:href|src)=\"([^\"]+)\""), elsewhere("[a-z]+:.*");
  int checked = 0;
  for (const Document& document : documents()) {
    for (const std::string& line : document.lines) {
      const std::string prose = std::regex_replace(line, code, "");
      for (std::sregex_iterator i(prose.begin(), prose.end(), link), end; i != end; ++i) {
        const std::string target = (*i)[1].str() + (*i)[2].str();
        if (std::regex_match(target, elsewhere)) continue;
        ++checked;
        const size_t hash = target.find('#');
        const fs::path path = hash == 0 ? document.path : document.path.parent_path() / target.substr(0, hash);
        const std::string said = fs::relative(document.path, root).string() + ": " + target;
        EXPECT_TRUE(fs::exists(path)) << said;
        if (hash == std::string::npos || !fs::exists(path)) continue;
        EXPECT_TRUE(anchors(read_document(path)).count(target.substr(hash + 1))) << said;
      }
    }
  }
  EXPECT_GT(checked, 25);
}

// "`server/setup ...`" or "`clients/scenes/`": from the root. What a build makes is looked for by manual_test.py.
TEST(Layout, EveryFileThatADocumentNamesIsThere) {
  const std::regex named("`((?:bench|clients|recordings|schema|server|tests)/[\\w/.]*)");
  int checked = 0;
  for (const Document& document : documents()) {
    for (const std::string& line : document.lines) {
      for (std::sregex_iterator i(line.begin(), line.end(), named), end; i != end; ++i, ++checked) {
        EXPECT_TRUE(fs::exists(root / (*i)[1].str())) << fs::relative(document.path, root) << ": " << (*i)[1];
      }
    }
  }
  EXPECT_GT(checked, 50);
}

TEST(Layout, TheTopLevelHoldsWhatTheReadmeSaysAndNothingElse) {
  const std::set<std::string> allowed = {"CMakeLists.txt", "LICENSE", "README.md", "bench", "clients",
                                         "recordings",     "schema",  "server",    "tests", "build"};
  for (const auto& entry : fs::directory_iterator(root)) {
    const std::string name = entry.path().filename().string();
    EXPECT_TRUE(name[0] == '.' || allowed.count(name)) << name;
  }
}

}  // namespace
