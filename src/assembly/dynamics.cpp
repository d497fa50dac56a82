// Equations of motion of trees of bodies, all quantities in world axes at the world's origin: Newton-Euler for the
// bias, composite inertias for M, and Featherstone's sparse factorisation M^ = L^T D L (Rigid Body Dynamics Algorithms,
// 2008, sections 5.3, 6.2, 6.3).
#include "signorini/assembly/dynamics.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "model/world_impl.hpp"
#include "signorini/errors.hpp"

namespace signorini {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;

/// A twist (velocity of the point at the world's origin, angular velocity) or a wrench (force, moment about the
/// origin).
struct Spatial {
  Vector3 linear = Vector3::Zero(), angular = Vector3::Zero();
};

double power(const double* motion, const Spatial& wrench) {
  return motion[0] * wrench.linear[0] + motion[1] * wrench.linear[1] + motion[2] * wrench.linear[2] +
         motion[3] * wrench.angular[0] + motion[4] * wrench.angular[1] + motion[5] * wrench.angular[2];
}

/// Inertia about the world's origin.
struct Inertia {
  double mass = 0.0;
  Vector3 first = Vector3::Zero();   // mass times centre
  Matrix3 second = Matrix3::Zero();  // rotational, about the origin

  Spatial operator*(const Spatial& twist) const {
    return {mass * twist.linear + twist.angular.cross(first), first.cross(twist.linear) + second * twist.angular};
  }
  void operator+=(const Inertia& other) { mass += other.mass, first += other.first, second += other.second; }
};

Inertia in_world(const Placement& frame, double mass, const Vector3& center, const Matrix3& inertia) {
  const Vector3 c = frame * center;
  Inertia result;
  result.mass = mass;
  result.first = mass * c;
  result.second.noalias() = frame.rotation * inertia * frame.rotation.transpose();
  result.second += mass * (c.squaredNorm() * Matrix3::Identity() - c * c.transpose());
  return result;
}

/// y -= factor x. Between the ancestors of a velocity lie zeros: going over them is faster than around them.
inline void subtract(Index count, double factor, const double* __restrict x, double* __restrict y) {
  for (Index k = 0; k < count; ++k) y[k] -= factor * x[k];
}

Eigen::Quaterniond quaternion(const ConstVectorRef& q, Index at) { return {q[at + 3], q[at], q[at + 1], q[at + 2]}; }

}  // namespace

double tendon_length(const World& world, const Tendon& tendon, const ConstVectorRef& q) {
  double length = 0.0;
  for (const Tendon::Term& term : tendon.terms)
    length += term.coefficient * q[world.joints()[static_cast<std::size_t>(term.joint)].q_index];
  return length;
}

struct Dynamics::Impl {
  // By articulated frame, 0 being the world.
  std::vector<Inertia> inertia, composite;
  std::vector<Spatial> twist, drift, wrench, rate, sum;
  // By velocity: 6 numbers each; row k of M and of L holds the entries of k's ancestors and its own.
  std::vector<double> motion;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> mass, lower;
  Vector sqrt_d, inverse_sqrt_d;
  std::vector<Index> root;  // first velocity on the way to the root in the factor

  Vector implicit;  // what factor() was last given for the free bodies
  struct Whitener {
    Matrix6 w;  // lower Cholesky factor of M^
    Matrix6 w_inverse_t;
  };
  std::vector<Whitener> free;
};

Dynamics::Dynamics(std::shared_ptr<const World> world) : world_(std::move(world)), impl_(std::make_unique<Impl>()) {
  const World::Impl& w = world_->impl();
  const auto num_frames = static_cast<std::size_t>(w.num_articulated_frames);
  frames_.resize(static_cast<std::size_t>(world_->num_frames()));
  first_free_frame_ = w.num_articulated_frames;
  bias_ = Vector::Zero(w.num_v);
  support_.resize(num_frames);
  for (std::size_t frame = 1; frame < num_frames; ++frame) {
    const ArticulatedJoint& joint = w.articulated[frame];
    support_[frame] = support_[static_cast<std::size_t>(joint.parent)];
    for (Index k = 0; k < joint.num_v(); ++k) support_[frame].push_back(static_cast<int>(joint.v + k));
  }
  Impl& s = *impl_;
  s.inertia.resize(num_frames), s.composite.resize(num_frames);
  for (std::vector<Spatial>* x : {&s.twist, &s.drift, &s.wrench, &s.rate, &s.sum}) x->resize(num_frames);
  s.motion.assign(6 * static_cast<std::size_t>(w.nv_articulated), 0.0);
  s.mass.setZero(w.nv_articulated, w.nv_articulated);
  s.lower.setZero(w.nv_articulated, w.nv_articulated);
  s.sqrt_d.setZero(w.nv_articulated), s.inverse_sqrt_d.setZero(w.nv_articulated);
  for (Index k = 0; k < w.nv_articulated; ++k) {
    const int parent = w.factor_parent[static_cast<std::size_t>(k)];
    s.root.push_back(parent < 0 ? k : s.root[static_cast<std::size_t>(parent)]);
  }
  s.free.resize(w.free_bodies.size());
  s.implicit = Vector::Constant(w.num_v, -1.0);

  // A joint that moves nothing, like a hinge through a point mass: better said now than at the first step.
  const Vector zero = Vector::Zero(w.num_v);
  update(world_->initial_q(), zero);
  factor(Vector::Zero(num_implicit()));
  for (const Joint& joint : w.joints) {
    if (joint.v_index >= w.nv_articulated) break;
    const double inertia = s.sqrt_d.segment(joint.v_index, joint.num_v()).minCoeff();
    if (inertia > 1e-7) continue;
    throw InvalidInput("joint '" + joint.name + "': inertia that it moves",
                       "is 0 to rounding, must be > 0 (masses and inertias of the bodies on it)");
  }
}

Dynamics::~Dynamics() = default;
Dynamics::Dynamics(Dynamics&&) noexcept = default;

Index Dynamics::num_implicit() const { return world_->num_v() + static_cast<Index>(world_->tendons().size()); }
Index Dynamics::num_articulated() const { return world_->impl().nv_articulated; }
const std::vector<int>& Dynamics::factor_parent() const { return world_->impl().factor_parent; }
int Dynamics::num_free_bodies() const { return static_cast<int>(world_->impl().free_bodies.size()); }
void Dynamics::twists(const ConstVectorRef& v, std::vector<Twist>& out) const {
  const World::Impl& w = world_->impl();
  out.resize(frames_.size());
  out[0] = Twist();
  for (std::size_t frame = 1; frame < static_cast<std::size_t>(first_free_frame_); ++frame) {
    const ArticulatedJoint& joint = w.articulated[frame];
    Twist& twist = out[frame];
    twist = out[static_cast<std::size_t>(joint.parent)];
    const double* m = motion(joint.v);
    for (Index k = joint.v; k < joint.v + joint.num_v(); ++k, m += 6) {
      twist.linear += v[k] * Vector3(m[0], m[1], m[2]);
      twist.angular += v[k] * Vector3(m[3], m[4], m[5]);
    }
  }
  for (std::size_t i = 0; i < w.free_bodies.size(); ++i) {
    const std::size_t frame = static_cast<std::size_t>(first_free_frame_) + i;
    const Placement& placement = frames_[frame];
    const Index at = w.free_bodies[i].v;
    Twist& twist = out[frame];
    twist.angular = placement.rotation * v.segment<3>(at + 3);
    twist.linear = placement.rotation * v.segment<3>(at) - twist.angular.cross(placement.translation);
  }
}

Index Dynamics::free_v(int body) const { return world_->impl().free_bodies[static_cast<std::size_t>(body)].v; }
const Matrix6& Dynamics::free_whitener(int body) const {
  return impl_->free[static_cast<std::size_t>(body)].w_inverse_t;
}
const double* Dynamics::motion(Index k) const { return impl_->motion.data() + 6 * k; }

void Dynamics::update_placements(const ConstVectorRef& q) {
  const World::Impl& w = world_->impl();
  for (std::size_t i = 1; i < static_cast<std::size_t>(w.num_articulated_frames); ++i) {
    const ArticulatedJoint& joint = w.articulated[i];
    Placement& frame = frames_[i];
    frame = frames_[static_cast<std::size_t>(joint.parent)] * joint.placement;
    switch (joint.type) {
      case JointType::Revolute:
        frame.rotation *= Eigen::AngleAxisd(q[joint.q], joint.axis).toRotationMatrix();
        break;
      case JointType::Prismatic:
        frame.translation += frame.rotation * (q[joint.q] * joint.axis);
        break;
      case JointType::Ball:
        frame.rotation *= quaternion(q, joint.q).toRotationMatrix();
        break;
      case JointType::Free:
        frame.translation += frame.rotation * q.segment<3>(joint.q);
        frame.rotation *= quaternion(q, joint.q + 3).toRotationMatrix();
        break;
    }
  }
  for (std::size_t i = 0; i < w.free_bodies.size(); ++i) {
    const FreeBody& free = w.free_bodies[i];
    Placement& frame = frames_[static_cast<std::size_t>(first_free_frame_) + i];
    frame.translation = q.segment<3>(free.q);
    frame.rotation = quaternion(q, free.q + 3).toRotationMatrix();
  }
}

void Dynamics::update_velocities(const ConstVectorRef& v) {
  const World::Impl& w = world_->impl();
  Impl& s = *impl_;
  const auto num_frames = static_cast<std::size_t>(w.num_articulated_frames);
  // Outwards: motions, twists, and their rates of change while the joint velocities stay as they are.
  for (std::size_t i = 1; i < num_frames; ++i) {
    const ArticulatedJoint& joint = w.articulated[i];
    const Placement& frame = frames_[i];
    const auto parent = static_cast<std::size_t>(joint.parent);
    double* motion = s.motion.data() + 6 * joint.v;
    const auto column = [&](const Vector3& linear, const Vector3& angular) {
      for (int k = 0; k < 3; ++k) motion[k] = linear[k], motion[3 + k] = angular[k];
      motion += 6;
    };
    if (joint.type == JointType::Revolute) {
      const Vector3 axis = frame.rotation * joint.axis;
      column(frame.translation.cross(axis), axis);
    } else if (joint.type == JointType::Prismatic) {
      column(frame.rotation * joint.axis, Vector3::Zero());
    } else {
      if (joint.type == JointType::Free)
        for (int k = 0; k < 3; ++k) column(frame.rotation.col(k), Vector3::Zero());
      for (int k = 0; k < 3; ++k) column(frame.translation.cross(frame.rotation.col(k)), frame.rotation.col(k));
    }
    Spatial own;
    for (Index k = 0; k < joint.num_v(); ++k) {
      const double* m = s.motion.data() + 6 * (joint.v + k);
      own.linear += v[joint.v + k] * Vector3(m[0], m[1], m[2]);
      own.angular += v[joint.v + k] * Vector3(m[3], m[4], m[5]);
    }
    const Spatial& base = s.twist[parent];
    s.twist[i].linear = base.linear + own.linear;
    s.twist[i].angular = base.angular + own.angular;
    s.drift[i] = s.drift[parent];
    if (joint.type == JointType::Free) {
      // Its linear velocity counts in a frame held still: the origin moves straight.
      const Vector3 velocity = own.linear + own.angular.cross(frame.translation);
      s.drift[i].linear += velocity.cross(own.angular);
    } else {
      s.drift[i].linear += base.angular.cross(own.linear) + base.linear.cross(own.angular);
      s.drift[i].angular += base.angular.cross(own.angular);
    }
    s.inertia[i] = in_world(frame, joint.mass, joint.center, joint.inertia);
    const Spatial momentum = s.inertia[i] * s.twist[i];
    Spatial& wrench = s.wrench[i];
    wrench = s.inertia[i] * Spatial{s.drift[i].linear - w.gravity, s.drift[i].angular};
    wrench.linear += s.twist[i].angular.cross(momentum.linear);
    wrench.angular += s.twist[i].angular.cross(momentum.angular) + s.twist[i].linear.cross(momentum.linear);
  }
}

void Dynamics::update(const ConstVectorRef& q, const ConstVectorRef& v) {
  const World::Impl& w = world_->impl();
  Impl& s = *impl_;
  update_placements(q);
  update_velocities(v);
  s.composite = s.inertia;
  s.sum = s.wrench;
  // Inwards: bias and M.
  for (auto i = static_cast<std::size_t>(w.num_articulated_frames); i-- > 1;) {
    const ArticulatedJoint& joint = w.articulated[i];
    const auto parent = static_cast<std::size_t>(joint.parent);
    for (Index k = joint.v; k < joint.v + joint.num_v(); ++k) {
      const double* m = s.motion.data() + 6 * k;
      bias_[k] = power(m, s.sum[i]);
      const Spatial force = s.composite[i] * Spatial{{m[0], m[1], m[2]}, {m[3], m[4], m[5]}};
      double* row = s.mass.data() + k * w.nv_articulated;
      for (int j = static_cast<int>(k); j >= 0; j = w.parent_dof[static_cast<std::size_t>(j)])
        row[j] = power(s.motion.data() + 6 * j, force);
      row[k] += joint.armature;
    }
    if (parent == 0) continue;
    s.composite[parent] += s.composite[i];
    s.sum[parent].linear += s.sum[i].linear;
    s.sum[parent].angular += s.sum[i].angular;
  }
  for (std::size_t i = 0; i < w.free_bodies.size(); ++i) {
    const FreeBody& free = w.free_bodies[i];
    const Placement& frame = frames_[static_cast<std::size_t>(first_free_frame_) + i];
    const Vector3 weight = frame.rotation.transpose() * (free.mass * w.gravity);
    bias_.segment<3>(free.v) = -weight;
    bias_.segment<3>(free.v + 3) = -free.center.cross(weight);
  }
}

void Dynamics::inverse(const ConstVectorRef& acceleration, const std::vector<Wrench>& wrenches, VectorRef force) {
  const World::Impl& w = world_->impl();
  Impl& s = *impl_;
  const auto num_frames = static_cast<std::size_t>(w.num_articulated_frames);
  for (std::size_t i = 1; i < num_frames; ++i) {
    const ArticulatedJoint& joint = w.articulated[i];
    Spatial& rate = s.rate[i];
    rate = s.rate[static_cast<std::size_t>(joint.parent)];
    for (Index k = joint.v; k < joint.v + joint.num_v(); ++k) {
      const double* m = s.motion.data() + 6 * k;
      rate.linear += acceleration[k] * Vector3(m[0], m[1], m[2]);
      rate.angular += acceleration[k] * Vector3(m[3], m[4], m[5]);
    }
    const Spatial own = s.inertia[i] * rate;
    s.sum[i].linear = s.wrench[i].linear + own.linear - wrenches[i].force;
    s.sum[i].angular = s.wrench[i].angular + own.angular - wrenches[i].moment;
  }
  for (std::size_t i = num_frames; i-- > 1;) {
    const ArticulatedJoint& joint = w.articulated[i];
    for (Index k = joint.v; k < joint.v + joint.num_v(); ++k)
      force[k] = power(s.motion.data() + 6 * k, s.sum[i]) + joint.armature * acceleration[k];
    Spatial& parent = s.sum[static_cast<std::size_t>(joint.parent)];
    parent.linear += s.sum[i].linear;
    parent.angular += s.sum[i].angular;
  }
  for (std::size_t i = 0; i < w.free_bodies.size(); ++i) {
    const FreeBody& free = w.free_bodies[i];
    const std::size_t at = static_cast<std::size_t>(first_free_frame_) + i;
    const Placement& frame = frames_[at];
    const Vector3 weight = free.mass * w.gravity;  // in the world
    const Vector3 moment = wrenches[at].moment - frame.translation.cross(wrenches[at].force);
    auto own = force.segment<6>(free.v);
    own.noalias() = free.mass_matrix * acceleration.segment<6>(free.v);
    own.head<3>() -= frame.rotation.transpose() * (weight + wrenches[at].force);
    own.tail<3>() -= frame.rotation.transpose() * moment + free.center.cross(frame.rotation.transpose() * weight);
  }
}

Vector3 Dynamics::drift(int frame, const Vector3& point, const ConstVectorRef& v) const {
  if (frame == 0) return Vector3::Zero();
  if (const int free = free_body(frame); free >= 0) {
    // The centre of mass moves straight.
    const FreeBody& body = world_->impl().free_bodies[static_cast<std::size_t>(free)];
    const Placement& place = frames_[static_cast<std::size_t>(frame)];
    const Vector3 turn = place.rotation * v.segment<3>(body.v + 3);
    return turn.cross(turn.cross(point - place * body.center));
  }
  const Spatial &twist = impl_->twist[static_cast<std::size_t>(frame)],
                &drift = impl_->drift[static_cast<std::size_t>(frame)];
  return drift.linear + drift.angular.cross(point) + twist.angular.cross(twist.linear + twist.angular.cross(point));
}

void Dynamics::add_implicit(const ConstVectorRef& implicit, const ConstVectorRef& x, VectorRef product) const {
  const World::Impl& w = world_->impl();
  product += implicit.head(w.num_v).cwiseProduct(x);
  for (std::size_t t = 0; t < w.tendon_pulls.size(); ++t) {
    double rate = 0.0;
    for (const auto& pull : w.tendon_pulls[t]) rate += pull.coefficient * x[pull.v];
    const double force = implicit[w.num_v + static_cast<Index>(t)] * rate;
    for (const auto& pull : w.tendon_pulls[t]) product[pull.v] += force * pull.coefficient;
  }
}

bool Dynamics::factor(const ConstVectorRef& implicit) {
  const World::Impl& w = world_->impl();
  Impl& s = *impl_;
  bool good = true;
  const Index n = w.nv_articulated;
  for (Index k = 0; k < n; ++k) {
    const Index root = s.root[static_cast<std::size_t>(k)];
    std::copy_n(s.mass.data() + k * n + root, k + 1 - root, s.lower.data() + k * n + root);
  }
  s.lower.diagonal() += implicit.head(n);
  for (std::size_t t = 0; t < w.tendon_pulls.size(); ++t) {
    const double resistance = implicit[w.num_v + static_cast<Index>(t)];
    if (resistance == 0.0) continue;
    for (const auto& a : w.tendon_pulls[t])
      for (const auto& b : w.tendon_pulls[t])
        if (b.v <= a.v) s.lower(a.v, b.v) += resistance * a.coefficient * b.coefficient;
  }
  for (Index k = n - 1; k >= 0; --k) {
    double* row = s.lower.data() + k * n;
    const double inverse = 1.0 / row[k];
    const Index root = s.root[static_cast<std::size_t>(k)];
    good = good && row[k] > 0.0;
    s.sqrt_d[k] = std::sqrt(row[k]);
    s.inverse_sqrt_d[k] = 1.0 / s.sqrt_d[k];
    for (int i = w.factor_parent[static_cast<std::size_t>(k)]; i >= 0;
         i = w.factor_parent[static_cast<std::size_t>(i)]) {
      const double factor = row[i] * inverse;
      subtract(i + 1 - root, factor, row + root, s.lower.data() + i * n + root);
      row[i] = factor;
    }
  }
  for (std::size_t i = 0; i < w.free_bodies.size(); ++i) {
    const FreeBody& free = w.free_bodies[i];
    const auto wanted = implicit.segment<6>(free.v);
    if (s.implicit.segment<6>(free.v) == wanted) continue;
    s.implicit.segment<6>(free.v) = wanted;
    Matrix6 m = free.mass_matrix;
    m.diagonal() += wanted;
    const Eigen::LLT<Matrix6> llt(m);
    good = good && llt.info() == Eigen::Success;
    s.free[i].w = llt.matrixL();
    s.free[i].w_inverse_t = s.free[i].w.triangularView<Eigen::Lower>().solve(Matrix6::Identity()).transpose();
  }
  return good;
}

// Articulated: M^ = L^T D L, so W = L^T D^1/2; a velocity's ancestors come before it.

void Dynamics::solve_half(VectorRef x) const {
  const World::Impl& w = world_->impl();
  const Index n = w.nv_articulated;
  for (Index k = n - 1; k >= 0; --k) {
    const double* row = impl_->lower.data() + k * n;
    const Index root = impl_->root[static_cast<std::size_t>(k)];
    subtract(k - root, x[k], row + root, x.data() + root);
    x[k] *= impl_->inverse_sqrt_d[k];
  }
  for (std::size_t i = 0; i < w.free_bodies.size(); ++i) {
    const Vector6 part = x.segment<6>(w.free_bodies[i].v);
    x.segment<6>(w.free_bodies[i].v).noalias() = impl_->free[i].w_inverse_t.transpose() * part;
  }
}

void Dynamics::solve_half_transposed(VectorRef x) const {
  const World::Impl& w = world_->impl();
  const Index n = w.nv_articulated;
  for (Index k = 0; k < n; ++k) {
    const double* row = impl_->lower.data() + k * n;
    double value = x[k] * impl_->inverse_sqrt_d[k];
    for (int i = w.factor_parent[static_cast<std::size_t>(k)]; i >= 0; i = w.factor_parent[static_cast<std::size_t>(i)])
      value -= row[i] * x[i];
    x[k] = value;
  }
  for (std::size_t i = 0; i < w.free_bodies.size(); ++i) {
    const Vector6 part = x.segment<6>(w.free_bodies[i].v);
    x.segment<6>(w.free_bodies[i].v).noalias() = impl_->free[i].w_inverse_t * part;
  }
}

void Dynamics::multiply_half_transposed(VectorRef x) const {
  const World::Impl& w = world_->impl();
  const Index n = w.nv_articulated;
  for (Index k = n - 1; k >= 0; --k) {
    const double* row = impl_->lower.data() + k * n;
    double value = x[k];
    for (int i = w.factor_parent[static_cast<std::size_t>(k)]; i >= 0; i = w.factor_parent[static_cast<std::size_t>(i)])
      value += row[i] * x[i];
    x[k] = value * impl_->sqrt_d[k];
  }
  for (std::size_t i = 0; i < w.free_bodies.size(); ++i) {
    const Vector6 part = x.segment<6>(w.free_bodies[i].v);
    x.segment<6>(w.free_bodies[i].v).noalias() = impl_->free[i].w.transpose() * part;
  }
}

void Dynamics::solve(VectorRef x) const {
  solve_half(x);
  solve_half_transposed(x);
}

namespace {

template <int Rows>
void whiten_rows(const double* lower, const double* inverse_sqrt_d, Index stride, double* y, const int* dofs,
                 int count) {
  for (int at = 0; at < count; ++at) {
    const int k = dofs[at];
    const double* row = lower + k * stride;
    double* yk = y + static_cast<std::ptrdiff_t>(k) * Rows;
    double own[Rows];
    for (int r = 0; r < Rows; ++r) own[r] = yk[r];
    for (int next = at + 1; next < count; ++next) {  // those that do not lead to the root have 0 in L
      const int i = dofs[next];
      double* yi = y + static_cast<std::ptrdiff_t>(i) * Rows;
      for (int r = 0; r < Rows; ++r) yi[r] -= row[i] * own[r];
    }
    for (int r = 0; r < Rows; ++r) yk[r] = own[r] * inverse_sqrt_d[k];
  }
}

}  // namespace

void Dynamics::whiten(double* y, int rows, const int* dofs, int count) const {
  const auto whiten = rows == 3 ? &whiten_rows<3> : &whiten_rows<1>;
  whiten(impl_->lower.data(), impl_->inverse_sqrt_d.data(), num_articulated(), y, dofs, count);
}

Matrix Dynamics::jacobian(const ConstVectorRef& q, int body, const Vector3& point) {
  Matrix j(6, world_->num_v());
  update_placements(q);
  update_velocities(Vector::Zero(world_->num_v()));
  const Body& b = world_->bodies()[static_cast<std::size_t>(body)];
  const Vector3 place = frames_[static_cast<std::size_t>(b.frame)] * (b.in_frame * point);
  std::vector<Twist> moved;
  for (Index k = 0; k < j.cols(); ++k) {
    twists(Vector::Unit(j.cols(), k), moved);
    const Twist& twist = moved[static_cast<std::size_t>(b.frame)];
    j.col(k) << twist.at(place), twist.angular;
  }
  return j;
}

Matrix Dynamics::mass_matrix() const {
  const World::Impl& w = world_->impl();
  Matrix m = Matrix::Zero(w.num_v, w.num_v);
  for (Index k = 0; k < w.nv_articulated; ++k)
    for (int i = static_cast<int>(k); i >= 0; i = w.parent_dof[static_cast<std::size_t>(i)])
      m(k, i) = m(i, k) = impl_->mass(k, i);
  for (const FreeBody& free : w.free_bodies) m.block<6, 6>(free.v, free.v) = free.mass_matrix;
  return m;
}

double Dynamics::kinetic_energy(const ConstVectorRef& v) const {
  const World::Impl& w = world_->impl();
  double energy = 0.0;
  for (Index k = 0; k < w.nv_articulated; ++k) {
    energy += 0.5 * impl_->mass(k, k) * v[k] * v[k];
    for (int i = w.parent_dof[static_cast<std::size_t>(k)]; i >= 0; i = w.parent_dof[static_cast<std::size_t>(i)])
      energy += impl_->mass(k, i) * v[k] * v[i];
  }
  for (const FreeBody& free : w.free_bodies) {
    const Vector6 part = v.segment<6>(free.v);
    energy += 0.5 * part.dot(free.mass_matrix * part);
  }
  return energy;
}

double Dynamics::potential_energy(const ConstVectorRef& q) const {
  const World::Impl& w = world_->impl();
  double energy = 0.0;
  for (std::size_t k = 1; k < static_cast<std::size_t>(w.num_articulated_frames); ++k)
    energy -= w.articulated[k].mass * w.gravity.dot(frames_[k] * w.articulated[k].center);
  for (std::size_t i = 0; i < w.free_bodies.size(); ++i)
    energy -= w.free_bodies[i].mass *
              w.gravity.dot(frames_[static_cast<std::size_t>(first_free_frame_) + i] * w.free_bodies[i].center);
  for (const Joint& joint : w.joints) {
    if (!(joint.stiffness > 0.0)) continue;
    const double stretch = q[joint.q_index] - joint.spring_reference;
    energy += 0.5 * joint.stiffness * stretch * stretch;
  }
  for (const Tendon& tendon : w.tendons) {
    const double length = tendon_length(*world_, tendon, q);
    const double stretch = length - std::clamp(length, tendon.spring_lower, tendon.spring_upper);
    energy += 0.5 * tendon.stiffness * stretch * stretch;
  }
  for (const Body& body : w.bodies)
    if (body.gravity_compensation != 0.0)
      energy += body.gravity_compensation * body.mass *
                w.gravity.dot(frames_[static_cast<std::size_t>(body.frame)] * (body.in_frame * body.center));
  return energy;
}

Vector6 Dynamics::momentum(const ConstVectorRef& v) const {
  const World::Impl& w = world_->impl();
  Vector6 total = Vector6::Zero();
  const auto add = [&total](const Inertia& inertia, const Spatial& twist) {
    const Spatial momentum = inertia * twist;
    total.head<3>() += momentum.linear;
    total.tail<3>() += momentum.angular;
  };
  for (int k = 1; k < w.num_articulated_frames; ++k) {
    Spatial twist;
    for (const int d : support(k)) {
      const double* m = motion(d);
      twist.linear += v[d] * Vector3(m[0], m[1], m[2]);
      twist.angular += v[d] * Vector3(m[3], m[4], m[5]);
    }
    add(impl_->inertia[static_cast<std::size_t>(k)], twist);
  }
  for (std::size_t i = 0; i < w.free_bodies.size(); ++i) {
    const FreeBody& free = w.free_bodies[i];
    const Placement& frame = frames_[static_cast<std::size_t>(first_free_frame_) + i];
    const Vector3 linear = frame.rotation * v.segment<3>(free.v), angular = frame.rotation * v.segment<3>(free.v + 3);
    add(in_world(frame, free.mass, free.center, free.inertia), {linear + frame.translation.cross(angular), angular});
  }
  return total;
}

}  // namespace signorini
