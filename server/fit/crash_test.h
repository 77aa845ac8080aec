// A staged crash test: one car drives into something that stands, once or again and again, and is measured as NHTSA measures
// tested cars. The result depends on the arguments alone: no clock, no thread count.
#pragma once

#include <array>
#include <memory>
#include <span>
#include <vector>

#include "car/car.h"
#include "sim/deform.h"

namespace crumple {

// ---- what the car hits; x is its direction of travel ----

Obstacle rigid_wall();                 // 10 m wide, rough as plywood: friction 0.3
Obstacle rigid_pole(double diameter);  // upright, m
// A wall that only the left share `overlap` of a car of this width (m) meets; its edge is round, with this radius (m).
Obstacle offset_wall(double overlap, double width, double edge_radius);

// ---- what is measured ----

// Residual depth at six places, equally spaced over the damaged width from the car's left to its right, both ends included: C1
// to C6 of the field, m. A depth is how far the front that was at such a place, at the height of bumpers, has moved back.
using Profile = std::array<double, 6>;
// (C1/2 + C2 + C3 + C4 + C5 + C6/2) / 5, m
double mean_crush(const Profile&);

// Height of a car's bumper above the ground, m: 16 to 20 inches (49 CFR 581.5). The lowest vertex of the surface stands on the
// ground.
inline constexpr double bumper_low = 0.4064, bumper_high = 0.508;

// Points of a car's front, marked before the crash.
class FrontGauge {
 public:
  // damaged_width: m; 0, or more than the car's: nine tenths of its width, because its corners are round. Throws
  // std::runtime_error with one sentence if there is nothing at the height of bumpers.
  FrontGauge(const Car&, double damaged_width);
  // nodes: of the body, in the car's frame.
  Profile depth(std::span<const Vec3> nodes) const;

 private:
  struct Mark {
    uint32_t node[3];
    double weight[3];
    double at(std::span<const Vec3> nodes) const;  // its x, m
  };
  std::array<std::vector<Mark>, 6> marks_;
  Profile rest_ = {};  // mean x of a station's marks, m
};

// At the end of a tick.
struct Instant {
  double seconds;  // since first contact
  double force;    // of the barrier on the car against its travel, mean of the tick, over the car's mass, m/s^2
  double travel;   // of the centre of mass since first contact, m
  double speed;    // m/s, along the travel before the hit
};

struct HitResult {
  Profile depth = {};                                // m, residual
  double crush = 0;                                  // m, mean_crush() of it
  double travel = 0;                                 // m, dynamic: farthest way of the centre of mass since first contact
  double restitution = 0;                            // speed away / speed before
  double rest = 0;                                   // s from first contact until the centre of mass stood
  double energy = 0;                                 // kinetic, absorbed and stored at the end, over that before
  double deepest = 0;                                // m, of a node, residual
  Eigen::Vector3d change = Eigen::Vector3d::Zero();  // of velocity, m/s
  double yaw_rate = 0;                               // rad/s at the end
  std::vector<Instant> pulse;                        // one entry per tick, the first at time 0
  // Mean force over mass in successive 1/60 s, m/s^2.
  std::vector<double> force_by_sixtieth() const;
};

class CrashTest {
 public:
  // The car must outlive the test.
  CrashTest(std::shared_ptr<const Car>, const Parameters&, double damaged_width = 0);
  // The car starts where its obstacle is 1 mm off, with its present damage, at `velocity` (m/s, car's frame). Ends `seconds`
  // later. rate: ticks a second.
  HitResult hit(Obstacle, const Eigen::Vector3d& velocity, double rate = 60, double seconds = 0.4);
  HitResult hit(const Obstacle& obstacle, double speed, double rate = 60) { return hit(obstacle, {speed, 0, 0}, rate); }

  const DeformableState& body() const { return body_; }
  Mass mass;  // of the car; not planar: it may also rise and roll

 private:
  std::shared_ptr<const Car> car_;
  Parameters parameters_;
  FrontGauge gauge_;
  DeformableState body_;
  ScratchHandle scratch_;
};

}  // namespace crumple
