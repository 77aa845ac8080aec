// Checks rules that the compiler does not: which folder may include which, what the tick may not use, where files may be, and
// that files named in documents exist.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <string>
#include <vector>

#include "paths.h"

namespace {

namespace fs = std::filesystem;
const fs::path root = crumple::in_repository("");

struct Source {
  std::string name;  // relative to the root
  std::string text;
};

std::vector<Source> sources(const std::string& folder, const std::set<std::string>& extensions = {".cpp", ".h"}) {
  std::vector<Source> found;
  for (const auto& entry : fs::recursive_directory_iterator(root / folder)) {
    if (!extensions.count(entry.path().extension())) continue;
    std::ifstream file(entry.path());
    found.push_back({fs::relative(entry.path(), root).string(), {std::istreambuf_iterator<char>(file), {}}});
  }
  return found;
}

// Returns the first folder of a path or a quoted include.
std::string folder_of(const std::string& path) { return path.substr(0, path.find('/')); }

// Folder -> the folders whose headers its sources may include. The include roots of CMake (show_folder) enforce most of this
// map, because an include of any other target does not compile. This test enforces the rest.
const std::map<std::string, std::set<std::string>> may_include = {
    {"io", {"io"}},
    {"sim", {"sim"}},
    {"protocol", {"protocol", "schema"}},
    {"car", {"car", "protocol", "sim", "schema"}},
    {"wire", {"wire", "protocol", "sim", "schema"}},
    {"tick", {"tick", "wire", "car", "protocol", "sim", "schema"}},
    {"bake", {"bake", "car", "protocol", "sim", "schema", "io"}},
    {"fit", {"fit", "car", "sim", "io"}},
    {"reference", {"reference", "bake", "car", "sim"}},
    {"viewer", {"viewer", "protocol", "schema"}},
    {"recording", {"recording", "tick", "viewer", "wire", "car", "protocol", "sim", "schema", "io"}},
    {"service", {"service", "recording", "bake", "tick", "car", "protocol", "schema", "io"}},
    {"gateway", {"gateway", "recording", "bake", "viewer", "car", "protocol", "sim", "schema", "io"}},
    {"cli", {"cli", "fit", "service", "gateway", "recording", "bake", "viewer", "protocol", "schema", "io"}},
    {"cpp", {"cpp", "viewer", "protocol", "schema", "io"}},  // clients/cpp
};

void check_includes(const std::string& root_folder, int& checked) {
  const std::regex include("#include \"([^\"]+)\"");
  for (const Source& source : sources(root_folder)) {
    const std::string folder = folder_of(source.name.substr(root_folder.size() + 1));
    for (std::sregex_iterator i(source.text.begin(), source.text.end(), include), end; i != end; ++i, ++checked) {
      ASSERT_TRUE(may_include.contains(folder)) << source.name << " is in a folder that this test does not know";
      EXPECT_TRUE(may_include.at(folder).contains(folder_of((*i)[1]))) << source.name << " includes " << (*i)[1];
    }
  }
}

TEST(Layout, EachFolderIncludesOnlyThoseItMay) {
  int checked = 0;
  check_includes("server", checked);
  EXPECT_GT(checked, 250);
}

// Returns a circle such as "A includes B includes A", or "" if there is none.
std::string circle_in(std::map<std::string, std::set<std::string>> includes) {
  const auto left = [&includes](const std::string& name) { return includes.contains(name); };
  while (std::erase_if(includes, [&](const auto& each) { return std::ranges::none_of(each.second, left); }) > 0) {
  }
  if (includes.empty()) return "";
  // Everything that is left includes something that is left, so a path along these includes must return to itself.
  std::vector<std::string> way;
  for (std::string at = includes.begin()->first; std::ranges::count(way, at) < 2;
       at = *std::ranges::find_if(includes[at], left))
    way.push_back(at);
  way.erase(way.begin(), std::ranges::find(way, way.back()));
  std::string circle = way.front();
  for (size_t i = 1; i < way.size(); ++i) circle += " includes " + way[i];
  return circle;
}

TEST(Layout, NoFolderIncludesItselfByWayOfOthers) {
  auto others = may_include;
  for (auto& [folder, names] : others) names.erase(folder);
  EXPECT_EQ(circle_in(others), "");
}

// Each module of the web client with the modules that it imports, including imports of types only.
std::map<std::string, std::set<std::string>> web_imports() {
  const std::regex import("(?:from|import)[\\s(]*[\"'](\\.[^\"']+)\\.js[\"']");
  std::map<std::string, std::set<std::string>> imports;
  for (const Source& source : sources("clients/web/src", {".ts"})) {
    std::set<std::string>& names = imports[source.name];
    for (std::sregex_iterator i(source.text.begin(), source.text.end(), import), end; i != end; ++i)
      names.insert((fs::path(source.name).parent_path() / ((*i)[1].str() + ".ts")).lexically_normal().string());
  }
  return imports;
}

TEST(Layout, NoModuleOfTheWebClientImportsItselfByWayOfOthers) {
  EXPECT_GT(web_imports().size(), 10u);
  EXPECT_EQ(circle_in(web_imports()), "");
}

TEST(Layout, ThePackageForBrowsersKnowsNothingOfThePageThatIsMadeWithIt) {
  const std::string page = "clients/web/src/page/";
  int checked = 0;
  for (const auto& [name, others] : web_imports()) {
    for (const std::string& other : others) {
      EXPECT_TRUE(name.starts_with(page) || !other.starts_with(page)) << name << " imports " << other;
      ++checked;
    }
  }
  EXPECT_GT(checked, 50);
}

TEST(Layout, ClientsKnowNothingOfTheServerButProtocolViewerAndIo) {
  const std::regex include("#include \"([^\"]+)\"");
  int checked = 0;
  for (const Source& source : sources("clients")) {
    for (std::sregex_iterator i(source.text.begin(), source.text.end(), include), end; i != end; ++i, ++checked) {
      const std::string name = (*i)[1];
      const bool beside = name.find('/') == std::string::npos;
      if (beside && name.ends_with(".generated.h")) continue;  // Unreal generates it
      EXPECT_TRUE(beside ? fs::exists((root / source.name).parent_path() / name)
                         : may_include.at("cpp").contains(folder_of(name)))
          << source.name << " includes " << name;
    }
  }
  EXPECT_GT(checked, 20);
}

// team.* decides which thread does a piece of work, but never its result. Watch in state.h takes a clock from the caller.
TEST(Layout, TheTickKnowsNoClockThreadFileSocketOrRandomNumber) {
  const std::regex forbidden(
      "#include <(chrono|thread|mutex|atomic|fstream|iostream|filesystem|random|ctime|future|unistd.h|fcntl.h|sys/[^>]*|"
      "netinet/[^>]*)>|\\bstd::time\\(|\\brand\\(|\\bgetenv\\(|\\bfopen\\(");
  int checked = 0;
  for (const std::string room : {"server/protocol", "server/sim", "server/car", "server/wire", "server/tick"}) {
    for (const Source& source : sources(room)) {
      if (source.name.starts_with("server/sim/team.")) continue;
      std::smatch hit;
      EXPECT_FALSE(std::regex_search(source.text, hit, forbidden)) << source.name << ": " << hit.str();
      ++checked;
    }
  }
  EXPECT_GT(checked, 70);
}

// The caller gives the time, so a test can choose it.
TEST(Layout, TheViewerReadsNoClock) {
  const std::regex forbidden("\\bnow\\(\\)|\\bsleep_|#include \"io/");
  int checked = 0;
  for (const Source& source : sources("server/viewer")) {
    std::smatch hit;
    EXPECT_FALSE(std::regex_search(source.text, hit, forbidden)) << source.name << ": " << hit.str();
    ++checked;
  }
  EXPECT_GT(checked, 5);
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

// Each "`Suite.Name…`" or "`Suite.*`" in the table of bounds must match a test.
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

// A Markdown file without its fenced code, which has no links and no headings.
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

// Returns the anchors of a document's headings as GitHub makes them: lower case, no punctuation, hyphens for blanks, and -1 for
// the second heading with the same text.
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
  constexpr int most_lines = 150, most_columns = 120;  // as much as a newcomer reads at once
  std::ifstream file(root / "README.md");
  int lines = 0;
  for (std::string line; std::getline(file, line);) {
    ++lines;
    const auto columns =
        std::count_if(line.begin(), line.end(), [](char c) { return (c & 0xc0) != 0x80; });  // characters of UTF-8
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

// Names such as "`server/setup ...`" or "`clients/scenes/`" are relative to the root. manual_test.py checks files that a build
// makes.
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
  const std::set<std::string> allowed = {"CMakeLists.txt", "CMakePresets.json", "LICENSE", "README.md", "bench",
                                         "clients",        "recordings",        "schema",  "server",    "tests",
                                         "build"};
  for (const auto& entry : fs::directory_iterator(root)) {
    const std::string name = entry.path().filename().string();
    EXPECT_TRUE(name[0] == '.' || allowed.count(name)) << name;
  }
}

}  // namespace
