#include "world_collision.hpp"

#include <algorithm>
#include <cmath>

#include "model/world_impl.hpp"

namespace signorini {
namespace {

/// [m] What rests has gaps of more or less than 0 by rounding: without a margin it would lose its points in turn.
constexpr double kLeastMargin = 1e-7;

}  // namespace

std::vector<CollisionGeometry> collision_geometries(const World& world) {
  std::vector<CollisionGeometry> list;
  for (const Geometry& geometry : world.geometries()) {
    const Body& body = world.bodies()[static_cast<std::size_t>(geometry.body)];
    list.push_back(
        {geometry.shape, body.frame, body.in_frame * geometry.placement, std::isfinite(geometry.material.stiffness)});
  }
  for (const ContactPair& pair : world.impl().contact_pairs)
    if (std::isfinite(pair.material.stiffness))
      for (const int g : {pair.geometry_a, pair.geometry_b}) list[static_cast<std::size_t>(g)].gives_way = true;
  return list;
}

CollisionFilter collision_filter(const World& world) {
  const World::Impl& w = world.impl();
  CollisionFilter filter;
  std::vector<std::vector<int>> of_body(w.bodies.size()), of_frame(w.moving_parent.size());
  for (std::size_t g = 0; g < w.geometries.size(); ++g) {
    const Geometry& geometry = w.geometries[g];
    filter.group.push_back(geometry.group);
    filter.mask.push_back(geometry.mask);
    of_body[static_cast<std::size_t>(geometry.body)].push_back(static_cast<int>(g));
    of_frame[static_cast<std::size_t>(w.bodies[static_cast<std::size_t>(geometry.body)].frame)].push_back(
        static_cast<int>(g));
  }
  filter.excluded = w.excluded;
  for (const ContactPair& pair : w.contact_pairs) filter.included.emplace_back(pair.geometry_a, pair.geometry_b);
  const auto exclude = [&filter](const std::vector<int>& a, const std::vector<int>& b) {
    for (const int i : a)
      for (const int j : b)
        if (i != j) filter.excluded.emplace_back(std::min(i, j), std::max(i, j));
  };
  for (const std::uint64_t key : w.excluded_bodies) exclude(of_body[key >> 32], of_body[key & 0xffffffffu]);
  std::vector<int> bases;  // of robots, fixed to the world: parents, which the world itself is not
  for (const int g : of_frame[0])
    if (w.geometries[static_cast<std::size_t>(g)].body != 0) bases.push_back(g);
  for (std::size_t f = 1; f < w.moving_parent.size(); ++f) {
    if (w.moving_parent[f] != 0)
      filter.excluded_frames.emplace_back(w.moving_parent[f], static_cast<int>(f));
    else if (static_cast<int>(f) < w.num_articulated_frames)
      exclude(bases, of_frame[f]);
  }
  std::sort(filter.excluded.begin(), filter.excluded.end());
  return filter;
}

DetectorSettings detector_settings(const SimulatorSettings& settings) {
  DetectorSettings detector;
  const double usual = 2e-3 + 3.0 * settings.time_step;
  detector.margin = settings.contact_margin < 0.0 ? usual : std::max(kLeastMargin, settings.contact_margin);
  detector.sweep_from = std::max(usual, detector.margin);
  return detector;
}

CorrectionSettings correction_settings(const SimulatorSettings& settings) {
  return {settings.time_step, settings.baumgarte, settings.max_correction_speed, settings.restitution_threshold};
}

}  // namespace signorini
