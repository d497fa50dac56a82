#pragma once

#include "narrow_phase.hpp"
#include "signorini/collision/detector.hpp"

namespace signorini {

/// Where a placement of a frame's geometry has come after `time` of the frame's motion.
Placement moved(const Placement& place, const FrameMotion& motion, double time);

/// How far the points of a geometry, centred there, are at most from the one of its frame that moves straight; of a
/// sphere, whose turn nobody sees, its centre.
double arm(const Solid& solid, const Vector3& centre, const FrameMotion& motion);

/// One geometry on its way: where it starts, and how its frame moves.
struct Moving {
  const Solid& solid;
  Placement place;
  FrameMotion motion;

  double arm() const;  ///< 0 where nothing turns
  Placement at(double time) const { return moved(place, motion, time); }
  Vector3 velocity(const Vector3& point, double time) const {
    return motion.velocity + motion.angular.cross(point - motion.centre - time * motion.velocity);
  }
};

/// [m/s] a and b come together no faster than this while both move for `duration`.
double closing_speed(const Moving& a, const Moving& b, double duration);

/// When two geometries first meet, and their manifold then (world, at that time).
struct Meeting {
  double time = 0.0;
  Manifold manifold;
};

/// False if a and b do not meet within `duration`: come as near as -slack [m]; where slack > 0 and they are deeper
/// already, a little deeper: what touches may go on touching. sinks: how deep their points, which give way, let them
/// come [m]. margin: of the manifold.
bool find_meeting(NarrowPhase& narrow_phase, const Moving& a, const Moving& b, double duration, double margin,
                  double slack, double sinks, Meeting& out);

}  // namespace signorini
