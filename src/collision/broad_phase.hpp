#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "signorini/collision/detector.hpp"
#include "solid.hpp"

namespace signorini {

/// A geometry's bounds in the world: a ball, and a box along the axes, which holds no point if the geometry takes no
/// part in this step.
struct Bounds {
  Vector3 centre, lower, upper;
  double radius;
};

/// Which pairs may touch: a list, or a filter.
class PairRule {
 public:
  PairRule(std::size_t num_geometries, const std::vector<std::pair<int, int>>& pairs);
  PairRule(const std::vector<CollisionGeometry>& geometries, const CollisionFilter& filter);

  bool allows(int a, int b) const;  ///< a < b
  bool is_list() const { return listed_; }
  /// The pairs, sorted, each once; all that the filter lets through.
  std::vector<std::pair<int, int>> pairs() const;

 private:
  bool listed_;
  std::vector<int> begin_, partners_;  // of a list: partners b > a of each a
  std::vector<std::uint32_t> group_, mask_;
  std::vector<int> frame_;
  std::vector<char> ground_;
  std::vector<std::pair<int, int>> excluded_, excluded_frames_, included_;  // sorted, smaller first
};

/// A binary tree of boxes over all geometries but half spaces. Follows their motion by growing and shrinking its boxes,
/// and is built anew when these have become too large; which pairs it finds does not depend on its history.
class BoxTree {
 public:
  /// Calls visit(i, j), i < j, for pairs whose boxes, grown by half of `margin` each, overlap; in no particular order.
  template <typename Visit>
  void find_pairs(const std::vector<Bounds>& bounds, const std::vector<int>& members, double margin,
                  const Visit& visit) {
    update(bounds, members);
    if (nodes_.empty()) return;
    stack_.clear();
    stack_.emplace_back(0, 0);
    while (!stack_.empty()) {
      const auto [i, j] = stack_.back();
      stack_.pop_back();
      const Node &p = nodes_[i], &q = nodes_[j];
      if (i == j) {
        if (p.geometry >= 0) continue;
        stack_.emplace_back(i + 1, i + 1);
        stack_.emplace_back(p.right, p.right);
        stack_.emplace_back(i + 1, p.right);
        continue;
      }
      if (((p.lower - q.upper).array() > margin).any() || ((q.lower - p.upper).array() > margin).any()) continue;
      if (p.geometry >= 0 && q.geometry >= 0) {
        visit(std::min(p.geometry, q.geometry), std::max(p.geometry, q.geometry));
      } else if (q.geometry >= 0 || (p.geometry < 0 && p.size() >= q.size())) {
        stack_.emplace_back(i + 1, j);
        stack_.emplace_back(p.right, j);
      } else {
        stack_.emplace_back(i, j + 1);
        stack_.emplace_back(i, q.right);
      }
    }
  }

 private:
  /// The left child of a node is the next one in the list.
  struct Node {
    Vector3 lower, upper;
    int right = -1, geometry = -1;
    double size() const { return (upper - lower).sum(); }
  };

  void update(const std::vector<Bounds>& bounds, const std::vector<int>& members);
  void build(const std::vector<Bounds>& bounds, int first, int last);
  double refit(const std::vector<Bounds>& bounds);

  std::vector<Node> nodes_;
  std::vector<int> order_;
  std::vector<std::pair<int, int>> stack_;
  double built_size_ = 0.0;
};

}  // namespace signorini
