// Crash tests as they are measured, read and fitted.
#include "fit/fit.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "bake/text_of.h"
#include "box_car.h"
#include "fit/csv.h"
#include "paths.h"
#include "program.h"
#include "refusal.h"

namespace crumple {
namespace {

// ---- what is measured ----

TEST(CrashTest, MeanCrushCountsBothEndsHalf) {
  EXPECT_DOUBLE_EQ(mean_crush({1, 2, 3, 4, 5, 6}), 3.5);
  EXPECT_DOUBLE_EQ(mean_crush({10, 0, 0, 0, 0, 0}), 1);
  EXPECT_DOUBLE_EQ(mean_crush({0.025, 0.051, 0.076, 0.079, 0.071, 0.048}), 0.0627);  // NHTSA test 1201
}

// A box of 4.5 x 1.8 x 1.5 m whose front moved back by 0.3 m at y = 0.9 (left) and 0.1 m at the right, evenly between them.
TEST(CrashTest, TheGaugeReadsASlantedDentFromLeftToRight) {
  const auto car = box_car({8, 12, 6});
  std::vector<Vec3> node(car->model.node.begin(), car->model.node.end());
  for (Vec3& each : node) {
    if (each.x() > 2.2f) each.x() -= 0.2f + 0.1f * each.y() / 0.9f;
  }
  const Profile depth = FrontGauge(*car, 1.5).depth(node);
  for (size_t k = 0; k < 6; ++k) EXPECT_NEAR(depth[k], 0.2 + 0.1 * (0.75 - 0.3 * double(k)) / 0.9, 1e-6) << k;
  EXPECT_NEAR(mean_crush(depth), 0.2, 1e-6);
}

TEST(CrashTest, TheGaugeLooksOnlyAtTheHeightOfBumpers) {
  const auto car = box_car({8, 12, 12});
  std::vector<Vec3> node(car->model.node.begin(), car->model.node.end());
  for (Vec3& each : node) {
    if (each.x() > 2.2f && (each.z() < 0.3f || each.z() > 0.7f)) each.x() -= 0.5f;
  }
  for (const double depth : FrontGauge(*car, 1.5).depth(node)) EXPECT_NEAR(depth, 0, 1e-6);
}

TEST(CrashTest, ACarThatIsTooLowHasNoFront) {
  const auto toy = box_car({4, 4, 2}, 1200, 0.6f);
  expect_sentence(refusal([&] { FrontGauge(*toy, 0); }), "box", "it has no front");
}

TEST(CrashTest, AScaledCarHasTheMeasuresOfTheTestAndIsSound) {
  const auto car = box_car();
  const auto scaled = scale_car(car, {5.0, 1.5, 2000});
  const Measures measures = measures_of(*scaled);
  EXPECT_NEAR(measures.length, 5.0, 1e-5);
  EXPECT_NEAR(measures.width, 1.5, 1e-5);
  EXPECT_NEAR(measures.mass, 2000, 1e-3);
  const Model& model = scaled->model;
  double volume = 0;
  for (size_t t = 0; t < model.tet.size(); ++t) {
    Eigen::Matrix3f edges, gradients;
    for (int k = 0; k < 3; ++k) {
      edges.col(k) = model.node[model.tet[t].node[k + 1]] - model.node[model.tet[t].node[0]];
      gradients.row(k) = model.gradients[t].corner[k];
    }
    EXPECT_LT((gradients * edges - Eigen::Matrix3f::Identity()).norm(), 1e-4f);
    EXPECT_NEAR(model.tet_rest[t], edges.determinant() / 6, 1e-6);
    volume += double(model.tet_rest[t]);
  }
  EXPECT_NEAR(volume, 5.0 * 1.5 * 1.5, 1e-3);
  expect_sentence(refusal([&] { scale_car(car, {500, 0, 0}); }), "box", "beyond 50 m");
}

TEST(CrashTest, TheBarriersImpulseIsWhatTheCarLoses) {
  const auto car = box_car({18, 8, 6});
  CrashTest test(car, {});
  const HitResult hit = test.hit(rigid_wall(), 14);
  double impulse = 0, before = 0;
  for (const Instant& each : hit.pulse) impulse += each.force * (each.seconds - before), before = each.seconds;
  EXPECT_NEAR(impulse, 14 * (1 + hit.restitution), 0.02 * 14);
  double sixtieths = 0;
  for (const double each : hit.force_by_sixtieth()) sixtieths += each / 60;
  EXPECT_NEAR(sixtieths, impulse, 0.02 * impulse);
  EXPECT_GT(hit.travel, hit.crush);
  EXPECT_GT(hit.rest, 0.02);
  EXPECT_LT(hit.rest, 0.2);
  EXPECT_NEAR(hit.energy, 1, 0.02);
  const double once = hit.crush;
  EXPECT_GT(test.hit(rigid_wall(), 14).crush, once) << "the damage of a second hit adds up";
}

TEST(CrashTest, AnOffsetWallCrushesOnlyItsSide) {
  const auto car = box_car({18, 8, 6});
  CrashTest test(car, {});
  const HitResult hit = test.hit(offset_wall(0.4, 1.8, 0.05), 12);
  EXPECT_GT(hit.depth[0], 0.1);
  EXPECT_LT(std::fabs(hit.depth[5]), 0.3 * hit.depth[0]);
  EXPECT_GT(hit.yaw_rate, 0) << "the obstacle is on the left, so the car turns to its left";
}

// ---- the file ----

std::string refused(const std::string& text) {
  return refusal([&] { (void)parse_tests(text, "tests.csv", "."); });
}

TEST(TestFile, ATableGivesCarsWithTheirHits) {
  const auto cars = parse_tests(
      "\xef\xbb\xbf# comment\r\ntest,car,mass_kg,width_mm,speed_kmh,c1_mm,c2_mm,c3_mm,c4_mm,c5_mm,c6_mm,crush_mm\r\n"
      "\"1, first\",a,1500,1800,36,100,200,200,200,200,100,\r\n"
      " 2 ,a,1500,1800,36,,,,,,,400\r\n"
      "3,,1200,,72,,,,,,,500",
      "tests.csv", ".");
  ASSERT_EQ(cars.size(), 2u);
  ASSERT_EQ(cars[0].hits.size(), 2u);
  EXPECT_EQ(cars[0].hits[0].test, "1, first");
  EXPECT_DOUBLE_EQ(cars[0].hits[0].crush, 0.18);
  EXPECT_DOUBLE_EQ(cars[0].hits[0].speed, 10);
  EXPECT_DOUBLE_EQ(cars[0].measures.width, 1.8);
  EXPECT_EQ(cars[0].hits[1].test, "2");
  EXPECT_DOUBLE_EQ(cars[1].hits[0].crush, 0.5);
  EXPECT_DOUBLE_EQ(cars[1].measures.length, 0);
}

TEST(TestFile, ALinearModelBecomesHitsOfNewCars) {
  const auto cars = parse_tests("test,mass_kg,width_mm,A_kN_m,B_kN_m2,speed_kmh\nx,1500,1800,64,769,\n", "tests.csv", ".");
  ASSERT_EQ(cars.size(), 3u);
  // At 40 km/h: sqrt(1500 v^2 / (1.8 x 769,000)) - 64 / 769
  EXPECT_NEAR(cars[1].hits[0].crush, 40 / 3.6 * std::sqrt(1500 / (1.8 * 769e3)) - 64.0 / 769, 1e-12);
}

TEST(TestFile, APulseGivesTheMeanForceOfEachSixtieth) {
  std::string text = "t_s,other,F_barrier_kN\n";
  // 150 kN in the first sixtieth, 300 in the next two, then nothing.
  for (int k = -12; k <= 1200; ++k)
    text += text_of((k + 0.5) / 1200, "%.6f") + ",x," + (k < 0 || k >= 60 ? "0" : k < 20 ? "150" : "300") + "\n";
  const auto force = parse_pulse(text, "pulse.csv", 1500);
  ASSERT_EQ(force.size(), 3u);
  EXPECT_NEAR(force[0], 100, 5);
  EXPECT_NEAR(force[1], 200, 5);
  EXPECT_NEAR(force[2], 200, 5);
}

TEST(TestFile, EveryRefusalNamesFileLineFactAndRemedy) {
  const std::string head = "test,mass_kg,speed_kmh,crush_mm\n", row = "x,1500,50,500\n";
  EXPECT_EQ(refused(head + row), "");
  const std::string wide =
      "test,car,mass_kg,length_mm,width_mm,speed_kmh,c1_mm,c2_mm,c3_mm,c4_mm,c5_mm,c6_mm,crush_mm,A_kN_m,B_kN_m2,pulse\n";
  const struct {
    std::string text, line, fact;
  } cases[] = {
      {"", ":1:", "it is empty"},
      {head, ":1:", "it has no test"},
      {"test,speed_kmh,crush_mm\n", ":1:", "mass_kg is missing"},
      {"test,mass_kg,mass_kg,speed_kmh\n" + row, ":1:", "twice"},
      {"test,mass_kg,speed_kmh,crush\n" + row, ":1:", "no column \"crush\""},
      {head + "x,1500,50\n", ":2:", "3 fields"},
      {head + row + "x,1500,fast,500\n", ":3:", "\"fast\""},
      {head + "x,1500,50;0,500\n", ":2:", "a number from 1 to 300"},
      {head + "x,1500,301,500\n", ":2:", "\"301\""},
      {head + "x,9.99,50,500\n", ":2:", "mass_kg"},
      {head + "x,nan,50,500\n", ":2:", "\"nan\""},
      {head + "x,1e999,50,500\n", ":2:", "1e999"},
      {head + "x,0x10,50,500\n", ":2:", "0x10"},
      {head + "x,1500,50,0.5\n", ":2:", "5 to 5000"},
      {head + "x,1500,50,\n", ":2:", "nothing of the crush"},
      {head + ",1500,50,500\n", ":2:", "test is empty"},
      {head + "x,1500,,500\n", ":2:", "speed_kmh is empty"},
      {head + "\"x,1500,50,500\n", ":2:", "quotation mark"},
      {head + "\"x\"y,1500,50,500\n", ":2:", "quoted field"},
      {head + std::string("x\0,1500,50,500\n", 15), ":2:", "zero byte"},
      {std::string(120, ','), ":1:", "100 fields"},
      {wide + "x,,1500,,,50,1,2,3,4,5,,,,,\n", ":2:", "all six"},
      {wide + "x,,1500,,,50,9,9,9,9,9,9,50,,,\n", ":2:", "remove one"},
      {wide + "x,,1500,,,50,1,1,1,1,1,1,,,,\n", ":2:", "below 5 mm"},
      {wide + "x,,1500,,,50,,,,,,,50,60,700,\n", ":2:", "stand alone"},
      {wide + "x,,1500,,1800,,,,,,,,,60,,\n", ":2:", "come together"},
      {wide + "x,,1500,,,,,,,,,,,60,700,\n", ":2:", "width_mm"},
      {wide + "x,,1500,,1800,,,,,,,,,2000,10,\n", ":2:", "nothing is crushed"},
      {wide + "x,a,1500,,1800,50,,,,,,,50,,,\ny,a,1500,,1700,50,,,,,,,90,,,\n", ":3:", "differs"},
      {wide + "x,a,1500,,1800,50,,,,,,,50,,,\ny,a,1500,,1800,50,,,,,,,40,,,\n", ":3:", "less than after"},
      {wide + "x,,1500,,1800,50,,,,,,,50,,,gone.csv\n", ":2:", "gone.csv"},
  };
  for (const auto& each : cases) expect_sentence(refused(each.text), "tests.csv" + each.line, each.fact);
  std::string many = head;
  for (size_t k = 0; k <= most_tests; ++k) many += row;
  expect_sentence(refused(many), "tests.csv:1002:", "more than 1000 rows");
}

TEST(TestFile, APulseThatIsNoneIsRefused) {
  const auto refused_pulse = [](const std::string& text) { return refusal([&] { (void)parse_pulse(text, "p.csv", 1500); }); };
  const std::string head = "t_s,F_barrier_kN\n";
  expect_sentence(refused_pulse("t,F\n0,1\n"), "p.csv:1:", "no column t_s");
  expect_sentence(refused_pulse(head + "0,1\n0,2\n"), "p.csv:3:", "does not rise");
  expect_sentence(refused_pulse(head + "0,1\n0.001,x\n"), "p.csv:3:", "\"x\"");
  expect_sentence(refused_pulse(head + "0,1\n0.01,2\n"), "p.csv:3:", "within 50 ms");
  expect_sentence(refused_pulse(head + "0,-1\n0.1,-1\n"), "p.csv:3:", "never above 0");
}

// ---- the fit ----

// Tests that our own car makes with a known material: the finer mesh stands for the real car.
std::vector<PublishedCar> planted(float stress, int hits) {
  Parameters parameters;
  for (Material& material : parameters.region) material.young_modulus *= stress;
  const auto real = box_car({22, 10, 8});
  PublishedCar car;
  CrashTest test(real, parameters);
  for (int k = 0; k < hits; ++k) {
    const HitResult hit = test.hit(rigid_wall(), 10 + 2 * k);
    PublishedHit published;
    published.test = "planted " + std::to_string(k);
    published.mass = 1200, published.speed = 10 + 2 * k, published.crush = hit.crush;
    car.hits.push_back(published);
  }
  return {car};
}

TEST(Fit, FindsAPlantedScaleWithinItsStatedUncertainty) {
  const auto car = box_car({16, 8, 6});
  for (const float stress : {0.6f, 1.0f, 2.0f}) {
    const Fit found = fit(car, planted(stress, 1), 1);
    const FittedConstant& scale = found.constants.at(0);
    EXPECT_LT(std::fabs(std::log(scale.factor / double(stress))), 2 * scale.deviation) << stress << " found " << scale.factor;
    EXPECT_LT(scale.deviation, 0.35) << "one exact hit says the scale to a third";
    EXPECT_GT(scale.deviation, 0.03) << "a test is no better than 5 %";
    EXPECT_LE(found.runs, 20) << "it takes a dozen runs";
    EXPECT_LT(found.rms, 0.03);
    EXPECT_TRUE(scale.determined);
  }
}

TEST(Fit, SaysWhatOneSpeedCannotSay) {
  const Fit found = fit(box_car({12, 6, 5}), planted(1, 1), fit_constants().size());
  int open = 0;
  for (const FittedConstant& each : found.constants) open += !each.determined;
  EXPECT_GE(open, 1) << "one number cannot determine all constants";
  for (const FittedConstant& each : found.constants) EXPECT_LE(each.deviation, each.constant->prior * 1.001);
}

TEST(Fit, TestsDecideHowManyConstants) {
  EXPECT_EQ(constants_for(planted(1, 1)), 1u);
  EXPECT_EQ(constants_for(planted(1, 3)), fit_constants().size());
  auto pulse = planted(1, 1);
  pulse[0].hits[0].force = {100, 200, 200};
  EXPECT_EQ(constants_for(pulse), fit_constants().size());
}

TEST(Fit, CrushThatNoMaterialGivesIsToldNotHidden) {
  auto tests = planted(1, 1);
  tests[0].hits[0].crush = 4.4;  // nearly the whole car
  const Fit found = fit(box_car({12, 6, 5}), tests, 1);
  EXPECT_GT(found.rms, 0.2);
}

// The program as a user runs it, on a table of a car whose material is known.
TEST(FitProgram, WritesAPresetThatHoldsThePlantedScale) {
  const Files files;
  const auto bytes = box_car_bytes({16, 8, 6});
  const auto finer = box_car_bytes({22, 10, 8});
  const auto car = files.write("box-1.car", {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
  const auto fine = files.write("box-2.car", {reinterpret_cast<const char*>(finer.data()), finer.size()});
  const auto tests = planted(1.5f, 1);
  const auto table = files.write(
      "tests.csv", "test,mass_kg,speed_kmh,crush_mm\nplanted,1200,36," + std::to_string(1000 * tests[0].hits[0].crush) + "\n");
  const std::string preset = files.folder.path / "preset.json";
  Process program({"fit", fine, car, "--tests", table, "-o", preset});
  EXPECT_EQ(program.wait(), 0) << program.text;
  EXPECT_TRUE(contains(program.text, "stress: ")) << program.text;
  EXPECT_TRUE(contains(program.text, "What the tests do not say")) << program.text;
  EXPECT_TRUE(contains(program.text, "checked on box")) << program.text;
  std::ifstream file(preset);
  const std::string json{std::istreambuf_iterator<char>(file), {}};
  const auto at = json.find("\"young_modulus\": ");
  ASSERT_NE(at, std::string::npos) << json;
  const double modulus = std::stod(json.substr(at + 17)), planted_modulus = 1.5 * double(Material{}.young_modulus);
  EXPECT_NEAR(modulus, planted_modulus, 0.3 * planted_modulus) << json;
}

TEST(FitProgram, RefusesABadTableWithFileAndLine) {
  const Files files;
  const auto bytes = box_car_bytes();
  const auto car = files.write("box.car", {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
  const auto table = files.write("tests.csv", "test,mass_kg,speed_kmh,crush_mm\nx,heavy,36,100\n");
  Process program({"fit", car, "--tests", table, "-o", files.folder.path / "preset.json"});
  EXPECT_EQ(program.wait(), 1);
  EXPECT_TRUE(contains(program.text, "tests.csv:2: mass_kg is \"heavy\"")) << program.text;
  EXPECT_FALSE(std::filesystem::exists(files.folder.path / "preset.json"));
}

}  // namespace
}  // namespace crumple
