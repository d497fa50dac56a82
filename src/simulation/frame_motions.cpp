#include "frame_motions.hpp"

#include <algorithm>
#include <cmath>

#include "integration.hpp"
#include "model/world_impl.hpp"

namespace signorini {
namespace {

/// Radius of a ball about the origin of the geometry's frame that holds it.
double reach(const World::Impl& w, const Geometry& geometry) {
  const Body& body = w.bodies[static_cast<std::size_t>(geometry.body)];
  return (body.in_frame * geometry.placement).translation.norm() + geometry.shape.bounding_radius();
}

}  // namespace

FrameMotions::FrameMotions(const World& world, double time_step, double slow)
    : world_(world), time_step_(time_step), fast_(0.5 * slow / time_step) {
  const World::Impl& w = world.impl();
  reach_.assign(static_cast<std::size_t>(world.num_frames()), 0.0);
  for (const Geometry& geometry : w.geometries) {
    const int frame = w.bodies[static_cast<std::size_t>(geometry.body)].frame;
    if (frame == 0) continue;
    double& own = reach_[static_cast<std::size_t>(frame)];
    own = std::max(own, reach(w, geometry));
  }
  std::vector<double> slides(static_cast<std::size_t>(w.num_articulated_frames), 0.0);
  for (const Joint& joint : w.joints) {
    if (joint.v_index >= w.nv_articulated) break;
    if (joint.type == JointType::Revolute || joint.type == JointType::Ball) continue;
    const double most =
        joint.type == JointType::Free ? kInfinity : std::max(std::abs(joint.lower), std::abs(joint.upper));
    for (int f = 1; f < w.num_articulated_frames; ++f)
      if (w.articulated[static_cast<std::size_t>(f)].v == joint.v_index) slides[static_cast<std::size_t>(f)] = most;
  }
  for (int f = w.num_articulated_frames - 1; f > 0; --f) {
    const auto frame = static_cast<std::size_t>(f);
    const ArticulatedJoint& joint = w.articulated[frame];
    if (joint.parent == 0) continue;
    double& parent = reach_[static_cast<std::size_t>(joint.parent)];
    parent = std::max(parent, joint.placement.translation.norm() + slides[frame] + reach_[frame]);
  }
  speed_.assign(static_cast<std::size_t>(w.num_articulated_frames), 0.0);
}

bool FrameMotions::may_be_fast(const ConstVectorRef& v) {
  const World::Impl& w = world_.impl();
  for (std::size_t f = 1; f < speed_.size(); ++f) {
    const ArticulatedJoint& joint = w.articulated[f];
    double turns = 0.0, slides = 0.0;
    switch (joint.type) {
      case JointType::Revolute:
        turns = std::abs(v[joint.v]);
        break;
      case JointType::Prismatic:
        slides = std::abs(v[joint.v]);
        break;
      case JointType::Ball:
        turns = v.segment<3>(joint.v).norm();
        break;
      case JointType::Free:
        slides = v.segment<3>(joint.v).norm(), turns = v.segment<3>(joint.v + 3).norm();
        break;
    }
    speed_[f] = speed_[static_cast<std::size_t>(joint.parent)] + slides + (turns > 0.0 ? turns * reach_[f] : 0.0);
    if (!(speed_[f] <= fast_)) return true;
  }
  const double limit = 0.5 * fast_ * fast_;  // (x + y)^2 <= 2 (x^2 + y^2)
  std::size_t frame = speed_.size();
  for (const FreeBody& body : w.free_bodies) {
    const double reach = reach_[frame++];
    const double square = v.segment<3>(body.v).squaredNorm() + reach * reach * v.segment<3>(body.v + 3).squaredNorm();
    if (!(square <= limit)) return true;
  }
  return false;
}

bool FrameMotions::find(const Dynamics& dynamics, const ConstVectorRef& v) {
  if (!may_be_fast(v)) return false;
  const World::Impl& w = world_.impl();
  dynamics.twists(v, twists_);
  list_.resize(twists_.size());
  for (std::size_t f = 1; f < list_.size(); ++f) {
    const Placement& place = dynamics.frames()[f];
    FrameMotion& motion = list_[f];
    motion.centre = place.translation;  // a link turns about its joint,
    motion.angular = motion.start = twists_[f].angular;
    const int free = dynamics.free_body(static_cast<int>(f));
    if (free >= 0) {  // a free body about its centre of mass
      const FreeBody& body = w.free_bodies[static_cast<std::size_t>(free)];
      motion.centre = place * body.center;
      motion.angular = place.rotation * mean_angular_velocity(body, time_step_, v.segment<3>(body.v + 3));
    }
    motion.velocity = twists_[f].at(motion.centre);
  }
  return true;
}

}  // namespace signorini
