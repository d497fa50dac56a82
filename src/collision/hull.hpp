#pragma once

#include <vector>

#include "signorini/model/shape.hpp"

namespace signorini {

/// A convex mesh with its triangles merged into flat faces, and what walks along it. Lists of lists are stored as one
/// list and where each part begins.
struct Hull {
  std::vector<Vector3> vertices;
  std::vector<int> neighbour_begin, neighbours;  ///< along the edges of triangles
  std::vector<Vector3> face_normals;             ///< outward, unit
  std::vector<int> face_begin, face_vertices;    ///< counter-clockwise seen from outside
  /// The faces at a vertex, and where in `face_vertices` each of them has it.
  std::vector<int> corner_begin, corner_faces, corner_places;

  /// Raises InvalidInput naming `field` unless the triangles close up and bound a convex body.
  Hull(const ConvexMesh& mesh, const char* field);

  /// The vertex farthest along `direction`, found by walking uphill from `hint`, which receives it.
  int support(const Vector3& direction, int& hint) const;

  /// The face at a vertex whose normal is nearest to `direction`.
  int face_along(int vertex, const Vector3& direction) const;
  /// Whether a point in the plane of a face is inside its loop, or within `tolerance` [m] of it.
  bool holds(int face, const Vector3& point, double tolerance) const;
  /// From the vertex of a corner to the next one on the corner's face: each edge at a vertex once, over its corners.
  Vector3 edge(int corner) const {
    const int place = corner_places[corner];
    return vertices[after(corner_faces[corner], place)] - vertices[face_vertices[place]];
  }

  int corner_count(int vertex) const { return corner_begin[vertex + 1] - corner_begin[vertex]; }
  int face_size(int face) const { return face_begin[face + 1] - face_begin[face]; }
  /// The vertices before and after place `place` of the loop of `face`.
  int before(int face, int place) const {
    return face_vertices[place == face_begin[face] ? face_begin[face + 1] - 1 : place - 1];
  }
  int after(int face, int place) const {
    return face_vertices[place + 1 == face_begin[face + 1] ? face_begin[face] : place + 1];
  }

 private:
  void merge_faces(const ConvexMesh& mesh, const std::string& field);
};

}  // namespace signorini
