#include "height_field.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "closed_forms.hpp"

namespace signorini {
namespace {

constexpr double kFlat = 1e-5;        // [rad] triangles that turn less are one plane
constexpr double kConeSlack = 0.05;   // [rad] a patch on a face reaches to the edges of the face
constexpr double kRoundSlack = 1e-8;  // the same for shapes that touch in one point
constexpr double kSamePlane = 1e-10;  // [rad], [m]
constexpr double kOnEdge = 1e-10;     // of a cell
constexpr double kSamePoint = 1e-5;   // relative to the size of the other shape
constexpr double kSameCosine = 1.0 - 1e-6;
constexpr double kTouching = 1e-9;  // relative to the size of the other shape: depths below this are rounding
constexpr double kFar = std::numeric_limits<double>::infinity();
constexpr double kFarPast = 4.0;  // of the depth
constexpr double kGapWeight = 10.0;
constexpr std::size_t kMostCandidates = 128, kKeptCandidates = 32;

/// Two sit in each cell, to the right (side 0) and to the left (side 1) of its diagonal.
struct Triangle {
  int row = 0, column = 0, side = 0;
  double slope_x = 0.0, slope_y = 0.0;
  Vector3 origin = Vector3::Zero(), normal = Vector3::UnitZ();  // origin: where the diagonal starts

  double height(const Vector3& point) const { return normal.dot(point - origin); }
  bool precedes(const Triangle& other) const {
    if (row != other.row) return row < other.row;
    return column != other.column ? column < other.column : side < other.side;
  }
};

using Inside = std::array<double, 3>;

struct Grid {
  const HeightGrid& samples;
  double step_x, step_y, per_x, per_y;  // and their inverses
  Inside across;                        // horizontal, from an edge to the corner across it

  explicit Grid(const HeightGrid& grid)
      : samples(grid),
        step_x(2.0 * grid.half_x / (grid.columns - 1)),
        step_y(2.0 * grid.half_y / (grid.rows - 1)),
        per_x(1.0 / step_x),
        per_y(1.0 / step_y),
        across{step_y, step_x, step_x * step_y / std::hypot(step_x, step_y)} {}

  double height(int row, int column) const {
    return samples.heights[static_cast<std::size_t>(row) * static_cast<std::size_t>(samples.columns) +
                           static_cast<std::size_t>(column)];
  }
  Vector3 vertex(int row, int column) const {
    return {column * step_x - samples.half_x, row * step_y - samples.half_y, height(row, column)};
  }
  bool has(int row, int column) const {
    return row >= 0 && column >= 0 && row < samples.rows && column < samples.columns;
  }
  int column_of(double x) const { return cell(x, samples.half_x, step_x, samples.columns); }
  int row_of(double y) const { return cell(y, samples.half_y, step_y, samples.rows); }

  Triangle triangle(int row, int column, int side) const {
    const double start = height(row, column), end = height(row + 1, column + 1);
    const double corner = side == 0 ? height(row, column + 1) : height(row + 1, column);
    Triangle t;
    t.row = row, t.column = column, t.side = side, t.origin = vertex(row, column);
    t.slope_x = (side == 0 ? corner - start : end - corner) * per_x;
    t.slope_y = (side == 0 ? end - corner : corner - start) * per_y;
    t.normal = Vector3(-t.slope_x, -t.slope_y, 1.0).normalized();
    return t;
  }
  /// What lies across edge k of a triangle: 0 the side along x, 1 that along y, 2 the diagonal; false at the border.
  /// `out`: horizontal, unit, from one to the other.
  bool neighbour(const Triangle& t, int k, Triangle& other, Vector3& out) const {
    const double forward = t.side == 0 ? 1.0 : -1.0;
    int row = t.row, column = t.column;
    if (k == 0) {
      out = {0.0, -forward, 0.0};
      row -= t.side == 0 ? 1 : -1;
    } else if (k == 1) {
      out = {forward, 0.0, 0.0};
      column += t.side == 0 ? 1 : -1;
    } else {
      out = forward * Vector3(-step_y, step_x, 0.0).normalized();
    }
    if (!(row >= 0 && column >= 0 && row + 1 < samples.rows && column + 1 < samples.columns)) return false;
    other = triangle(row, column, 1 - t.side);
    return true;
  }
  /// Whether edge k of a triangle may be a ridge: if not, it is a plane or a valley, whatever rounding did. Each edge
  /// is looked at from one of its triangles.
  bool may_be_ridge(const Triangle& t, int k) const {
    const int row = t.row, column = t.column;
    const double a = height(row, column), c = height(row + 1, column + 1);
    if (k == 2) return t.side == 0 && a + c > height(row, column + 1) + height(row + 1, column);
    if (k == 0) return t.side == 0 && row > 0 && a - height(row - 1, column) > c - height(row, column + 1);
    return t.side == 1 && column > 0 && a - height(row, column - 1) > c - height(row + 1, column);
  }
  bool at_border(const Triangle& t, int k) const {
    if (k == 0) return t.side == 0 ? t.row == 0 : t.row + 2 == samples.rows;
    if (k == 1) return t.side == 0 ? t.column + 2 == samples.columns : t.column == 0;
    return false;
  }
  /// Where a point lies along three axes, each from an edge (as `neighbour` counts them) to the corner across it or
  /// beyond: from 0 to 1 inside.
  Inside inside(const Triangle& t, const Vector3& point) const {
    const double u = (point[0] + samples.half_x) * per_x - t.column, v = (point[1] + samples.half_y) * per_y - t.row;
    if (t.side == 0) return {v, 1.0 - u, u - v};
    return {1.0 - v, u, v - u};
  }
  /// Horizontal, from edge k out to a point with such a value.
  double distance(int k, double inside) const { return std::abs(inside) * across[k]; }
  Triangle under(const Vector3& point) const {
    const int row = row_of(point[1]), column = column_of(point[0]);
    const double u = (point[0] + samples.half_x) * per_x - column, v = (point[1] + samples.half_y) * per_y - row;
    return triangle(row, column, u >= v ? 0 : 1);
  }

 private:
  static int cell(double x, double half, double step, int count) {
    return static_cast<int>(std::clamp(std::floor((x + half) / step), 0.0, count - 2.0));
  }
};

/// How much the surface turns from one triangle to the next: positive for a ridge, negative for a valley, 0 for a
/// plane.
double ridge(const Triangle& t, const Triangle& other, const Vector3& across) {
  const double fall =
      (t.slope_x - other.slope_x) * across[0] + (t.slope_y - other.slope_y) * across[1];  // of slopes, across the edge
  const double turn = fall * t.normal[2] * other.normal[2];
  return std::abs(turn) < kFlat ? 0.0 : turn;
}

/// Directions along which the solid goes on from a point of its surface: no normal there points along any of them.
struct Around {
  int count = 0;
  std::array<Vector3, 8> directions;

  void add(const Vector3& direction) { directions[count++] = direction.normalized(); }
  bool allows(const Vector3& normal, double slack) const {
    for (int k = 0; k < count; ++k)
      if (!(normal.dot(directions[k]) <= slack)) return false;
    return true;
  }
};

/// A straight edge of the solid.
struct Edge {
  Vector3 from, to;
  std::array<Vector3, 2> normals;  // of the two faces
  Around inside, at_from, at_to;
};

}  // namespace

/// One call of collide(), in the frame of the field.
struct FieldContacts::Query {
  const Grid grid;
  const Solid& b;
  const Placement place;
  const double margin;
  ConvexPair& convex_pair;
  int& hint;
  Solid& segment;
  std::vector<SurfacePair>& candidates;

  const double touching, same_point;
  const bool round;                    // touches any plane in one point
  bool beside = false, under = false;  // where the centre of b is: the walls and the bottom count then only
  Vector3 centre, lower, upper;        // of b
  Triangle last;                       // the plane that `patch` was found with
  bool last_known = false;
  Manifold patch;
  enum Where { Outside, JustPast, Over };
  static constexpr int kMostSpare = 8;
  std::array<SurfacePair, kMostSpare> spare;  // points just past the edge of a ridge
  int spare_count = 0;

  Query(FieldContacts& owner, const HeightGrid& its_grid, const Solid& its_b, const Placement& its_place,
        double its_margin, ConvexPair& its_pair, int& its_hint)
      : grid(its_grid),
        b(its_b),
        place(its_place),
        margin(its_margin),
        convex_pair(its_pair),
        hint(its_hint),
        segment(owner.segment_),
        candidates(owner.candidates_),
        touching(kTouching * b.radius),
        same_point(kSamePoint * b.radius),
        round(b.type == ShapeType::Sphere || b.type == ShapeType::Ellipsoid) {
    candidates.clear();
    centre = place * b.centre;
    const Vector3 reach = place.rotation.cwiseAbs() * b.half_extents;
    lower = centre - reach - Vector3::Constant(margin), upper = centre + reach + Vector3::Constant(margin);
    beside = std::abs(centre[0]) > its_grid.half_x || std::abs(centre[1]) > its_grid.half_y;
    under = centre[2] < -its_grid.base;
  }

  bool run() {
    const HeightGrid& g = grid.samples;
    if (lower[0] > g.half_x || lower[1] > g.half_y || upper[0] < -g.half_x || upper[1] < -g.half_y) return false;
    const int first = grid.column_of(lower[0]), last_column = grid.column_of(upper[0]);
    for (int row = grid.row_of(lower[1]), last_row = grid.row_of(upper[1]); row <= last_row; ++row)
      for (int column = first; column <= last_column; ++column)
        if (ball_reaches(row, column))
          for (int side = 0; side < 2; ++side) visit(row, column, side);
    for (int k = 0; k < spare_count; ++k) {
      const auto same = [&](const SurfacePair& point) {
        return (point.on_b - spare[k].on_b).squaredNorm() < same_point * same_point;
      };
      if (std::none_of(candidates.begin(), candidates.end(), same)) add(spare[k]);
    }
    if (beside || under) walls();
    return true;
  }

  // Faces

  /// Whether a cell, seen from above, comes into the ball around b.
  bool ball_reaches(int row, int column) const {
    const double x = centre[0] + grid.samples.half_x - (column + 0.5) * grid.step_x;
    const double y = centre[1] + grid.samples.half_y - (row + 0.5) * grid.step_y;
    const double beyond_x = std::max(std::abs(x) - 0.5 * grid.step_x, 0.0);
    const double beyond_y = std::max(std::abs(y) - 0.5 * grid.step_y, 0.0), reach = b.radius + margin;
    return beyond_x * beyond_x + beyond_y * beyond_y <= reach * reach;
  }

  void visit(int row, int column, int side) {
    const double top = std::max({grid.height(row, column), grid.height(row + 1, column + 1),
                                 side == 0 ? grid.height(row, column + 1) : grid.height(row + 1, column)});
    if (top < lower[2]) return;
    const Triangle t = grid.triangle(row, column, side);
    if (gap_to_plane(t) > margin) return;
    face(t);
    edges(t);
  }

  double gap_to_plane(const Triangle& t) const {
    const Vector3 down = -(place.rotation.transpose() * t.normal);
    return t.height(place * b.support(down, hint)) - b.rounding;
  }

  void face(const Triangle& t) {
    if (!(last_known && (t.normal - last.normal).norm() < kSamePlane && std::abs(t.height(last.origin)) < kSamePlane)) {
      half_space(t.normal, t.origin);
      last = t, last_known = true;
    }
    if (patch.count == 0) return;
    const SurfacePair& lowest = *std::min_element(patch.points.begin(), patch.points.begin() + patch.count,
                                                  [](const auto& p, const auto& q) { return p.gap < q.gap; });
    // A plane that b reaches through somewhere else, where the surface has turned down from it, holds nothing but the
    // deepest point.
    const bool holds = lowest.gap >= -touching || depth_below_surface(lowest.on_b) >= 0.5 * -lowest.gap - touching;
    for (int k = 0; k < patch.count; ++k) {
      const SurfacePair& point = patch.points[k];
      if (!holds && point.gap > 0.5 * lowest.gap) continue;
      const Vector3 core = point.on_b + b.rounding * t.normal;
      const Where where = over(t, point, core);
      if (where == Outside || !nearest_exit(t, core)) continue;
      if (where == Over)
        add(point);
      else if (spare_count < kMostSpare)
        spare[spare_count++] = point;
    }
  }

  /// Contacts with all below a plane, into `patch`.
  void half_space(const Vector3& normal, const Vector3& origin) {
    Placement plane;
    plane.rotation.col(2) = normal;
    plane.translation = origin;
    half_space_against(plane, b, place, margin, hint, patch);
    patch.drop_spare();
  }

  /// Whether the point on the plane of a triangle is in the triangle; or past the bottom of a valley, but about to
  /// reach it, or hidden there by the other side of it. JustPast: over the edge of a ridge by less than its depth. Seen
  /// from the ridge it has come in from the side, so it counts where nothing else holds it.
  Where over(const Triangle& t, const SurfacePair& point, const Vector3& core) const {
    const Inside inside = grid.inside(t, point.on_a);
    Where where = Over;
    // Far past an edge: only valleys that hide the point from a shape deep in the solid let it count.
    const double slack = margin + kFarPast * std::max(0.0, -point.gap);
    for (int k = 0; k < 3; ++k)
      if (inside[k] < 0.0 && grid.distance(k, inside[k]) > slack) return Outside;
    for (int k = 0; k < 3; ++k) {
      Triangle other;
      Vector3 across;
      const bool within = inside[k] >= -kOnEdge;
      if (within && round) continue;
      const bool inner = grid.neighbour(t, k, other, across);
      if (within && !inner) continue;
      const double turn = inner ? ridge(t, other, across) : 1.0;
      if (within) {
        // A sharp corner below both sides of a ridge goes back out of the one it is less below.
        const double gap = other.height(point.on_b);
        if (turn > 0.0 && b.rounding == 0.0 &&
            (gap > point.gap + 1e-12 || (gap > point.gap - 1e-12 && other.precedes(t))))
          return Outside;
      } else if (turn >= 0.0) {
        if (b.rounding > 0.0 || grid.distance(k, inside[k]) > -point.gap) return Outside;
        where = JustPast;
      } else {
        const Inside past = grid.inside(other, point.on_a);
        const double core_height = other.height(core);
        const bool near = grid.distance(k, inside[k]) <= margin && past[0] >= 0.0 && past[1] >= 0.0 && past[2] >= 0.0;
        if (!near && !(core_height < 0.0 && t.height(core) <= -core_height && depth_below_surface(core) > 0.0))
          return Outside;
      }
    }
    return where;
  }

  /// How far below the surface above it a point is; negative outside.
  double depth_below_surface(const Vector3& point) const {
    const HeightGrid& g = grid.samples;
    const double wall = std::min(g.half_x - std::abs(point[0]), g.half_y - std::abs(point[1]));
    if (wall < -touching) return wall;
    if (under && point[2] < -g.base - touching) return point[2] + g.base;
    return -grid.under(point).height(point);
  }
  /// How deep a point is below the walls, or the bottom, if b can have come through them.
  double depth_below_walls(const Vector3& point) const {
    const HeightGrid& g = grid.samples;
    return beside ? std::min(g.half_x - std::abs(point[0]), g.half_y - std::abs(point[1])) : kFar;
  }
  double depth_below_bottom(const Vector3& point) const { return under ? point[2] + grid.samples.base : kFar; }

  /// False if a core that reaches below the plane of a triangle is in the air, or nearer to another way out.
  bool nearest_exit(const Triangle& t, const Vector3& core) const {
    const double depth = -t.height(core);
    return depth <= touching || (depth_below_surface(core) >= 0.5 * depth - touching &&
                                 depth <= std::min(depth_below_walls(core), depth_below_bottom(core)) + touching);
  }

  // Edges

  void edges(const Triangle& t) {
    for (int k = 0; k < 3; ++k) {
      Triangle other;
      Vector3 across;
      const bool inner = !grid.at_border(t, k);
      if (inner && !grid.may_be_ridge(t, k)) continue;
      int row = t.row, column = t.column, to_row = t.row + 1, to_column = t.column + 1;
      if (k == 0) (t.side == 0 ? to_row : row) = t.side == 0 ? t.row : t.row + 1;
      if (k == 1) (t.side == 0 ? column : to_column) = t.side == 0 ? t.column + 1 : t.column;
      Edge edge{grid.vertex(row, column), grid.vertex(to_row, to_column), {{t.normal, t.normal}}, {}, {}, {}};
      if (out_of_reach(edge)) continue;
      grid.neighbour(t, k, other, across);
      if (inner && (ridge(t, other, across) <= 0.0 || gap_to_plane(other) > margin)) continue;
      edge.normals[1] = inner ? other.normal : across;
      const Vector3 along = edge.to - edge.from;
      const auto into = [&](const Triangle& triangle, const Vector3& toward) {
        const Vector3 direction = along.cross(triangle.normal);
        edge.inside.add(direction.dot(toward) < 0.0 ? Vector3(-direction) : direction);
      };
      touch(edge, [&] {
        into(t, -across);
        if (inner)
          into(other, across);
        else
          edge.inside.add(-Vector3::UnitZ());
        around(row, column, edge.at_from);
        around(to_row, to_column, edge.at_to);
      });
    }
  }

  void around(int row, int column, Around& out) const {
    static constexpr int kSteps[6][2] = {{0, 1}, {1, 1}, {1, 0}, {0, -1}, {-1, -1}, {-1, 0}};
    const Vector3 here = grid.vertex(row, column);
    for (const auto& [up, right] : kSteps)
      if (grid.has(row + up, column + right)) out.add(grid.vertex(row + up, column + right) - here);
    out.add(-Vector3::UnitZ());
  }

  bool out_of_reach(const Edge& edge) const {
    const Vector3 from = place.rotation.transpose() * (edge.from - centre);
    const Vector3 to = place.rotation.transpose() * (edge.to - centre);
    const Vector3 reach = b.half_extents + Vector3::Constant(margin);
    return (from.cwiseMin(to).array() > reach.array()).any() || (from.cwiseMax(to).array() < -reach.array()).any();
  }

  /// Contacts with an edge; `fill` completes it if there are any.
  template <typename Fill>
  void touch(const Edge& edge, const Fill& fill) {
    const Vector3 span = edge.to - edge.from;
    const double length = span.norm();
    const Vector3 along = span / length;
    Manifold found;
    if (b.type == ShapeType::Sphere) {
      const double share = std::clamp(along.dot(place.translation - edge.from), 0.0, length);
      const Vector3 on_edge = edge.from + share * along, offset = place.translation - on_edge;
      const double distance = offset.norm();
      if (!(distance - b.rounding <= margin && distance > 0.0)) return;
      const Vector3 normal = offset / distance;
      found.add({on_edge, place.translation - b.rounding * normal, normal, distance - b.rounding});
    } else {
      Placement middle;
      middle.translation = 0.5 * (edge.from + edge.to);
      middle.rotation.col(2) = along;
      Vector3 x, y;
      complete_frame(along, x, y);
      middle.rotation.col(0) = x, middle.rotation.col(1) = y;
      segment.size[1] = segment.half_extents[2] = segment.radius = 0.5 * length;
      if (b.type == ShapeType::Capsule) {
        capsule_capsule(segment, middle, b, place, margin, found);
      } else {
        PairMemory memory;
        memory.guess = middle.rotation.transpose() * (middle.translation - centre);
        memory.hint_b = hint;
        convex_pair.collide(segment, middle, b, place, margin, memory, found, &edge.normals);
        hint = memory.hint_b;
      }
    }
    if (found.count == 0) return;
    fill();
    // The points of a patch share a normal; whether the edge has it is decided where it is deepest.
    int deepest = 0;
    for (int k = 1; k < found.count; ++k)
      if (found.points[k].gap < found.points[deepest].gap) deepest = k;
    const double slack = round ? kRoundSlack : kConeSlack, end = 1e-9 * length;
    for (int k = 0; k < found.count; ++k) {
      const SurfacePair& decides = b.type == ShapeType::Capsule ? found.points[k] : found.points[deepest];
      const double place_along = along.dot(decides.on_a - edge.from);
      const Around& solid = place_along <= end ? edge.at_from : place_along >= length - end ? edge.at_to : edge.inside;
      if (solid.allows(decides.normal, slack)) add(found.points[k]);
    }
  }

  // Below the border

  /// The four walls, the bottom, and the edges between them.
  void walls() {
    const HeightGrid& g = grid.samples;
    const Vector3 half(g.half_x, g.half_y, 0.0);
    const Vector3 bottom(0.0, 0.0, -g.base), down = -Vector3::UnitZ();
    for (int axis = 0; axis < 2; ++axis)
      for (const double side : {1.0, -1.0}) {
        if (side * centre[axis] <= half[axis]) continue;
        const int other = 1 - axis;
        const Vector3 normal = side * Vector3::Unit(axis), origin = half[axis] * normal;
        half_space(normal, origin);
        for (int k = 0; k < patch.count; ++k) {
          const SurfacePair& point = patch.points[k];
          const Vector3& at = point.on_a;
          if (!(std::abs(at[other]) <= half[other] && at[2] >= -g.base)) continue;
          if (grid.under(at).height(at) > 0.0) continue;
          const Vector3 core = point.on_b + b.rounding * normal;
          const double depth = -point.gap - b.rounding;
          if (depth <= touching || (depth < depth_below_surface(core) && depth <= depth_below_bottom(core))) add(point);
        }
        const Vector3 corner = origin + bottom, to_corner = half[other] * Vector3::Unit(other);
        Edge edge{corner - to_corner, corner + to_corner, {{normal, down}}, {}, {}, {}};
        edge.inside.add(-normal), edge.inside.add(Vector3::UnitZ());
        edge.at_from = edge.at_to = edge.inside;
        edge.at_from.add(to_corner), edge.at_to.add(-to_corner);
        if (!out_of_reach(edge)) touch(edge, [] {});
      }
    for (const double x : {1.0, -1.0})
      for (const double y : {1.0, -1.0}) {
        Edge edge{Vector3(x * half[0], y * half[1], -g.base),
                  grid.vertex(y > 0.0 ? g.rows - 1 : 0, x > 0.0 ? g.columns - 1 : 0),
                  {{x * Vector3::UnitX(), y * Vector3::UnitY()}},
                  {},
                  {},
                  {}};
        edge.inside.add(-x * Vector3::UnitX()), edge.inside.add(-y * Vector3::UnitY());
        edge.at_from = edge.at_to = edge.inside;
        edge.at_from.add(Vector3::UnitZ()), edge.at_to.add(down);
        if (!out_of_reach(edge)) touch(edge, [] {});
      }
    if (!under) return;
    half_space(down, bottom);
    for (int k = 0; k < patch.count; ++k) {
      const SurfacePair& point = patch.points[k];
      if (!((point.on_a.cwiseAbs().head<2>().array() <= half.head<2>().array()).all())) continue;
      const Vector3 core = point.on_b + b.rounding * down;
      const double depth = -point.gap - b.rounding;
      if (depth <= touching || (depth < depth_below_surface(core) && depth < depth_below_walls(core))) add(point);
    }
  }

  /// Where b is in the solid and nothing of the above tells, as it can be deep below a rough surface.
  void rescue() {
    if (beside || under) return;
    for (const SurfacePair& point : candidates)
      if (point.gap < 0.0) return;
    const Vector3 low =
        place * b.support(place.rotation.transpose() * -Vector3::UnitZ(), hint) - b.rounding * Vector3::UnitZ();
    if (!(depth_below_surface(low) > touching)) return;
    const Triangle t = grid.under(low);
    const double gap = t.height(low);
    add({low - gap * t.normal, low, t.normal, gap});
  }

  // Choice

  void add(const SurfacePair& point) {
    for (const SurfacePair& other : candidates)
      if ((other.on_b - point.on_b).squaredNorm() < same_point * same_point &&
          other.normal.dot(point.normal) > kSameCosine)
        return;
    if (candidates.size() == kMostCandidates) choose(kKeptCandidates);
    candidates.push_back(point);
  }

  /// Moves so many points to the front: the deepest, then one after the other what is farthest from those before, in
  /// place or in direction, and not much higher.
  void choose(std::size_t most) {
    if (candidates.size() <= most) return;
    const auto deeper = [](const SurfacePair& p, const SurfacePair& q) { return p.gap < q.gap; };
    std::iter_swap(candidates.begin(), std::min_element(candidates.begin(), candidates.end(), deeper));
    const double least = candidates.front().gap;
    for (std::size_t kept = 1; kept < most; ++kept) {
      std::size_t best = kept;
      double most_value = -kFar;
      for (std::size_t k = kept; k < candidates.size(); ++k) {
        double apart = kFar;
        for (std::size_t i = 0; i < kept; ++i)
          apart = std::min(apart, (candidates[k].on_b - candidates[i].on_b).norm() +
                                      b.radius * (candidates[k].normal - candidates[i].normal).norm());
        const double value = apart - kGapWeight * (candidates[k].gap - least);
        if (value > most_value + touching) most_value = value, best = k;
      }
      std::swap(candidates[kept], candidates[best]);
    }
    candidates.resize(most);
  }
};

FieldContacts::FieldContacts() : segment_(Shape::capsule(0.0, 1.0), nullptr) { candidates_.reserve(kMostCandidates); }

void FieldContacts::collide(const HeightGrid& grid, const Placement& place_field, const Solid& b,
                            const Placement& place_b, double margin, ConvexPair& convex_pair, int& hint,
                            Manifold& out) {
  out.count = 0;
  Query query(*this, grid, b, place_field.inverse() * place_b, margin, convex_pair, hint);
  if (!query.run()) return;
  query.rescue();
  query.choose(Manifold::kOnField);
  for (const SurfacePair& point : candidates_)
    out.add({place_field * point.on_a, place_field * point.on_b, place_field.rotation * point.normal, point.gap});
}

}  // namespace signorini
