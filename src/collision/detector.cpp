#include "signorini/collision/detector.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <sstream>

#include "broad_phase.hpp"
#include "narrow_phase.hpp"
#include "signorini/errors.hpp"

namespace signorini {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// A list with fewer pairs a geometry than this is looked through one by one, however many geometries there are.
constexpr double kSkin = 0.3;  // how far a box may move before the candidates are listed again, of the median radius
constexpr std::size_t kFewPairs = 8;
constexpr char kMagic[] = "signorini detector 1";

std::string number(double value) {
  std::ostringstream out;
  out << value;
  return out.str();
}

/// A pair whose bounds were near in the last step.
struct NearPair {
  int a, b;
  PairMemory memory;
};

/// Where a point lay on each of its geometries, in their own frames.
struct LocalPair {
  Vector3 on_a, on_b;
};

bool precedes(const NearPair& pair, int a, int b) { return pair.a < a || (pair.a == a && pair.b < b); }

/// Plain bytes, in this machine's order.
struct Writer {
  std::string bytes;
  template <typename T>
  void put(const T& value) {
    static_assert(std::is_arithmetic_v<T>);
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  void put(const Vector3& v) { put(v[0]), put(v[1]), put(v[2]); }
};

struct Reader {
  const std::string& bytes;
  std::size_t at = 0;
  bool failed = false;
  template <typename T>
  T take() {
    T value{};
    if (failed || bytes.size() - at < sizeof value) {
      failed = true;
      return T{};
    }
    std::memcpy(&value, bytes.data() + at, sizeof value);
    at += sizeof value;
    return value;
  }
  Vector3 take_vector() {
    const double x = take<double>(), y = take<double>(), z = take<double>();
    failed = failed || !std::isfinite(x + y + z);
    return {x, y, z};
  }
};

std::vector<Solid> make_solids(const std::vector<CollisionGeometry>& geometries) {
  std::map<const ConvexMesh*, std::shared_ptr<const Hull>> hulls;
  std::vector<Solid> solids;
  for (std::size_t k = 0; k < geometries.size(); ++k) {
    const CollisionGeometry& geometry = geometries[k];
    const std::string field = "geometries[" + std::to_string(k) + "]";
    geometry.shape.validate((field + ".shape").c_str());
    if (geometry.frame < 0)
      throw InvalidInput(field + ".frame", "is " + std::to_string(geometry.frame) + ", must be at least 0");
    if (!geometry.placement.rotation.allFinite() || !geometry.placement.translation.allFinite())
      throw InvalidInput(field + ".placement", "has entries that are not finite");
    std::shared_ptr<const Hull> hull;
    if (geometry.shape.type == ShapeType::Convex) {
      auto& known = hulls[geometry.shape.mesh.get()];
      if (!known) known = std::make_shared<const Hull>(*geometry.shape.mesh, (field + ".shape").c_str());
      hull = known;
    }
    solids.emplace_back(geometry.shape, hull);
  }
  return solids;
}

void check_pairs(const std::vector<CollisionGeometry>& geometries, const std::vector<std::pair<int, int>>& pairs) {
  const int count = static_cast<int>(geometries.size());
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    const auto [a, b] = pairs[k];
    const std::string field = "pairs[" + std::to_string(k) + "]";
    const std::string is = "is (" + std::to_string(a) + ", " + std::to_string(b) + "), ";
    if (a < 0 || b < 0 || a >= count || b >= count)
      throw InvalidInput(field, is + "must be in [0, " + std::to_string(count - 1) + "]");
    if (a >= b) throw InvalidInput(field, is + "the first must be less than the second");
    if (is_ground(geometries[a].shape.type) && is_ground(geometries[b].shape.type))
      throw InvalidInput(field, is + "must not be two half spaces or height fields");
  }
}

}  // namespace

void DetectorSettings::validate() const {
  if (!(margin >= 0.0 && margin <= 1e3))
    throw InvalidInput("margin", "is " + number(margin) + ", must be in [0, 1e3] m");
  if (!(match_distance >= 0.0 && match_distance <= 1e3))
    throw InvalidInput("match_distance", "is " + number(match_distance) + ", must be in [0, 1e3] m");
  if (tree_from < 0) throw InvalidInput("tree_from", "is " + std::to_string(tree_from) + ", must be at least 0");
}

struct Detector::Impl {
  std::vector<CollisionGeometry> geometries;
  std::vector<Solid> solids;
  DetectorSettings settings;
  PairRule rule;

  // Broad phase
  bool use_tree = false;
  std::vector<std::pair<int, int>> listed;  // without a tree
  std::vector<int> bounded, half_spaces;    // with one
  BoxTree tree;
  std::vector<Bounds> old_bounds;               // when the candidates were listed
  std::vector<std::pair<int, int>> candidates;  // pairs whose boxes were near
  double skin = 0.0;                            // [m] how far a box may move meanwhile
  std::vector<Placement> placements;
  std::vector<Bounds> bounds;
  std::vector<std::pair<int, int>> near;

  NarrowPhase narrow_phase;

  // This step's and the last one's
  std::vector<NearPair> pairs, old_pairs;
  std::vector<ContactPoint> points, old_points;
  std::vector<LocalPair> locals, old_locals;
  std::uint64_t next_id = 0;

  Impl(std::vector<CollisionGeometry> its_geometries, PairRule its_rule, const DetectorSettings& its_settings)
      : geometries(std::move(its_geometries)),
        solids(make_solids(geometries)),
        settings(its_settings),
        rule(std::move(its_rule)),
        placements(geometries.size()),
        bounds(geometries.size()) {
    const bool many = static_cast<int>(geometries.size()) >= settings.tree_from;
    if (!many || rule.is_list()) listed = rule.pairs();
    use_tree = many && (!rule.is_list() || listed.size() > kFewPairs * geometries.size());
    if (use_tree) listed.clear(), listed.shrink_to_fit();
    for (int k = 0; k < static_cast<int>(geometries.size()); ++k)
      (geometries[k].shape.type == ShapeType::HalfSpace ? half_spaces : bounded).push_back(k);
    std::vector<double> radii;
    for (const int k : bounded) radii.push_back(solids[k].radius);
    if (radii.empty()) return;
    const auto median = radii.begin() + static_cast<std::ptrdiff_t>(radii.size() / 2);
    std::nth_element(radii.begin(), median, radii.end());
    skin = kSkin * *median;
  }

  void place(const std::vector<Placement>& frames) {
    for (std::size_t k = 0; k < geometries.size(); ++k) {
      const CollisionGeometry& geometry = geometries[k];
      const Solid& solid = solids[k];
      Placement& placement = placements[k];
      Bounds& bound = bounds[k];
      const auto frame = static_cast<std::size_t>(geometry.frame);
      if (frame < frames.size()) placement = frames[frame] * geometry.placement;
      const double sum = placement.rotation.sum() + placement.translation.sum();
      if (frame >= frames.size() || !std::isfinite(sum)) {
        // Takes no part: its ball and its box meet nothing.
        placement.translation.setConstant(std::numeric_limits<double>::quiet_NaN());
        bound.centre.setConstant(std::numeric_limits<double>::quiet_NaN());
        bound.lower.setConstant(kInfinity), bound.upper.setConstant(-kInfinity);
        bound.radius = std::numeric_limits<double>::quiet_NaN();
        continue;
      }
      bound.centre = placement * solid.centre;
      bound.radius = solid.radius;
      if (solid.type == ShapeType::HalfSpace) continue;
      const Vector3 reach = placement.rotation.cwiseAbs() * solid.half_extents;
      bound.lower = bound.centre - reach, bound.upper = bound.centre + reach;
    }
  }

  bool are_near(int a, int b) const {
    const Bounds &p = bounds[a], &q = bounds[b];
    if (solids[a].type == ShapeType::HalfSpace) return above(a, q);
    if (solids[b].type == ShapeType::HalfSpace) return above(b, p);
    const double reach = p.radius + q.radius + settings.margin;
    if (!((p.centre - q.centre).squaredNorm() <= reach * reach)) return false;
    return ((p.lower - q.upper).array() <= settings.margin).all() &&
           ((q.lower - p.upper).array() <= settings.margin).all();
  }

  /// Whether a ball reaches down to a half space; NaN does not.
  bool above(int half_space, const Bounds& bound) const {
    const Placement& plane = placements[half_space];
    const double height = plane.rotation.col(2).dot(bound.centre - plane.translation);
    return height <= bound.radius + settings.margin;
  }

  void find_near_pairs() {
    near.clear();
    if (!use_tree) {
      for (const auto& pair : listed)
        if (are_near(pair.first, pair.second)) near.push_back(pair);
      return;
    }
    if (!within_old_bounds()) list_candidates();
    for (const auto& pair : candidates)
      if (are_near(pair.first, pair.second)) near.push_back(pair);
  }

  /// Every box lies in the one that the candidates were listed with, widened by the skin.
  bool within_old_bounds() const {
    if (old_bounds.size() != bounds.size()) return false;
    for (const int k : bounded) {
      const Bounds &now = bounds[k], &old = old_bounds[k];
      if (!((now.lower.array() >= old.lower.array() - skin).all() &&
            (now.upper.array() <= old.upper.array() + skin).all()))
        return false;
    }
    return true;
  }

  /// All pairs that can come near before a box leaves its old one by more than the skin.
  void list_candidates() {
    old_bounds = bounds;
    candidates.clear();
    for (const int h : half_spaces)
      for (const int k : bounded) {
        const auto [a, b] = std::minmax(h, k);
        if (rule.allows(a, b)) candidates.emplace_back(a, b);
      }
    tree.find_pairs(bounds, bounded, settings.margin + 2.0 * skin, [this](int a, int b) {
      if (rule.allows(a, b)) candidates.emplace_back(a, b);
    });
    std::sort(candidates.begin(), candidates.end());
  }

  void detect(const std::vector<Placement>& frames) {
    std::swap(points, old_points), std::swap(locals, old_locals), std::swap(pairs, old_pairs);
    points.clear(), locals.clear(), pairs.clear();
    place(frames);
    find_near_pairs();
    auto old_pair = old_pairs.cbegin();
    int old_point = 0;
    Manifold manifold;
    for (const auto& [a, b] : near) {
      while (old_pair != old_pairs.cend() && precedes(*old_pair, a, b)) ++old_pair;
      const bool known = old_pair != old_pairs.cend() && old_pair->a == a && old_pair->b == b;
      pairs.push_back({a, b, known ? old_pair->memory : PairMemory()});
      narrow_phase.collide(solids[a], placements[a], solids[b], placements[b], settings.margin, pairs.back().memory,
                           manifold);
      if (manifold.count > 0) append(a, b, manifold, old_point);
    }
  }

  /// Adds a pair's points, each with the old point of the pair that it continues. `old_point` walks along the old list.
  void append(int a, int b, const Manifold& manifold, int& old_point) {
    const int old_count = static_cast<int>(old_points.size());
    const auto compare = [&](int k) {
      const ContactPoint& p = old_points[k];
      return p.geometry_a != a ? p.geometry_a - a : p.geometry_b - b;
    };
    while (old_point < old_count && compare(old_point) < 0) ++old_point;
    int old_size = 0;
    while (old_size < Manifold::kMost && old_point + old_size < old_count && compare(old_point + old_size) == 0)
      ++old_size;

    const Placement to_a = placements[a].inverse(), to_b = placements[b].inverse();
    std::array<LocalPair, Manifold::kMost> local;
    for (int k = 0; k < manifold.count; ++k)
      local[k] = {to_a * manifold.points[k].on_a, to_b * manifold.points[k].on_b};

    // The nearest of all pairs old-new first. On a wheel the point stays where it is on the ground, under a sliding box
    // where it is on the box: the frame in which it moved less counts.
    std::array<std::array<double, Manifold::kMost>, Manifold::kMost> moved;
    for (int i = 0; i < manifold.count; ++i)
      for (int j = 0; j < old_size; ++j)
        moved[i][j] = std::min((local[i].on_a - old_locals[old_point + j].on_a).squaredNorm(),
                               (local[i].on_b - old_locals[old_point + j].on_b).squaredNorm());
    std::array<int, Manifold::kMost> heir, parent;  // of old, of new
    heir.fill(-1), parent.fill(-1);
    for (int round = std::min(manifold.count, old_size); round > 0; --round) {
      double least = settings.match_distance * settings.match_distance;
      int best_i = -1, best_j = -1;
      for (int i = 0; i < manifold.count; ++i)
        for (int j = 0; j < old_size; ++j)
          if (parent[i] < 0 && heir[j] < 0 && moved[i][j] <= least && (best_i < 0 || moved[i][j] < least))
            least = moved[i][j], best_i = i, best_j = j;
      if (best_i < 0) break;
      parent[best_i] = best_j, heir[best_j] = best_i;
    }

    // Heirs in the order of those before them, so that a patch keeps its order.
    const auto add = [&](int k) {
      const SurfacePair& from = manifold.points[k];
      ContactPoint point;
      point.geometry_a = a, point.geometry_b = b;
      point.position = 0.5 * (from.on_a + from.on_b);
      point.normal = from.normal;
      point.distance = from.gap;
      point.patch_size = manifold.count;
      point.previous = parent[k] < 0 ? -1 : old_point + parent[k];
      point.id = parent[k] < 0 ? next_id++ : old_points[point.previous].id;
      points.push_back(point);
      locals.push_back(local[k]);
    };
    for (int j = 0; j < old_size; ++j)
      if (heir[j] >= 0) add(heir[j]);
    for (int k = 0; k < manifold.count; ++k)
      if (parent[k] < 0) add(k);
    old_point += old_size;
  }

  void forget() { points.clear(), locals.clear(), pairs.clear(); }
};

Detector::Detector(std::vector<CollisionGeometry> geometries, const std::vector<std::pair<int, int>>& pairs,
                   const DetectorSettings& settings) {
  settings.validate();
  check_pairs(geometries, pairs);
  PairRule rule(geometries.size(), pairs);
  impl_ = std::make_unique<Impl>(std::move(geometries), std::move(rule), settings);
}

Detector::Detector(std::vector<CollisionGeometry> geometries, const CollisionFilter& filter,
                   const DetectorSettings& settings) {
  settings.validate();
  PairRule rule(geometries, filter);
  impl_ = std::make_unique<Impl>(std::move(geometries), std::move(rule), settings);
}

Detector::~Detector() = default;
Detector::Detector(Detector&&) noexcept = default;
Detector& Detector::operator=(Detector&&) noexcept = default;

const std::vector<ContactPoint>& Detector::detect(const std::vector<Placement>& frames) {
  impl_->detect(frames);
  return impl_->points;
}

const std::vector<ContactPoint>& Detector::points() const { return impl_->points; }

void Detector::reset() { impl_->forget(); }

std::string Detector::save() const {
  Writer out;
  out.bytes = kMagic;
  out.put(static_cast<std::uint64_t>(impl_->geometries.size()));
  out.put(impl_->next_id);
  out.put(static_cast<std::uint64_t>(impl_->points.size()));
  for (std::size_t k = 0; k < impl_->points.size(); ++k) {
    const ContactPoint& point = impl_->points[k];
    out.put(point.geometry_a), out.put(point.geometry_b);
    out.put(point.position), out.put(point.normal), out.put(point.distance);
    out.put(point.patch_size), out.put(point.previous), out.put(point.id);
    out.put(impl_->locals[k].on_a), out.put(impl_->locals[k].on_b);
  }
  out.put(static_cast<std::uint64_t>(impl_->pairs.size()));
  for (const NearPair& pair : impl_->pairs) {
    out.put(pair.a), out.put(pair.b);
    out.put(pair.memory.guess), out.put(pair.memory.hint_a), out.put(pair.memory.hint_b);
  }
  return out.bytes;
}

void Detector::load(const std::string& bytes) {
  const auto refuse = [] { throw InvalidInput("detector", "these bytes are not what save() of such a detector gave"); };
  const std::size_t length = std::strlen(kMagic);
  if (bytes.compare(0, length, kMagic) != 0) refuse();
  const int count = static_cast<int>(impl_->geometries.size());
  const auto is_pair = [&](int a, int b) { return 0 <= a && a < b && b < count; };
  Reader in{bytes, length};
  if (in.take<std::uint64_t>() != impl_->geometries.size()) refuse();
  const auto next_id = in.take<std::uint64_t>();
  std::vector<ContactPoint> points;
  std::vector<LocalPair> locals;
  for (auto left = in.take<std::uint64_t>(); left > 0 && !in.failed; --left) {
    ContactPoint point;
    point.geometry_a = in.take<int>(), point.geometry_b = in.take<int>();
    point.position = in.take_vector(), point.normal = in.take_vector(), point.distance = in.take<double>();
    point.patch_size = in.take<int>(), point.previous = in.take<int>(), point.id = in.take<std::uint64_t>();
    const Vector3 on_a = in.take_vector(), on_b = in.take_vector();
    in.failed = in.failed || !is_pair(point.geometry_a, point.geometry_b) || point.id >= next_id;
    points.push_back(point);
    locals.push_back({on_a, on_b});
  }
  std::vector<NearPair> pairs;
  for (auto left = in.take<std::uint64_t>(); left > 0 && !in.failed; --left) {
    NearPair pair;
    pair.a = in.take<int>(), pair.b = in.take<int>();
    pair.memory.guess = in.take_vector();
    pair.memory.hint_a = in.take<int>(), pair.memory.hint_b = in.take<int>();
    in.failed = in.failed || !is_pair(pair.a, pair.b) || (!pairs.empty() && !precedes(pairs.back(), pair.a, pair.b));
    pairs.push_back(pair);
  }
  if (in.failed || in.at != bytes.size()) refuse();
  impl_->points = std::move(points);
  impl_->locals = std::move(locals);
  impl_->pairs = std::move(pairs);
  impl_->next_id = next_id;
}

}  // namespace signorini
