#include "closest_search.hpp"

#include <coal/narrowphase/gjk.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

namespace signorini {
namespace {

constexpr int kGjkIterations = 128;
constexpr int kEpaIterations = 64;
// Where the methods stop, relative to the smaller shape: near enough for what polishes their result.
constexpr double kGjkTolerance = 1e-6, kEpaTolerance = 1e-5;

/// Our difference of two shapes, as Coal wants to see one. It has no shapes of its own, and no rounding.
struct CoalDifference : coal::details::MinkowskiDiff {
  const Difference& difference;

  explicit CoalDifference(const Difference& of) : difference(of) {
    shapes[0] = shapes[1] = nullptr;
    oR1.setIdentity();
    ot1.setZero();
    swept_sphere_radius.setZero();
    getSupportFunc = &CoalDifference::support_pair;
  }
  static void support_pair(const MinkowskiDiff& self, const coal::Vec3s& direction, coal::Vec3s& a, coal::Vec3s& b,
                           coal::support_func_guess_t& hint, coal::details::ShapeSupportData*) {
    const Difference& difference = static_cast<const CoalDifference&>(self).difference;
    a = difference.support_a(direction, hint[0]);
    b = difference.support_b(-direction, hint[1]);
  }
};

}  // namespace

struct ClosestSearch::Methods {
  // One for each power of two of the size: GJK::reset, the way to another tolerance, allocates (in Coal 3 it makes the
  // exception that it might throw), and evaluate starts afresh without it.
  std::map<int, coal::details::GJK> gjk;
  coal::details::EPA epa{kEpaIterations, 1e-6};

  coal::details::GJK& gjk_for(double scale) {
    const int exponent = std::ilogb(scale);
    const auto [place, is_new] = gjk.try_emplace(exponent, kGjkIterations, std::ldexp(kGjkTolerance, exponent));
    if (is_new) {
      place->second.gjk_variant = coal::DefaultGJK;
      place->second.convergence_criterion = coal::Default;
      place->second.convergence_criterion_type = coal::Absolute;
    }
    return place->second;
  }
};

ClosestSearch::ClosestSearch() : methods_(std::make_unique<Methods>()) {
  methods_->epa.reset(kEpaIterations, 1e-6);  // takes its memory here
}
ClosestSearch::~ClosestSearch() = default;

ClosestSearch::Outcome ClosestSearch::run(const Difference& difference, double reach, double scale,
                                          PairMemory& memory) {
  using Gjk = coal::details::GJK;
  using Epa = coal::details::EPA;
  Gjk& gjk = methods_->gjk_for(scale);
  Epa& epa = methods_->epa;
  const CoalDifference seen_by_coal(difference);
  gjk.setDistanceEarlyBreak(reach);
  const Vector3 guess = memory.guess;
  gjk.evaluate(seen_by_coal, guess, coal::support_func_guess_t(memory.hint_a, memory.hint_b));
  memory.hint_a = gjk.support_hint[0], memory.hint_b = gjk.support_hint[1];
  if (gjk.status == Gjk::NoCollisionEarlyStopped) {
    if (gjk.ray.allFinite()) memory.guess = gjk.ray;
    return Apart;
  }
  coal::Vec3s a = coal::Vec3s::Zero(), b = a, n = a;
  farthest = std::numeric_limits<double>::infinity();
  if (gjk.status == Gjk::Collision) {
    epa.reset(kEpaIterations, kEpaTolerance * scale);
    epa.evaluate(gjk, -guess);
    // It falls back to nothing useful where the cores touch at a corner of their difference.
    if (epa.status == Epa::FallBack || epa.status == Epa::DidNotRun) return Failed;
    epa.getWitnessPointsAndNormal(seen_by_coal, a, b, n);
    memory.hint_a = epa.support_hint[0], memory.hint_b = epa.support_hint[1];
  } else {
    gjk.getWitnessPointsAndNormal(seen_by_coal, a, b, n);
    farthest = (a - b).norm();  // both lie in their cores
  }
  middle = 0.5 * (a + b);
  const double length = n.norm();
  if (!(std::abs(length - 1.0) < 1e-3 && middle.allFinite())) return Failed;
  normal = n / length;
  return Found;
}

}  // namespace signorini
