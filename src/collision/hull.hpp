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
