// When two moving shapes meet: docs/collision.md, "Fast bodies".
#include "sweep.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace signorini {
namespace {

constexpr double kMeets = 1e-9;     // [m] nearer than this they have met
constexpr double kStraight = 1e-8;  // [m] a turn that moves no point farther than this is none
constexpr int kMostSteps = 400;     // of one sweep; it then counts as a meeting, so that nothing passes through
constexpr int kMostHalvings = 60;
constexpr double kSinks = 0.01;      // of the slack: how much deeper what overlaps already may go
constexpr double kShortest = 0.125;  // of the margin: the way that turning shapes go at least before they are looked at

/// Distance of two shapes at one time, and how fast it changes at the closest points.
struct Look {
  double time = 0.0, gap = 0.0, rate = 0.0;
  bool far = true;  ///< farther apart than was asked
};

}  // namespace

Placement moved(const Placement& place, const FrameMotion& motion, double time) {
  Placement result = place;
  const Vector3 way = time * motion.velocity;
  const double angle = time * motion.angular.norm();
  if (angle > 0.0) {
    const Matrix3 turn = Eigen::AngleAxisd(angle, motion.angular.normalized()).toRotationMatrix();
    result.rotation = turn * place.rotation;
    result.translation = motion.centre + turn * (place.translation - motion.centre);
  }
  result.translation += way;
  return result;
}

double arm(const Solid& solid, const Vector3& centre, const FrameMotion& motion) {
  return (centre - motion.centre).norm() + (solid.type == ShapeType::Sphere ? 0.0 : solid.radius);
}

double Moving::arm() const {
  return motion.angular.isZero(0.0) ? 0.0 : signorini::arm(solid, place * solid.centre, motion);
}

double closing_speed(const Moving& a, const Moving& b, double duration) {
  const double turns_a = a.motion.angular.norm(), turns_b = b.motion.angular.norm();
  const double ways_a = turns_a * a.arm(), ways_b = turns_b * b.arm();
  const double apart = (b.motion.velocity - a.motion.velocity).norm() + ways_a + ways_b;
  if (ways_a == 0.0 || ways_b == 0.0) return apart;
  // Links that turn together: the way of one's points against the other, taken as a body that fills all space.
  const auto against = [&](const Moving& all, const Moving& one) {
    const Vector3 centre = one.place * one.solid.centre;
    const double speed = (one.velocity(centre, 0.0) - all.velocity(centre, 0.0)).norm() +
                         (one.motion.angular - all.motion.angular).norm() * one.solid.radius;
    return speed + duration * (turns_a + turns_b) * (speed + std::max(ways_a, ways_b));
  };
  return std::min({apart, against(a, b), against(b, a)});
}

bool find_meeting(NarrowPhase& narrow_phase, const Moving& a, const Moving& b, double duration, double margin,
                  double slack, double sinks, Meeting& out) {
  const double speed = closing_speed(a, b, duration);
  if (!(speed > 0.0 && speed * duration < 1e6)) return false;
  PairMemory memory;
  double level = 0.0;  // they meet when the gap is below
  const auto collide = [&](double time, double reach) {
    narrow_phase.collide(a.solid, a.at(time), b.solid, b.at(time), reach, memory, out.manifold);
  };
  const auto look = [&](double time) {
    Look now;
    now.time = time;
    collide(time, (duration - time) * speed + kShortest * margin);
    for (int k = 0; k < out.manifold.count; ++k) {
      const SurfacePair& point = out.manifold.points[k];
      if (!now.far && point.gap >= now.gap) continue;
      now.far = false, now.gap = point.gap;
      now.rate = point.normal.dot(b.velocity(point.on_b, time) - a.velocity(point.on_a, time));
    }
    now.gap -= level;
    return now;
  };
  const auto meet = [&](double time) {
    out.time = time;
    collide(time, margin + 10.0 * kMeets);
    return out.manifold.count > 0;
  };

  Look now = look(0.0);
  level = slack > 0.0 ? std::min(-slack - sinks, now.gap - kSinks * slack) : -slack;
  now.gap -= level;
  // Shapes that go straight: the separation along today's normal changes at today's rate, and as both are convex they
  // are apart at least that much. So Newton's steps reach the first contact from before, and where the gap grows there
  // is none to come.
  const bool convex = a.solid.type != ShapeType::HeightField && b.solid.type != ShapeType::HeightField;
  const bool straight = duration * (a.motion.angular.norm() * a.arm() + b.motion.angular.norm() * b.arm()) <= kStraight;
  if (convex && straight) {
    for (int k = 0; k < kMostSteps; ++k) {
      if (now.far) return false;
      if (now.gap <= kMeets) return meet(now.time);
      if (!(now.rate < 0.0)) return false;
      const double next = now.time - now.gap / now.rate;
      if (!(next < duration)) return false;
      now = look(next);
    }
    return meet(now.time);
  }

  // Else steps that are safe at the largest speed, but no shorter than some; then halvings.
  const double shortest = std::max(kShortest * margin / speed, 2.0 * duration / kMostSteps);
  for (int k = 0; k < kMostSteps; ++k) {
    if (now.far) return false;
    if (now.gap <= kMeets) return meet(now.time);
    if (now.time >= duration) return false;
    const Look before = now;
    now = look(std::min(duration, before.time + std::max(before.gap / speed, shortest)));
    if (now.far) return false;
    Look low = before, high = now;  // apart, and in overlap
    if (now.gap > kMeets) {
      // Both apart: perhaps they met in between and came apart again.
      if (!(before.rate < 0.0 && now.rate > 0.0 && before.gap + now.gap < speed * (now.time - before.time))) continue;
      for (int j = 0; j < kMostHalvings && high.gap > kMeets; ++j) {
        const Look middle = look(0.5 * (low.time + high.time));
        if (middle.far || !(high.time - low.time > 1e-9 * duration)) break;
        (middle.gap <= kMeets || middle.rate >= 0.0 ? high : low) = middle;
      }
      if (high.gap > kMeets) continue;
    }
    for (int j = 0; j < kMostHalvings && low.gap > kMeets; ++j) {
      double share = 0.5;
      if (j % 3 != 2) share = std::clamp(low.gap / (low.gap - high.gap), 0.01, 0.99);
      const Look middle = look(low.time + share * (high.time - low.time));
      (middle.gap > 0.0 ? low : high) = middle;
      if (!(high.time - low.time > 1e-15 * duration)) break;
    }
    return meet(low.time);
  }
  return meet(now.time);
}

}  // namespace signorini
