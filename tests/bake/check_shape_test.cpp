// Whether a surface stands as a car does, and what an import tells if it does not.

#include "bake/check_shape.h"

#include <gtest/gtest.h>

#include <cstring>
#include <string>
#include <vector>

#include "bake/built_in.h"
#include "refusal.h"

namespace crumple {
namespace {

struct Told {
  std::string warning, forward, up;  // empty: none
};

// What is told of the built-in car's body, turned, in a file with these axes.
Told told_of(const Eigen::Matrix3d& turn, const ImportOptions& options, double unit = 1) {
  const Surface body = build_car_body(1'259);
  std::vector<Eigen::Vector3d> positions;
  for (const Vec3& vertex : body.vertex) positions.push_back(unit * (turn * vertex.cast<double>()));
  const ImportedSurface placed = place_surface(positions, {}, body.triangle, options, "body");
  const std::vector<std::string> lines = check_shape(placed.surface, options);
  EXPECT_TRUE(lines[0].starts_with("shape: ")) << lines[0];
  EXPECT_LE(lines.size(), 2u);
  Told told;
  if (lines.size() < 2) return told;
  told.warning = lines[1];
  const auto word_after = [&](const std::string& flag) {
    const size_t at = told.warning.find(flag);
    if (at == std::string::npos) return std::string();
    const size_t begin = at + flag.size(), end = told.warning.find_first_of(" ,", begin);
    return told.warning.substr(begin, end - begin);
  };
  told.forward = word_after("--forward ");
  told.up = word_after("--up ");
  return told;
}

TEST(Shape, OfACarInAnyAxesIsRecognisedAndTheFlagsThatAreNamedSetItUpright) {
  size_t upright = 0, others = 0;
  for (const char* forward : {"x", "y", "z", "-x", "-y", "-z"}) {
    for (const char* up : {"x", "y", "z", "-x", "-y", "-z"}) {
      if (forward[std::strlen(forward) - 1] == up[std::strlen(up) - 1]) continue;
      const auto axis = [](const std::string& name) -> Eigen::Vector3d {
        return (name[0] == '-' ? -1 : 1) * Eigen::Vector3d::Unit(name.back() - 'x');
      };
      Eigen::Matrix3d turn;
      turn.col(0) = axis(forward);
      turn.col(2) = axis(up);
      turn.col(1) = turn.col(2).cross(turn.col(0));
      const Told told = told_of(turn, {"x", "z", 1});
      const bool stands = std::string(up) == "z" && std::string(forward).ends_with("x");
      EXPECT_EQ(told.warning.empty(), stands) << forward << " forward, " << up << " up: " << told.warning;
      ++(stands ? upright : others);
      if (stands) continue;
      EXPECT_EQ(told.up, up) << told.warning;
      EXPECT_EQ(told.forward.back(), std::string(forward).back()) << told.warning;
      EXPECT_EQ(told_of(turn, {told.forward, told.up, 1}).warning, "") << told.warning;
    }
  }
  EXPECT_EQ(upright, 2u);  // its front is not recognised
  EXPECT_EQ(others, 22u);
}

TEST(Shape, ThatIsNotTheSameLeftAndRightIsNoWholeCar) {
  Surface half = build_car_body(1'259);
  std::erase_if(half.triangle, [&](const Triangle& t) {
    return half.vertex[t[0]].y() > 0.05f && half.vertex[t[1]].y() > 0.05f && half.vertex[t[2]].y() > 0.05f;
  });
  const std::vector<std::string> lines = check_shape(half, {"x", "z", 1});
  ASSERT_EQ(lines.size(), 2u);
  EXPECT_TRUE(contains(lines[1], "left and right")) << lines[1];
  EXPECT_TRUE(contains(lines[1], "one whole car")) << lines[1];
}

TEST(Shape, InOtherUnitsIsToldTheScaleThatMakesItACar) {
  EXPECT_EQ(likely_scale(4500), "0.001 (millimetres)");
  EXPECT_EQ(likely_scale(420), "0.01 (centimetres)");
  EXPECT_EQ(likely_scale(1200), "0.01 (centimetres)");  // a bus
  EXPECT_EQ(likely_scale(177), "0.0254 (inches)");
  EXPECT_EQ(likely_scale(14.8), "0.3048 (feet)");
  EXPECT_EQ(likely_scale(0.0045), "1000");
  const Eigen::Matrix3d as_it_is = Eigen::Matrix3d::Identity();
  const std::string inches = refusal([&] { (void)told_of(as_it_is, {"x", "z", 1}, 1 / 0.0254); });
  expect_sentence(inches, "body", "perhaps --scale 0.0254 (inches)");
  EXPECT_TRUE(contains(told_of(as_it_is, {"x", "z", 1}, 1 / 0.3048).warning, "perhaps --scale 0.3048 (feet)"));
  EXPECT_TRUE(contains(told_of(as_it_is, {"x", "z", 1}, 1 / 4.556).warning, "perhaps --scale 4.5"));
  EXPECT_EQ(told_of(as_it_is, {"x", "z", 0.3048}, 1 / 0.3048).warning, "");
}

}  // namespace
}  // namespace crumple
