// The rules of the house that a compiler does not keep: who may include whom, what the tick may not know, where files may lie.
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

std::vector<Source> sources(const std::string& folder, const std::set<std::string>& extensions = {".cpp", ".h"}) {
  std::vector<Source> found;
  for (const auto& entry : fs::recursive_directory_iterator(root / folder)) {
    if (!extensions.count(entry.path().extension())) continue;
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

// The modules of the web client that each of them imports, types too.
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

TEST(Layout, NoModuleOfTheWebClientImportsItselfByAWayAround) {
  auto imports = web_imports();
  EXPECT_GT(imports.size(), 10u);
  const auto left = [&imports](const std::string& name) { return imports.count(name) > 0; };
  while (std::erase_if(imports, [&](const auto& module) { return std::ranges::none_of(module.second, left); }) > 0) {
  }
  if (imports.empty()) return;
  // Each that is left imports one that is left: whoever follows them comes round.
  std::vector<std::string> way;
  for (std::string at = imports.begin()->first; std::ranges::count(way, at) < 2; at = *std::ranges::find_if(imports[at], left))
    way.push_back(at);
  way.erase(way.begin(), std::ranges::find(way, way.back()));
  std::string circle;
  for (const std::string& name : way) circle += (circle.empty() ? "" : " imports ") + name;
  FAIL() << circle;
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
  const std::regex named("`([A-Z]\\w+\\.)(\\w*)(\\*|…)?`");
  int checked = 0;
  for (std::sregex_iterator i(text.begin(), text.end(), named), end; i != end; ++i, ++checked) {
    const std::string name = (*i)[1].str() + (*i)[2].str();
    const auto at = tests.lower_bound(name);
    EXPECT_TRUE(at != tests.end() && ((*i)[3].matched ? at->starts_with(name) : *at == name)) << i->str();
  }
  EXPECT_GT(checked, 25);
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
