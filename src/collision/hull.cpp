#include "hull.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <map>
#include <string>

#include "signorini/errors.hpp"

namespace signorini {
namespace {

// Below so many vertices looking at each is faster than walking.
constexpr int kScanBelow = 24;
// Triangles within this of the plane of a face belong to it, relative to the size of the mesh.
constexpr double kPlaneTolerance = 1e-7;
constexpr double kNormalTolerance = 1e-6;  // [rad]
// What a mesh may bulge inwards, relative to its size: meshes come in single precision.
constexpr double kConvexTolerance = 1e-5;

}  // namespace

Hull::Hull(const ConvexMesh& mesh, const char* name) : vertices(mesh.vertices) {
  const std::string field = std::string(name) + ".mesh";
  const int count = static_cast<int>(vertices.size());
  std::vector<std::vector<int>> around(count);
  for (const auto& triangle : mesh.triangles)
    for (int k = 0; k < 3; ++k) around[triangle[k]].push_back(triangle[(k + 1) % 3]);
  neighbour_begin.push_back(0);
  for (auto& list : around) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
    neighbours.insert(neighbours.end(), list.begin(), list.end());
    neighbour_begin.push_back(static_cast<int>(neighbours.size()));
  }
  merge_faces(mesh, field);
  std::vector<std::vector<std::pair<int, int>>> corners(count);
  for (int face = 0; face + 1 < static_cast<int>(face_begin.size()); ++face)
    for (int place = face_begin[face]; place < face_begin[face + 1]; ++place)
      corners[face_vertices[place]].emplace_back(face, place);
  corner_begin.push_back(0);
  for (const auto& list : corners) {
    for (const auto& [face, place] : list) corner_faces.push_back(face), corner_places.push_back(place);
    corner_begin.push_back(static_cast<int>(corner_faces.size()));
  }
}

void Hull::merge_faces(const ConvexMesh& mesh, const std::string& field) {
  const int count = static_cast<int>(mesh.triangles.size());
  // Each edge of a closed surface belongs to two triangles that run along it in opposite directions.
  std::map<std::pair<int, int>, int> owner;
  for (int t = 0; t < count; ++t)
    for (int k = 0; k < 3; ++k)
      if (!owner.emplace(std::make_pair(mesh.triangles[t][k], mesh.triangles[t][(k + 1) % 3]), t).second)
        throw InvalidInput(field + ".triangles", "do not wind the same way all over, or overlap: must close up");
  for (const auto& [edge, t] : owner)
    if (owner.count({edge.second, edge.first}) == 0)
      throw InvalidInput(field + ".triangles[" + std::to_string(t) + "]", "has no neighbour on a side: must close up");
  if (count < 4) throw InvalidInput(field + ".triangles", "must be at least 4 that close up");

  Vector3 lower = vertices[0], upper = vertices[0];
  for (const Vector3& v : vertices) lower = lower.cwiseMin(v), upper = upper.cwiseMax(v);
  const double size = (upper - lower).norm();
  std::vector<Vector3> area(count);
  double volume = 0.0;
  for (int t = 0; t < count; ++t) {
    const auto& [i, j, k] = mesh.triangles[t];
    area[t] = 0.5 * (vertices[j] - vertices[i]).cross(vertices[k] - vertices[i]);
    volume += (vertices[i] - lower).dot(area[t]);
  }
  if (!(volume > 0.0)) throw InvalidInput(field + ".triangles", "wind inwards, must wind outwards");

  // Slivers have no normal to speak of: they go where a neighbour goes, so faces grow from large triangles.
  std::vector<int> order(count), face_of(count, -1);
  for (int t = 0; t < count; ++t) order[t] = t;
  std::stable_sort(order.begin(), order.end(), [&](int s, int t) { return area[s].norm() > area[t].norm(); });
  std::vector<int> member;
  face_begin.push_back(0);
  for (const int seed : order) {
    if (face_of[seed] >= 0) continue;
    const int face = static_cast<int>(face_normals.size());
    if (area[seed].norm() < 1e-14 * size * size) continue;
    const Vector3 seed_normal = area[seed].normalized();
    Vector3 sum = Vector3::Zero();
    member.assign(1, seed);
    face_of[seed] = face;
    for (std::size_t next = 0; next < member.size(); ++next) {
      const auto& triangle = mesh.triangles[member[next]];
      sum += area[member[next]];
      for (int k = 0; k < 3; ++k) {
        const int other = owner.at({triangle[(k + 1) % 3], triangle[k]});
        if (face_of[other] >= 0) continue;
        const double other_area = area[other].norm();
        const bool sliver = other_area < 1e-10 * size * size;
        double off_plane = 0.0;
        for (const int v : mesh.triangles[other])
          off_plane = std::max(off_plane, std::abs(seed_normal.dot(vertices[v] - vertices[mesh.triangles[seed][0]])));
        const bool aligned = sliver || area[other].cross(seed_normal).norm() <= kNormalTolerance * other_area;
        if (off_plane > kPlaneTolerance * size || !aligned || (!sliver && area[other].dot(seed_normal) < 0.0)) continue;
        face_of[other] = face;
        member.push_back(other);
      }
    }
    // The rim: edges whose other side belongs to another face.
    std::map<int, int> rim;
    for (const int t : member)
      for (int k = 0; k < 3; ++k) {
        const int from = mesh.triangles[t][k], to = mesh.triangles[t][(k + 1) % 3];
        if (face_of[owner.at({to, from})] != face) rim[from] = to;
      }
    const int start = mesh.triangles[seed][0];
    int at = rim.count(start) != 0 ? start : rim.begin()->first;
    const int first = at;
    for (std::size_t guard = 0; guard <= rim.size(); ++guard) {
      face_vertices.push_back(at);
      const auto next = rim.find(at);
      if (next == rim.end()) break;
      at = next->second;
      if (at == first) break;
    }
    face_begin.push_back(static_cast<int>(face_vertices.size()));
    face_normals.push_back(sum.normalized());
  }
  // Convex at each edge, and closed: convex.
  for (const auto& [edge, t] : owner) {
    const int across = owner.at({edge.second, edge.first});
    if (face_of[t] < 0) continue;
    for (const int v : mesh.triangles[across])
      if (face_normals[face_of[t]].dot(vertices[v] - vertices[edge.first]) > kConvexTolerance * size)
        throw InvalidInput(field, "is not convex at triangle " + std::to_string(t) + ", must be a convex hull");
  }
}

int Hull::face_along(int vertex, const Vector3& direction) const {
  int best = corner_faces[corner_begin[vertex]];
  double cosine = face_normals[best].dot(direction);
  for (int corner = corner_begin[vertex] + 1; corner < corner_begin[vertex + 1]; ++corner) {
    const double own = face_normals[corner_faces[corner]].dot(direction);
    if (own > cosine) best = corner_faces[corner], cosine = own;
  }
  return best;
}

bool Hull::holds(int face, const Vector3& point, double tolerance) const {
  Vector3 from = vertices[face_vertices[face_begin[face + 1] - 1]];
  for (int place = face_begin[face]; place < face_begin[face + 1]; ++place) {
    const Vector3& to = vertices[face_vertices[place]];
    const Vector3 inwards = face_normals[face].cross(to - from);
    const double height = inwards.dot(point - from);
    if (height < 0.0 && height * height > tolerance * tolerance * inwards.squaredNorm()) return false;
    from = to;
  }
  return true;
}

int Hull::support(const Vector3& direction, int& hint) const {
  const int count = static_cast<int>(vertices.size());
  if (count < kScanBelow) {
    int best = 0;
    double height = direction.dot(vertices[0]);
    for (int v = 1; v < count; ++v) {
      const double h = direction.dot(vertices[v]);
      if (h > height) best = v, height = h;
    }
    return hint = best;
  }
  int best = hint >= 0 && hint < count ? hint : 0;
  double height = direction.dot(vertices[best]);
  for (bool climbing = true; climbing;) {
    climbing = false;
    const int from = best;
    for (int k = neighbour_begin[from]; k < neighbour_begin[from + 1]; ++k) {
      const double h = direction.dot(vertices[neighbours[k]]);
      if (h > height) best = neighbours[k], height = h, climbing = true;
    }
  }
  return hint = best;
}

}  // namespace signorini
