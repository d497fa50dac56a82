#include "narrow_phase.hpp"

#include <cmath>

#include "box_box.hpp"
#include "closed_forms.hpp"

namespace signorini {
namespace {

bool sphere_has_a_formula(ShapeType other) {
  return other == ShapeType::Sphere || other == ShapeType::Capsule || other == ShapeType::Box ||
         other == ShapeType::Cylinder;
}

void keep_finite(Manifold& manifold) {
  int kept = 0;
  for (int k = 0; k < manifold.count; ++k) {
    const SurfacePair& point = manifold.points[k];
    const double sum = point.on_a.sum() + point.on_b.sum() + point.normal.sum() + point.gap;
    if (std::isfinite(sum)) manifold.points[kept++] = point;
  }
  manifold.count = kept;
}

}  // namespace

void NarrowPhase::collide(const Solid& a, const Placement& place_a, const Solid& b, const Placement& place_b,
                          double margin, PairMemory& memory, Manifold& out) {
  out.count = 0;
  if (a.type == ShapeType::HalfSpace) {
    half_space_against(place_a, b, place_b, margin, memory.hint_b, out);
  } else if (b.type == ShapeType::HalfSpace) {
    half_space_against(place_b, a, place_a, margin, memory.hint_a, out);
    out.swap_sides();
  } else if (a.type == ShapeType::HeightField) {
    field_contacts_.collide(*a.height_grid, place_a, b, place_b, margin, convex_pair_, memory.hint_b, out);
  } else if (b.type == ShapeType::HeightField) {
    field_contacts_.collide(*b.height_grid, place_b, a, place_a, margin, convex_pair_, memory.hint_a, out);
    out.swap_sides();
  } else if (a.type == ShapeType::Sphere && sphere_has_a_formula(b.type)) {
    sphere_against(a.size[0], place_a.translation, b, place_b, margin, out);
  } else if (b.type == ShapeType::Sphere && sphere_has_a_formula(a.type)) {
    sphere_against(b.size[0], place_b.translation, a, place_a, margin, out);
    out.swap_sides();
  } else if (a.type == ShapeType::Capsule && b.type == ShapeType::Capsule) {
    capsule_capsule(a, place_a, b, place_b, margin, out);
  } else if (!(a.type == ShapeType::Box && b.type == ShapeType::Box && box_box(a, place_a, b, place_b, margin, out))) {
    convex_pair_.collide(a, place_a, b, place_b, margin, memory, out);
  }
  keep_finite(out);
}

}  // namespace signorini
