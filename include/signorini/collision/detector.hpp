#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "signorini/model/placement.hpp"
#include "signorini/model/shape.hpp"

namespace signorini {

/// A shape fixed to a moving frame. Which frames move together is the caller's: see Detector.
struct CollisionGeometry {
  Shape shape;
  int frame = 0;           ///< index into the placements given to detect(); 0 is the world, which does not move
  Placement placement;     ///< of the shape in its frame
  bool gives_way = false;  ///< its contacts are compliant: no spare points, which would be springs too
};

/// How a frame moves during a step: one of its points goes straight, the frame turns about it at a constant rate.
struct FrameMotion {
  Vector3 centre = Vector3::Zero();    ///< that point at the start; world [m]
  Vector3 velocity = Vector3::Zero();  ///< of it [m/s]
  Vector3 angular = Vector3::Zero();   ///< by which the frame turns; world axes [rad/s]
  Vector3 start = Vector3::Zero();     ///< angular velocity at the start, which is what an impulse changes
};

/// One point of contact, or of near contact, between two geometries; geometry_a < geometry_b.
struct ContactPoint {
  int geometry_a = 0, geometry_b = 0;
  Vector3 position = Vector3::Zero();  ///< world [m], half way between the surfaces; of a sweep: where they meet
  Vector3 normal = Vector3::UnitZ();   ///< world, unit, from a to b
  double distance = 0.0;               ///< signed gap along the normal at this point [m], negative in overlap
  bool swept = false;  ///< found by a sweep: the distance is what the motion there may use up along the normal
  /// Of a sweep: how far the frames' centres go until then [m]. The position less this is a point that moves with the
  /// frame as it is now.
  Vector3 way_a = Vector3::Zero(), way_b = Vector3::Zero();
  /// Not among the four that hold a pair apart as a rule: for use only when these do not keep it from sinking in here.
  bool spare = false;
  int patch_size = 1;  ///< points of the same pair in this step but spare ones, 1 to 4; on a height field to 8
  /// Index of the same material point in the list of the step before, or -1: what a warm start needs. Each old point
  /// has at most one heir.
  int previous = -1;
  std::uint64_t id = 0;  ///< kept from step to step while the point persists; never reused by one detector
};

/// Which of all pairs may touch, where a list of them would be too long. Two geometries of one frame never do.
struct CollisionFilter {
  /// One entry a geometry, or none for all bits: a and b may touch if (group[a] & mask[b]) or (group[b] & mask[a]), as
  /// with MuJoCo's contype and conaffinity.
  std::vector<std::uint32_t> group, mask;
  std::vector<std::pair<int, int>> excluded;         ///< pairs of geometries that may not, in any order
  std::vector<std::pair<int, int>> excluded_frames;  ///< pairs of frames whose geometries may not, in any order
  std::vector<std::pair<int, int>> included;         ///< pairs of geometries that may, whatever the other fields say

  CollisionFilter() {}  // not an aggregate: Detector(..., {{0, 1}}) means a list of pairs
};

struct DetectorSettings {
  /// Points with distance up to this are reported [m].
  double margin = 0.005;
  /// Pairs that may come nearer by more than this in one step are swept, where the motions are told [m].
  double sweep_from = 0.005;
  /// A new point inherits from an old one of its pair that lies within this, in the frame of either geometry [m].
  double match_distance = 0.02;
  /// From so many geometries on a tree finds the near pairs, below that a loop over all pairs. The points are the same.
  int tree_from = 40;

  /// Raises InvalidInput: margin, sweep_from and match_distance must be in [0, 1e3], tree_from at least 0.
  void validate() const;
};

/// Finds contact points: broad phase, narrow phase (Coal), at most four well-spread points a pair (eight on a height
/// field) and up to twelve spare ones, with an exact gap each, matched with the last step's. Once warm, detect()
/// allocates nothing. Not thread-safe: one a simulator.
class Detector {
 public:
  /// pairs: geometries that may touch, each (a, b) with a < b; empty frames' filters are the caller's work. Raises
  /// InvalidInput on an index out of range, a >= b, a pair of half spaces or height fields, a shape that does not
  /// validate, or a mesh whose triangles do not bound a convex body.
  Detector(std::vector<CollisionGeometry> geometries, const std::vector<std::pair<int, int>>& pairs,
           const DetectorSettings& settings = {});
  /// All pairs that pass a filter, but those of half spaces and height fields. Raises InvalidInput on a list that has
  /// neither one entry a geometry nor none, or an index out of range.
  Detector(std::vector<CollisionGeometry> geometries, const CollisionFilter& filter,
           const DetectorSettings& settings = {});
  ~Detector();
  Detector(Detector&&) noexcept;
  Detector& operator=(Detector&&) noexcept;

  /// frames: placement of each frame in the world, frames[0] the identity. The result lives until the next call; sorted
  /// by (geometry_a, geometry_b), so that the same input after the same steps gives the same list. A placement that is
  /// not finite gives no points for its geometries. Never throws, never returns a point that is not finite.
  const std::vector<ContactPoint>& detect(const std::vector<Placement>& frames);
  /// The same where `motions`, one a frame, are what the frames are about to do for `duration` [s]: of fast pairs that
  /// do not touch yet there are the points at which they will meet first, if they do, and no others.
  const std::vector<ContactPoint>& detect(const std::vector<Placement>& frames, const std::vector<FrameMotion>& motions,
                                          double duration);
  /// After it: adds where fast pairs meet when the frames move so instead; true if any do. Of the meetings of one frame
  /// only the first counts, since what comes after it is another motion; all: they all do. Gaps up to `touching` [m] at
  /// the end of the way are meetings too.
  bool add_meetings(const std::vector<FrameMotion>& motions, double duration, bool all, double touching = 0.0);
  /// Adds none, and holds back what meets.
  void hold_back(const std::vector<FrameMotion>& motions, double duration);
  /// By frame, the share of the motions last told that it can go before it meets what no point keeps it from (of shapes
  /// that turn far in a step); empty: all of it.
  const std::vector<double>& shares() const;

  const std::vector<ContactPoint>& points() const;
  /// Forgets the last step: nothing is matched next time.
  void reset();
  /// What matching remembers, so that a copy continues bit for bit; load() raises InvalidInput("detector", ...) on
  /// bytes that are not of this detector.
  std::string save() const;
  void load(const std::string& bytes);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace signorini
