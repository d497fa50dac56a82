#pragma once

#include <vector>

#include "signorini/assembly/dynamics.hpp"
#include "signorini/collision/detector.hpp"

namespace signorini {

/// Tells how frames move in a step, if any moves so fast that its contacts have to be swept for (docs/collision.md);
/// that none does is found without their motions where it is plain.
class FrameMotions {
 public:
  /// slow: of two geometries that come nearer by less in a step, none is fast [m].
  FrameMotions(const World& world, double time_step, double slow);

  /// True if some frame may be fast at the velocity v, and then fills list(). again: nothing but v has changed since.
  bool find(const Dynamics& dynamics, const ConstVectorRef& v, bool again = false);
  /// That the velocity last asked about has become `v` by a turn of the frames alone: if that was slow, so is this.
  void keep(const ConstVectorRef& v);
  const std::vector<FrameMotion>& list() const { return list_; }

 private:
  bool may_be_fast(const ConstVectorRef& v);
  bool is_fast(const Dynamics& dynamics);

  const World& world_;
  double time_step_;
  double fast_;                      // [m/s] half of what a pair needs
  std::vector<double> reach_;        // by frame: how far what moves with it may be from its origin, at any q [m]
  std::vector<double> speed_;        // by articulated frame: what its points may have, at most
  std::vector<double> own_;          // by frame: the same of its own geometries
  std::vector<double> free_square_;  // by free body: reach squared
  bool slow_now_ = false;            // what find() was asked last
  Vector slow_;                      // a velocity that is known to be slow, or nothing
  std::vector<Twist> twists_;
  std::vector<FrameMotion> list_;
  GrowVector list_v_;  // the velocity that list_ is of, or nothing
};

}  // namespace signorini
