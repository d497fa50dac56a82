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
  int frame = 0;        ///< index into the placements given to detect(); 0 is the world, which does not move
  Placement placement;  ///< of the shape in its frame
};

/// One point of contact, or of near contact, between two geometries; geometry_a < geometry_b.
struct ContactPoint {
  int geometry_a = 0, geometry_b = 0;
  Vector3 position = Vector3::Zero();  ///< world [m], half way between the surfaces
  Vector3 normal = Vector3::UnitZ();   ///< world, unit, from a to b
  double distance = 0.0;               ///< signed gap along the normal at this point [m], negative in overlap
  int patch_size = 1;                  ///< points of the same pair in this step, 1 to 4; on a height field to 8
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
  /// A new point inherits from an old one of its pair that lies within this, in the frame of either geometry [m].
  double match_distance = 0.02;
  /// From so many geometries on a tree finds the near pairs, below that a loop over all pairs. The points are the same.
  int tree_from = 40;

  /// Raises InvalidInput: margin must be in [0, 1e3], match_distance in [0, 1e3], tree_from at least 0.
  void validate() const;
};

/// Finds contact points: broad phase, narrow phase (Coal), at most four well-spread points a pair (eight on a height
/// field) with an exact gap each, matched with the last step's. Once warm, detect() allocates nothing. Not thread-safe:
/// one a simulator.
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
