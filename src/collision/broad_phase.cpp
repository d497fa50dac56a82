#include "broad_phase.hpp"

#include <algorithm>
#include <limits>

#include "signorini/errors.hpp"

namespace signorini {
namespace {

// The sum of all boxes' sizes may grow by so much before the tree is built anew.
constexpr double kRebuildAt = 1.3;

std::vector<std::pair<int, int>> ordered(const std::vector<std::pair<int, int>>& pairs, int limit, const char* field) {
  std::vector<std::pair<int, int>> result;
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    const auto [a, b] = std::minmax(pairs[k].first, pairs[k].second);
    if (a < 0 || (limit >= 0 && b >= limit))
      throw InvalidInput(std::string(field) + "[" + std::to_string(k) + "]",
                         "is (" + std::to_string(pairs[k].first) + ", " + std::to_string(pairs[k].second) +
                             "), must be in [0, " + (limit >= 0 ? std::to_string(limit - 1) : "2^31 - 1") + "]");
    result.emplace_back(a, b);
  }
  std::sort(result.begin(), result.end());
  return result;
}

void check_count(std::size_t count, std::size_t wanted, const char* field) {
  if (count != 0 && count != wanted)
    throw InvalidInput(field, "has " + std::to_string(count) + " entries, must have none or " + std::to_string(wanted));
}

bool contains(const std::vector<std::pair<int, int>>& sorted, int a, int b) {
  if (sorted.empty()) return false;
  return std::binary_search(sorted.begin(), sorted.end(), std::make_pair(std::min(a, b), std::max(a, b)));
}

}  // namespace

PairRule::PairRule(std::size_t num_geometries, const std::vector<std::pair<int, int>>& pairs) : listed_(true) {
  std::vector<std::pair<int, int>> sorted = pairs;
  std::sort(sorted.begin(), sorted.end());
  sorted.erase(std::unique(sorted.begin(), sorted.end()), sorted.end());
  begin_.assign(num_geometries + 1, 0);
  for (const auto& [a, b] : sorted) ++begin_[a + 1], partners_.push_back(b);
  for (std::size_t a = 0; a < num_geometries; ++a) begin_[a + 1] += begin_[a];
}

PairRule::PairRule(const std::vector<CollisionGeometry>& geometries, const CollisionFilter& filter)
    : listed_(false), group_(filter.group), mask_(filter.mask) {
  const int count = static_cast<int>(geometries.size());
  check_count(group_.size(), geometries.size(), "filter.group");
  check_count(mask_.size(), geometries.size(), "filter.mask");
  group_.resize(geometries.size(), filter.group.empty() ? ~0u : 0u);
  mask_.resize(geometries.size(), filter.mask.empty() ? ~0u : 0u);
  for (const CollisionGeometry& geometry : geometries) {
    frame_.push_back(geometry.frame);
    ground_.push_back(is_ground(geometry.shape.type));
  }
  excluded_ = ordered(filter.excluded, count, "filter.excluded");
  excluded_frames_ = ordered(filter.excluded_frames, -1, "filter.excluded_frames");
  included_ = ordered(filter.included, count, "filter.included");
}

bool PairRule::allows(int a, int b) const {
  if (listed_) return std::binary_search(partners_.begin() + begin_[a], partners_.begin() + begin_[a + 1], b);
  if (frame_[a] == frame_[b] || (ground_[a] && ground_[b])) return false;
  if (contains(included_, a, b)) return true;
  return ((group_[a] & mask_[b]) != 0 || (group_[b] & mask_[a]) != 0) && !contains(excluded_, a, b) &&
         !contains(excluded_frames_, frame_[a], frame_[b]);
}

std::vector<std::pair<int, int>> PairRule::pairs() const {
  std::vector<std::pair<int, int>> result;
  if (listed_) {
    for (int a = 0; a + 1 < static_cast<int>(begin_.size()); ++a)
      for (int k = begin_[a]; k < begin_[a + 1]; ++k) result.emplace_back(a, partners_[k]);
  } else {
    for (int a = 0; a < static_cast<int>(frame_.size()); ++a)
      for (int b = a + 1; b < static_cast<int>(frame_.size()); ++b)
        if (allows(a, b)) result.emplace_back(a, b);
  }
  return result;
}

void BoxTree::update(const std::vector<Bounds>& bounds, const std::vector<int>& members) {
  if (members.size() != order_.size()) {
    order_ = members;
    built_size_ = -1.0;
  }
  if (built_size_ >= 0.0 && refit(bounds) <= kRebuildAt * built_size_) return;
  nodes_.clear();
  nodes_.reserve(2 * order_.size());
  stack_.reserve(1024);  // more than a descent into so balanced a tree needs
  if (!order_.empty()) build(bounds, 0, static_cast<int>(order_.size()));
  built_size_ = refit(bounds);
}

void BoxTree::build(const std::vector<Bounds>& bounds, int first, int last) {
  const std::size_t here = nodes_.size();
  nodes_.emplace_back();
  if (last - first == 1) {
    nodes_[here].geometry = order_[first];
    return;
  }
  // Halves along the axis on which the centres are spread most.
  Vector3 lower = Vector3::Constant(std::numeric_limits<double>::infinity()), upper = -lower;
  for (int k = first; k < last; ++k) {
    const Vector3& centre = bounds[order_[k]].centre;
    if (!centre.allFinite()) continue;
    lower = lower.cwiseMin(centre), upper = upper.cwiseMax(centre);
  }
  int axis = 0;
  (upper - lower).maxCoeff(&axis);
  const int middle = first + (last - first) / 2;
  // What is not finite goes last: a comparison with NaN is no order.
  const auto key = [&](int geometry) {
    const double x = bounds[geometry].centre[axis];
    return std::isfinite(x) ? x : std::numeric_limits<double>::infinity();
  };
  std::nth_element(order_.begin() + first, order_.begin() + middle, order_.begin() + last, [&](int i, int j) {
    const double x = key(i), y = key(j);
    return x < y || (x == y && i < j);
  });
  build(bounds, first, middle);
  nodes_[here].right = static_cast<int>(nodes_.size());
  build(bounds, middle, last);
}

double BoxTree::refit(const std::vector<Bounds>& bounds) {
  double size = 0.0;
  for (int k = static_cast<int>(nodes_.size()) - 1; k >= 0; --k) {
    Node& node = nodes_[k];
    if (node.geometry >= 0) {
      node.lower = bounds[node.geometry].lower, node.upper = bounds[node.geometry].upper;
      continue;
    }
    node.lower = nodes_[k + 1].lower.cwiseMin(nodes_[node.right].lower);
    node.upper = nodes_[k + 1].upper.cwiseMax(nodes_[node.right].upper);
    const double extent = node.size();
    if (std::isfinite(extent)) size += extent;
  }
  return size;
}

}  // namespace signorini
