#include "signorini/collision/detector.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>

#include "broad_phase.hpp"
#include "narrow_phase.hpp"
#include "require.hpp"
#include "signorini/errors.hpp"
#include "sweep.hpp"

namespace signorini {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// A list with fewer pairs a geometry than this is looked through one by one, however many geometries there are.
constexpr double kSkin = 0.3;  // how far a box may move before the candidates are listed again, of the median radius
constexpr std::size_t kFewPairs = 8;
constexpr double kTouches = 1e-6;   // [m] what is nearer is not swept: its contact acts already
constexpr double kHugs = 5e-7;      // [m] what touches may sink in by so much more before it meets again
constexpr double kSinksDeep = 0.1;  // of the margin: how much deeper such a pair may go in a step
constexpr double kSameTime = 1e-9;  // of the step: meetings nearer in time than this are one
const FrameMotion kAtRest;
constexpr char kMagic[] = "signorini detector 3";

/// A pair whose bounds were near in the last step.
struct NearPair {
  int a, b;
  PairMemory memory;
};

/// A pair that meets in this step.
struct Hit {
  int a, b;
  double sinks;  // see Detector::Impl::sinks()
  Meeting meeting;
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
    throw InvalidInput("margin", "is " + in_full(margin) + ", must be in [0, 1e3] m");
  if (!(sweep_from >= 0.0 && sweep_from <= 1e3))
    throw InvalidInput("sweep_from", "is " + in_full(sweep_from) + ", must be in [0, 1e3] m");
  if (!(match_distance >= 0.0 && match_distance <= 1e3))
    throw InvalidInput("match_distance", "is " + in_full(match_distance) + ", must be in [0, 1e3] m");
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

  // Of a step with fast geometries: what sweeps are made with
  const std::vector<FrameMotion>* motions = nullptr;
  double duration = 0.0;
  std::vector<double> travel;   // how far a geometry's points go at most [m]; empty: nothing is fast
  std::vector<double> turning;  // how fast by turning [m/s]
  std::vector<Bounds> swept;    // bounds over the whole step
  std::vector<Hit> hits;
  std::vector<double> first_hit;  // by frame
  // From one add_meetings() to the next of a step: what neither moves otherwise nor has got points meets the same.
  std::vector<FrameMotion> told;      // the last motions; empty: all are new
  std::vector<std::uint8_t> changed;  // by frame
  double told_touching = 0.0;
  std::vector<double> shares;  // likewise; see Detector::shares()

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
      bound.radius = solid.type == ShapeType::HalfSpace ? kInfinity : solid.radius;
      if (solid.type == ShapeType::HalfSpace) continue;
      const Vector3 reach = placement.rotation.cwiseAbs() * solid.half_extents;
      bound.lower = bound.centre - reach, bound.upper = bound.centre + reach;
    }
  }

  bool are_near(int a, int b) const {
    const Bounds &p = bounds[a], &q = bounds[b];
    const double reach = p.radius + q.radius + settings.margin;  // infinite with a half space
    return (p.centre - q.centre).squaredNorm() <= reach * reach && boxes_meet(a, b);
  }

  /// Of two balls that do.
  bool boxes_meet(int a, int b) const {
    const Bounds &p = bounds[a], &q = bounds[b];
    if (solids[a].type == ShapeType::HalfSpace) return ball_comes_down(a, q) && box_comes_down(a, q);
    if (solids[b].type == ShapeType::HalfSpace) return ball_comes_down(b, p) && box_comes_down(b, p);
    return ((p.lower - q.upper).array() <= settings.margin).all() &&
           ((q.lower - p.upper).array() <= settings.margin).all();
  }

  /// Whether a ball reaches down to a half space; NaN does not.
  bool ball_comes_down(int half_space, const Bounds& bound) const {
    const Placement& plane = placements[half_space];
    const double height = plane.rotation.col(2).dot(bound.centre - plane.translation);
    return height <= bound.radius + settings.margin;
  }

  bool box_comes_down(int half_space, const Bounds& bound) const {
    const Vector3 normal = placements[half_space].rotation.col(2);
    const Vector3 middle = 0.5 * (bound.lower + bound.upper), half = 0.5 * (bound.upper - bound.lower);
    return normal.dot(middle - placements[half_space].translation) - normal.cwiseAbs().dot(half) <= settings.margin;
  }

  void find_near_pairs() {
    near.clear();
    if (!use_tree) {
      for (const auto& pair : listed)
        if (are_near(pair.first, pair.second)) near.push_back(pair);
      return;
    }
    if (!within_old_bounds(bounds)) list_candidates(bounds);
    for (const auto& pair : candidates)
      if (are_near(pair.first, pair.second)) near.push_back(pair);
  }

  /// The fast pairs that may come near during the step, and those that are near now; of those that have changed.
  void find_pairs_of_fast_step(bool with_near) {
    near.clear();
    const auto look = [this, with_near](const std::pair<int, int>& pair) {
      const auto& [a, b] = pair;
      if (!told.empty() && !has_changed(a) && !has_changed(b)) return;
      if ((is_fast(a, b) && may_meet(a, b)) || (with_near && are_near(a, b))) near.push_back(pair);
    };
    if (!use_tree) {
      for (const auto& pair : listed) look(pair);
      return;
    }
    if (!within_old_bounds(swept)) list_candidates(swept);
    for (const auto& pair : candidates) look(pair);
  }

  bool has_changed(int geometry) const {
    const auto frame = static_cast<std::size_t>(geometries[geometry].frame);
    return frame < changed.size() && changed[frame];
  }

  bool is_fast(int a, int b) const { return travel[a] + travel[b] > settings.sweep_from; }

  bool may_meet(int a, int b) const {
    const Bounds &p = swept[a], &q = swept[b];
    if (solids[a].type == ShapeType::HalfSpace) return box_comes_down(a, q);
    if (solids[b].type == ShapeType::HalfSpace) return box_comes_down(b, p);
    return ((p.lower - q.upper).array() <= settings.margin).all() &&
           ((q.lower - p.upper).array() <= settings.margin).all();
  }

  const FrameMotion& motion(int geometry) const {
    const auto frame = static_cast<std::size_t>(geometries[geometry].frame);
    return frame == 0 || frame >= motions->size() ? kAtRest : (*motions)[frame];
  }
  Moving moving(int geometry) const { return {solids[geometry], placements[geometry], motion(geometry)}; }

  /// How far geometries go, and their bounds on the way; false if no pair can be fast. After place().
  bool set_motions(const std::vector<FrameMotion>& its_motions, double its_duration) {
    motions = &its_motions, duration = its_duration;
    if (told.empty()) {
      travel.assign(geometries.size(), 0.0);
      turning.assign(geometries.size(), 0.0);
      swept = bounds;
    }
    double most = 0.0;
    for (std::size_t k = 0; k < geometries.size(); ++k) {
      if (!told.empty()) {
        if (!has_changed(static_cast<int>(k))) {
          most = std::max(most, travel[k]);
          continue;
        }
        travel[k] = turning[k] = 0.0;
        swept[k] = bounds[k];
      }
      if (geometries[k].frame == 0 || std::isnan(bounds[k].radius)) continue;
      const FrameMotion& its = motion(static_cast<int>(k));
      const double angular = its.angular.norm();
      turning[k] = angular > 0.0 ? angular * arm(solids[k], bounds[k].centre, its) : 0.0;
      const double length = duration * (its.velocity.norm() + turning[k]);
      if (!std::isfinite(length)) continue;
      travel[k] = length;
      most = std::max(most, length);
      // A turn moves a point by its arc, at most twice its arm.
      const double turn = angular > 0.0 ? std::min(2.0, duration * angular) * turning[k] / angular : 0.0;
      const Vector3 way = duration * its.velocity;
      swept[k].lower += way.cwiseMin(0.0) - Vector3::Constant(turn);
      swept[k].upper += way.cwiseMax(0.0) + Vector3::Constant(turn);
    }
    if (2.0 * most > settings.sweep_from) return true;
    travel.clear();
    told.clear();
    return false;
  }

  /// Every box lies in the one that the candidates were listed with, widened by the skin.
  bool within_old_bounds(const std::vector<Bounds>& boxes) const {
    if (old_bounds.size() != boxes.size()) return false;
    for (const int k : bounded) {
      const Bounds &now = boxes[k], &old = old_bounds[k];
      if (!((now.lower.array() >= old.lower.array() - skin).all() &&
            (now.upper.array() <= old.upper.array() + skin).all()))
        return false;
    }
    return true;
  }

  /// All pairs that can come near before a box leaves its old one by more than the skin.
  void list_candidates(const std::vector<Bounds>& now) {
    old_bounds = now;
    candidates.clear();
    for (const int h : half_spaces)
      for (const int k : bounded) {
        const auto [a, b] = std::minmax(h, k);
        if (rule.allows(a, b)) candidates.emplace_back(a, b);
      }
    tree.find_pairs(now, bounded, settings.margin + 2.0 * skin, [this](int a, int b) {
      if (rule.allows(a, b)) candidates.emplace_back(a, b);
    });
    std::sort(candidates.begin(), candidates.end());
  }

  void detect(const std::vector<Placement>& frames, const std::vector<FrameMotion>* its_motions = nullptr,
              double its_duration = 0.0) {
    std::swap(points, old_points), std::swap(locals, old_locals), std::swap(pairs, old_pairs);
    points.clear(), locals.clear(), pairs.clear(), travel.clear(), shares.clear(), told.clear(), hits.clear();
    place(frames);
    if (its_motions && set_motions(*its_motions, its_duration))
      find_pairs_of_fast_step(true);
    else
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
      if (manifold.count == 0) continue;
      if (gives_way(a, b)) manifold.drop_spare();
      if (!travel.empty() && must_sweep(a, b) && nearest(manifold) > kTouches) continue;
      append(a, b, manifold, old_point);
    }
    if (!travel.empty()) add_first_meetings(false, 0.0, false);
  }

  static double nearest(const Manifold& manifold) {
    double least = kInfinity;
    for (int k = 0; k < manifold.count; ++k) least = std::min(least, manifold.points[k].gap);
    return least;
  }

  bool must_sweep(int a, int b) const {
    if (!is_fast(a, b)) return false;
    const double apart = (motion(b).velocity - motion(a).velocity).norm() + turning[a] + turning[b];
    if (apart * duration <= settings.sweep_from) return false;
    return closing_speed(moving(a), moving(b), duration) * duration > settings.sweep_from;
  }

  /// How many points of a pair there are, and where in the list, or where they would be.
  std::pair<int, int> find_points(int a, int b) const {
    const auto before = [](const ContactPoint& p, const std::pair<int, int>& pair) {
      return std::make_pair(p.geometry_a, p.geometry_b) < pair;
    };
    auto it = std::lower_bound(points.begin(), points.end(), std::make_pair(a, b), before);
    const int at = static_cast<int>(it - points.begin());
    int count = 0;
    for (; it != points.end() && it->geometry_a == a && it->geometry_b == b; ++it) ++count;
    return {count, at};
  }

  /// Sweeps the fast pairs of `near` and adds the points where they meet; of each frame's meetings the first, or all.
  /// again: after a motion that obeys the points there are; pairs that have some may meet elsewhere.
  /// Where that is of no use: holds the frames back. add: false: in any case.
  bool add_first_meetings(bool all, double touching, bool again, bool add = true) {
    shares.clear();
    const auto is_old = [this](const Hit& hit) { return has_changed(hit.a) || has_changed(hit.b); };
    hits.erase(std::remove_if(hits.begin(), hits.end(), is_old), hits.end());
    const std::size_t kept = hits.size();
    for (const auto& [a, b] : near) {
      if (!must_sweep(a, b)) continue;
      const int known = find_points(a, b).first;
      if (known > 0 && !(again && may_meet_again(a, b))) continue;
      Hit hit{a, b, known > 0 ? sinks(a, b) : 0.0, {}};
      if (find_meeting(narrow_phase, moving(a), moving(b), duration, settings.margin, known > 0 ? kHugs : -touching,
                       hit.sinks, hit.meeting))
        hits.push_back(hit);
    }
    if (kept > 0 && kept < hits.size())
      std::sort(hits.begin(), hits.end(),
                [](const Hit& x, const Hit& y) { return std::make_pair(x.a, x.b) < std::make_pair(y.a, y.b); });
    changed.assign(motions->size(), 0);
    if (hits.empty()) return false;
    first_hit.assign(motions->size(), kInfinity);
    const auto frames_of = [this](const Hit& hit) {
      return std::array<std::size_t, 2>{static_cast<std::size_t>(geometries[hit.a].frame),
                                        static_cast<std::size_t>(geometries[hit.b].frame)};
    };
    for (const Hit& hit : hits)
      for (const std::size_t frame : frames_of(hit))
        if (frame > 0) first_hit[frame] = std::min(first_hit[frame], hit.meeting.time);
    bool any = false;
    for (const Hit& found : hits) {
      bool first = true;
      for (const std::size_t frame : frames_of(found))
        first = first && (frame == 0 || found.meeting.time <= first_hit[frame] + kSameTime * duration);
      if (!first && !all) continue;
      Hit hit = found;
      if (add && insert(hit, touching)) {
        any = true;
        for (const std::size_t frame : frames_of(hit)) changed[frame] = frame > 0;
        continue;
      }
      // What is convex and touches already is held only before it sinks in deep, so that it gets on in every step: its
      // points keep it apart but for what it turns off the straight way.
      if (find_points(hit.a, hit.b).first > 0 && !is_field(hit.a) && !is_field(hit.b) &&
          !find_meeting(narrow_phase, moving(hit.a), moving(hit.b), duration, settings.margin,
                        kSinksDeep * settings.margin, hit.sinks, hit.meeting))
        continue;
      if (shares.empty()) shares.assign(motions->size(), 1.0);
      for (const std::size_t frame : frames_of(hit))
        shares[frame] = std::min(shares[frame], std::max(0.0, hit.meeting.time / duration));
    }
    return any;
  }

  bool is_field(int geometry) const { return solids[geometry].type == ShapeType::HeightField; }

  bool gives_way(int a, int b) const { return geometries[a].gives_way || geometries[b].gives_way; }

  /// A plane keeps apart what is convex and goes straight, but height fields have many, and what turns goes along arcs.
  bool may_meet_again(int a, int b) const {
    if (is_field(a) || is_field(b)) return true;
    const auto bends = [this](int geometry) {
      const Moving its = moving(geometry);
      return 0.5 * duration * duration * its.motion.angular.squaredNorm() * its.arm();
    };
    return bends(a) + bends(b) > kHugs;
  }

  /// [m] How deep a pair sinks in by the planes of its points, which the law lets compliant ones do: that they do is no
  /// second meeting. 0 where none gets deeper than it is.
  double sinks(int a, int b) const {
    const auto [known, at] = find_points(a, b);
    const FrameMotion of_a = motion(a), of_b = motion(b);
    double deepest = 0.0;
    for (int k = at; k < at + known; ++k) {
      const ContactPoint& point = points[k];
      const Vector3 arm_a = point.position - point.way_a - of_a.centre,
                    arm_b = point.position - point.way_b - of_b.centre;
      const Vector3 moves = of_b.velocity + of_b.start.cross(arm_b) - of_a.velocity - of_a.start.cross(arm_a);
      const double end = point.distance + duration * point.normal.dot(moves);
      if (end < std::min(0.0, point.distance) - kHugs) deepest = std::max(deepest, -end);
    }
    return deepest;
  }

  /// Adds the points of a meeting at their place in the list; false if none would change the motion.
  bool insert(Hit& hit, double touching) {
    if (gives_way(hit.a, hit.b)) hit.meeting.manifold.drop_spare();
    const auto [known, at] = find_points(hit.a, hit.b);
    const Moving a = moving(hit.a), b = moving(hit.b);
    const double time = hit.meeting.time;
    Manifold manifold;
    bool useful = false;  // the motion violates it, more than it does the pair's own
    double least = 0.0;   // gap that a point may have, so that what holds them apart gives no energy
    if (hit.sinks > 0.0)
      for (int k = at; k < at + known; ++k) least = std::min(least, points[k].distance);
    const auto velocity_now = [time](const FrameMotion& motion, const Vector3& point) -> Vector3 {
      return motion.velocity + motion.start.cross(point - motion.centre - time * motion.velocity);
    };
    for (int k = 0; k < hit.meeting.manifold.count; ++k) {
      SurfacePair point = hit.meeting.manifold.points[k];
      const double rate = point.normal.dot(b.velocity(point.on_b, time) - a.velocity(point.on_a, time));
      const double now = point.normal.dot(velocity_now(b.motion, point.on_b) - velocity_now(a.motion, point.on_a));
      // What the motion leads to if they went on through each other, and from there back to the start: gap - time *
      // rate where nothing turns.
      point.gap = (hit.sinks > 0.0 ? point.gap : std::max(0.0, point.gap)) + (duration - time) * rate - duration * now;
      point.gap = std::max(least, point.gap);
      useful = useful || point.gap + duration * now < -hit.sinks;
      manifold.add(point);
    }
    if (!useful && (touching == 0.0 || known > 0)) return false;
    if (manifold.count == 0) return false;
    const auto before = [](const ContactPoint& p, const Hit& other) {
      return std::make_pair(p.geometry_a, p.geometry_b) < std::make_pair(other.a, other.b);
    };
    int old_point = known > 0 ? static_cast<int>(old_points.size())  // each old point is continued once
                              : static_cast<int>(std::lower_bound(old_points.begin(), old_points.end(), hit, before) -
                                                 old_points.begin());
    const auto size = static_cast<std::ptrdiff_t>(points.size());
    const std::ptrdiff_t to = at + known;
    const Placement places[2] = {placements[hit.a], placements[hit.b]};
    placements[hit.a] = a.at(time), placements[hit.b] = b.at(time);
    append(hit.a, hit.b, manifold, old_point);
    placements[hit.a] = places[0], placements[hit.b] = places[1];
    int held = 0, added = 0;  // without spare ones
    for (int k = 0; k < known; ++k) held += points[at + k].spare ? 0 : 1;
    for (std::ptrdiff_t k = size; k < static_cast<std::ptrdiff_t>(points.size()); ++k) {
      added += points[k].spare ? 0 : 1;
      points[k].swept = true;
      points[k].way_a = time * a.motion.velocity, points[k].way_b = time * b.motion.velocity;
      points[k].patch_size += held;
    }
    for (int k = 0; k < known; ++k) points[at + k].patch_size += added;
    std::rotate(points.begin() + to, points.begin() + size, points.end());
    std::rotate(locals.begin() + to, locals.begin() + size, locals.end());
    return true;
  }

  bool add_meetings(const std::vector<FrameMotion>& its_motions, double its_duration, bool all, double touching,
                    bool add = true) {
    shares.clear();
    if (told.size() != its_motions.size() || touching != told_touching || its_duration != duration) told.clear();
    if (told.empty()) hits.clear();
    changed.resize(its_motions.size(), std::uint8_t{0});
    for (std::size_t f = 0; f < told.size(); ++f)
      changed[f] |= std::memcmp(&told[f], &its_motions[f], sizeof(FrameMotion)) != 0;
    if (!set_motions(its_motions, its_duration)) return false;
    find_pairs_of_fast_step(false);
    told = its_motions, told_touching = touching;
    return add_first_meetings(all, touching, true, add);
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

    int patch_size = 0;
    for (int k = 0; k < manifold.count; ++k) patch_size += manifold.points[k].spare ? 0 : 1;
    const Placement to_a = placements[a].inverse(), to_b = placements[b].inverse();
    std::array<LocalPair, Manifold::kMost> local;
    for (int k = 0; k < manifold.count; ++k)
      local[k] = {to_a * manifold.points[k].on_a, to_b * manifold.points[k].on_b};

    // The nearest of all pairs old-new first. On a wheel the point stays where it is on the ground, under a sliding box
    // where it is on the box: the frame in which it moved less counts.
    std::array<std::array<double, Manifold::kMost>, Manifold::kMost> moved;
    std::array<int, Manifold::kMost> heir, parent;  // of old, of new
    std::fill_n(heir.begin(), old_size, -1), std::fill_n(parent.begin(), manifold.count, -1);
    const double farthest = settings.match_distance * settings.match_distance;
    bool clear = true;  // each has another nearest, so that the order does not matter
    for (int i = 0; i < manifold.count; ++i) {
      double least = farthest;
      for (int j = 0; j < old_size; ++j) {
        moved[i][j] = std::min((local[i].on_a - old_locals[old_point + j].on_a).squaredNorm(),
                               (local[i].on_b - old_locals[old_point + j].on_b).squaredNorm());
        if (moved[i][j] < least || (moved[i][j] == least && parent[i] < 0)) least = moved[i][j], parent[i] = j;
      }
      if (parent[i] < 0) continue;
      clear = clear && heir[parent[i]] < 0;
      heir[parent[i]] = i;
    }
    if (!clear) std::fill_n(heir.begin(), old_size, -1), std::fill_n(parent.begin(), manifold.count, -1);
    for (int round = clear ? 0 : std::min(manifold.count, old_size); round > 0; --round) {
      double least = farthest;
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
      point.spare = from.spare;
      point.patch_size = patch_size;
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

  void forget() { points.clear(), locals.clear(), pairs.clear(), told.clear(); }
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

const std::vector<ContactPoint>& Detector::detect(const std::vector<Placement>& frames,
                                                  const std::vector<FrameMotion>& motions, double duration) {
  impl_->detect(frames, &motions, duration);
  return impl_->points;
}

bool Detector::add_meetings(const std::vector<FrameMotion>& motions, double duration, bool all, double touching) {
  return impl_->add_meetings(motions, duration, all, touching);
}

void Detector::hold_back(const std::vector<FrameMotion>& motions, double duration) {
  impl_->add_meetings(motions, duration, false, 0.0, false);
}

const std::vector<double>& Detector::shares() const { return impl_->shares; }

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
    out.put(static_cast<std::uint8_t>((point.swept ? 1 : 0) + (point.spare ? 2 : 0))), out.put(point.way_a),
        out.put(point.way_b);
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
    const auto kind = in.take<std::uint8_t>();
    point.swept = (kind & 1) != 0, point.spare = (kind & 2) != 0, point.way_a = in.take_vector(),
    point.way_b = in.take_vector();
    const Vector3 on_a = in.take_vector(), on_b = in.take_vector();
    in.failed = in.failed || kind > 3 || !is_pair(point.geometry_a, point.geometry_b) || point.id >= next_id;
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
  impl_->told.clear();
  impl_->next_id = next_id;
}

}  // namespace signorini
