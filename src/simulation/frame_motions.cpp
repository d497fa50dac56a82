#include "frame_motions.hpp"

#include <algorithm>
#include <cmath>

#include "integration.hpp"
#include "model/world_impl.hpp"

namespace signorini {
namespace {

// Of the square of a fast speed: (x + y)^2 <= 2 (x^2 + y^2), and some more, since the angular velocity of a body
// changes as it turns.
constexpr double kFree = 0.3;
constexpr double kStaysSlow = 0.9;  // of a fast speed: what is slower, and turns little, is slow after the step too

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
  own_ = reach_;
  for (std::size_t f = static_cast<std::size_t>(w.num_articulated_frames); f < reach_.size(); ++f)
    free_square_.push_back(reach_[f] * reach_[f]);
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
  double most = 0.0;
  const double* x = v.data() + w.nv_articulated;  // free bodies come last, six velocities each
  for (const double square : free_square_) {
    const double bound = x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + square * (x[3] * x[3] + x[4] * x[4] + x[5] * x[5]);
    most = bound > most ? bound : most;
    x += 6;
  }
  return most > kFree * fast_ * fast_;
}

/// Whether two geometries may come nearer to each other by `slow` in a step; twists_: as they are. A robot that falls
/// moves fast against the world, not against itself: its links count by their speed against the first.
bool FrameMotions::is_fast(const Dynamics& dynamics) {
  slow_now_ = false;
  if (dynamics.num_free_bodies() > 0) return true;  // looked at already, or few enough
  const Vector3 first = twists_.size() > 1 ? twists_[1].at(dynamics.frames()[1].translation) : Vector3::Zero();
  double fastest = 0.0, most = 0.0, second = 0.0, turns = 0.0;
  for (std::size_t f = 1; f < twists_.size(); ++f) {
    const Twist& twist = twists_[f];
    const Vector3 velocity = twist.at(dynamics.frames()[f].translation);
    const double turn = twist.angular.norm(), way = turn * own_[f];
    fastest = std::max(fastest, velocity.norm() + way);
    const double own = (velocity - first).norm() + way;
    second = std::max(second, std::min(most, own));
    most = std::max(most, own);
    turns = std::max(turns, turn);
  }
  const double pair = std::max(fastest, most + second);
  slow_now_ = pair <= kStaysSlow * 2.0 * fast_ && turns * time_step_ <= 0.5 * (1.0 - kStaysSlow);
  return !(pair <= 2.0 * fast_);
}

void FrameMotions::keep(const ConstVectorRef& v) {
  if (slow_now_)
    slow_ = v;
  else
    slow_.resize(0);
}

bool FrameMotions::find(const Dynamics& dynamics, const ConstVectorRef& v, bool again) {
  if (!again) list_v_.resize(0);
  if (slow_.size() == v.size() && std::equal(v.data(), v.data() + v.size(), slow_.data())) return false;
  slow_now_ = !may_be_fast(v);
  if (slow_now_) return false;
  const World::Impl& w = world_.impl();
  dynamics.twists(v, twists_);
  if (!is_fast(dynamics)) return false;
  list_.resize(twists_.size());
  for (std::size_t f = 1; f < list_.size(); ++f) {
    const Placement& place = dynamics.frames()[f];
    FrameMotion& motion = list_[f];
    const int free = dynamics.free_body(static_cast<int>(f));
    if (free >= 0 && list_v_.size() > 0) {
      const Index at = w.free_bodies[static_cast<std::size_t>(free)].v;
      if (std::equal(v.data() + at, v.data() + at + 6, list_v_.data() + at)) continue;
    }
    motion.centre = place.translation;  // a link turns about its joint,
    motion.angular = motion.start = twists_[f].angular;
    if (free >= 0) {  // a free body about its centre of mass
      const FreeBody& body = w.free_bodies[static_cast<std::size_t>(free)];
      motion.centre = place * body.center;
      motion.angular = place.rotation * mean_angular_velocity(body, time_step_, v.segment<3>(body.v + 3));
    }
    motion.velocity = twists_[f].at(motion.centre);
  }
  list_v_ = v;
  return true;
}

}  // namespace signorini
