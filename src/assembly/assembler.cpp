#include "signorini/assembly/assembler.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "delassus/dense_kernels.hpp"
#include "tie_load.hpp"

namespace signorini {
namespace {

// [m, rad] A gap below counts as touching, with the same slope as an overlap: with two slopes meeting at 0, rounding
// would make the points of a resting face contradict each other.
constexpr double kTouching = 1e-7;
// [m/s] A spare contact joins when it would sink in faster: what rounding and the tolerance leave between the corners
// of one face is less, and rows beyond four gain nothing there.
constexpr double kSpareSlack = 1e-5;
constexpr double kSamePoint = 1e-5;       // [m] contact points nearer than this are the same, whoever found them
constexpr double kCorrectionTime = 1e-3;  // [s] shorter steps take back less of an overlap: no faster
constexpr double kRounding = 1e-12;  // of an impulse: where loads are all 0, their speeds still change by this share
constexpr double kFirstLoadStep = 1.5, kLongestLoadStep = 64.0;
constexpr double kRedundant = 1e-4;  // (S19)
constexpr int kCoupledRows = 200;    // up to this many a dense G is as fast as any

/// Rotation vector of R, |angle| <= pi.
Vector3 rotation_vector(const Matrix3& rotation) {
  const Eigen::AngleAxisd turn(rotation);
  return turn.angle() * turn.axis();
}

/// y (Rows x 6, column-major) <- y times an upper triangular matrix; the last column first, since it needs all others.
template <int Rows>
void multiply_upper(double* y, const Eigen::Matrix<double, 6, 6>& upper) {
#pragma GCC unroll 6
  for (int c = 5; c >= 0; --c) {
    double sums[Rows] = {};
#pragma GCC unroll 6
    for (int k = 0; k <= c; ++k)
      for (int r = 0; r < Rows; ++r) sums[r] += y[Rows * k + r] * upper(k, c);
    std::copy_n(sums, Rows, y + Rows * c);
  }
}

/// to (rows x columns) += from, of columns `stride` apart.
inline void add_block(int rows, int columns, const double* from, int stride, double* to) {
  for (int c = 0; c < columns; ++c, from += stride, to += rows) {
    if (rows == 3)
      to[0] += from[0], to[1] += from[1], to[2] += from[2];
    else
      to[0] += from[0];
  }
}

}  // namespace

bool is_moment(const Assembler::Set& set) {
  return set.source == SetSource::Torsion || set.source == SetSource::Rolling;
}

Vector3 moment_of(const Assembler::Set& set, const double* impulse) {
  if (set.source == SetSource::Torsion) return *impulse * set.frame.col(2);
  return impulse[0] * set.frame.col(0) + impulse[1] * set.frame.col(1);
}

void set_moment(const Assembler::Set& set, const Vector3& moment, double* rows) {
  const bool rolling = set.source == SetSource::Rolling;
  rows[0] = set.frame.col(rolling ? 0 : 2).dot(moment);
  rows[1] = rolling ? set.frame.col(1).dot(moment) : 0.0;
  rows[2] = 0.0;
}

Matrix3 contact_frame(const Vector3& n) {
  int least = 0;
  for (int k = 1; k < 3; ++k)
    if (std::abs(n[k]) < std::abs(n[least])) least = k;
  Matrix3 frame;
  frame.col(0) = n.cross(Vector3::Unit(least)).normalized();
  frame.col(1) = n.cross(frame.col(0));
  frame.col(2) = n;
  return frame;
}

Assembler::Assembler(std::shared_ptr<const World> world, const CorrectionSettings& settings)
    : world_(std::move(world)),
      settings_(settings),
      delassus_(std::make_shared<BlockDelassus>()),
      coupled_(std::make_shared<CoupledDelassus>()) {
  for (const Geometry& geometry : world_->geometries())
    geometry_frame_.push_back(world_->bodies()[static_cast<std::size_t>(geometry.body)].frame);
  for (std::size_t j = 0; j < world_->joints().size(); ++j) {
    const Joint& joint = world_->joints()[j];
    if (joint.lower > -kInfinity || joint.upper < kInfinity) limited_joints_.push_back(static_cast<int>(j));
    if (joint.friction > 0.0)
      for (Index k = 0; k < joint.num_v(); ++k)
        friction_velocities_.emplace_back(static_cast<int>(joint.v_index + k), joint.friction);
  }
  for (std::size_t t = 0; t < world_->tendons().size(); ++t) {
    const Tendon& tendon = world_->tendons()[t];
    if (tendon.lower > -kInfinity || tendon.upper < kInfinity) limited_tendons_.push_back(static_cast<int>(t));
    if (tendon.friction > 0.0)
      friction_velocities_.emplace_back(static_cast<int>(world_->num_v()) + static_cast<int>(t), tendon.friction);
  }
}

Assembler::Set& Assembler::new_set(SetSource source, int index, int row, int rows) {
  sets_.emplace_back();
  Set& set = sets_.back();
  set.source = source;
  set.index = index;
  set.row = row;
  set.start = rows_;
  set.rows = rows;
  rows_ += rows;
  return set;
}

double* Assembler::articulated_columns(Set& set) {
  if (set.articulated < 0) {
    set.articulated = num_slots_++;
    const auto slots = static_cast<std::size_t>(num_slots_);
    columns_.resize(std::max(columns_.size(), slots * 3 * static_cast<std::size_t>(nv_articulated_)));
    masks_.resize(std::max(masks_.size(), slots * static_cast<std::size_t>(words_)));
    std::fill_n(masks_.begin() + static_cast<std::ptrdiff_t>(set.articulated) * words_, words_, 0u);
    std::fill_n(columns_.begin() + static_cast<std::ptrdiff_t>(set.articulated) * 3 * nv_articulated_,
                set.rows * nv_articulated_, 0.0);
  }
  return columns_.data() + static_cast<std::ptrdiff_t>(set.articulated) * 3 * nv_articulated_;
}

/// J += sign (velocity of a point that moves with `frame`, along set.frame's columns), a set of three rows. The first
/// `shared` velocities that move the frame are left out.
void Assembler::add_point(const Dynamics& dynamics, Set& set, int frame, const Vector3& point, double sign,
                          std::size_t shared) {
  if (frame == 0) return;
  const int free = dynamics.free_body(frame);
  if (free >= 0) {
    const Placement& placement = dynamics.frames()[static_cast<std::size_t>(frame)];
    const Vector3 arm = placement.rotation.transpose() * (point - placement.translation);
    double* y = set.y[set.num_free];
    set.free[set.num_free++] = free;
    for (int r = 0; r < 3; ++r) {
      const Vector3 linear = placement.rotation.transpose() * (sign * set.frame.col(r));
      const Vector3 angular = arm.cross(linear);
      for (int k = 0; k < 3; ++k) y[3 * k + r] = linear[k], y[3 * (3 + k) + r] = angular[k];
    }
    return;
  }
  double* y = articulated_columns(set);
  std::uint64_t* mask = masks_.data() + static_cast<std::ptrdiff_t>(set.articulated) * words_;
  for (int w = 0; w < words_; ++w) mask[w] |= support_masks_[static_cast<std::size_t>(frame * words_ + w)];
  double wrench[6][3];  // unit forces along the axes at the point, about the world's origin
  for (int r = 0; r < 3; ++r) {
    const Vector3 force = sign * set.frame.col(r), moment = point.cross(force);
    for (int k = 0; k < 3; ++k) wrench[k][r] = force[k], wrench[3 + k][r] = moment[k];
  }
  const std::vector<int>& support = dynamics.support(frame);
  const double* motions = dynamics.motion(0);
  for (std::size_t i = shared; i < support.size(); ++i) {
    const double* m = motions + 6 * static_cast<std::ptrdiff_t>(support[i]);
    double* yk = y + 3 * static_cast<std::ptrdiff_t>(support[i]);
    for (int r = 0; r < 3; ++r)
      yk[r] += m[0] * wrench[0][r] + m[1] * wrench[1][r] + m[2] * wrench[2][r] + m[3] * wrench[3][r] +
               m[4] * wrench[4][r] + m[5] * wrench[5][r];
  }
}

/// J += sign (angular velocity of `frame` along the set's axis; of moments: along theirs, and rows of zeros).
void Assembler::add_rotation(const Dynamics& dynamics, Set& set, int frame, double sign) {
  if (frame == 0) return;
  Matrix3 axes = sign * set.frame;
  if (set.source != SetSource::Rolling)
    axes.col(0) = Vector3(axes.col(set.source == SetSource::Torsion ? 2 : set.row % 3));
  if (set.source == SetSource::Torsion) axes.col(1).setZero();
  if (set.rows == 3) axes.col(2).setZero();
  const int free = dynamics.free_body(frame);
  if (free >= 0) {
    double* y = set.y[set.num_free];
    set.free[set.num_free++] = free;
    const Matrix3 angular = dynamics.frames()[static_cast<std::size_t>(frame)].rotation.transpose() * axes;
    for (int r = 0; r < set.rows; ++r)
      for (int k = 0; k < 3; ++k) y[k * set.rows + r] = 0.0, y[(3 + k) * set.rows + r] = angular(k, r);
    return;
  }
  double* y = articulated_columns(set);
  std::uint64_t* mask = masks_.data() + static_cast<std::ptrdiff_t>(set.articulated) * words_;
  for (int w = 0; w < words_; ++w) mask[w] |= support_masks_[static_cast<std::size_t>(frame * words_ + w)];
  for (const int k : dynamics.support(frame)) {
    const double* m = dynamics.motion(k);
    for (int r = 0; r < set.rows; ++r) y[k * set.rows + r] += axes(0, r) * m[3] + axes(1, r) * m[4] + axes(2, r) * m[5];
  }
}

/// J(v) += factor, an articulated velocity, a set of one row.
void Assembler::add_velocity(Set& set, Index v, double factor) {
  double* y = articulated_columns(set);
  y[v] += factor;
  std::uint64_t* mask = masks_.data() + static_cast<std::ptrdiff_t>(set.articulated) * words_;
  for (int w = 0; w < words_; ++w) mask[w] |= chain_masks_[static_cast<std::size_t>(v * words_ + w)];
}

void Assembler::whiten(Set& set) {
  if (set.articulated >= 0) {
    const std::uint64_t* mask = masks_.data() + static_cast<std::ptrdiff_t>(set.articulated) * words_;
    dofs_.resize(static_cast<std::size_t>(nv_articulated_));
    int count = 0;
    for (int w = words_ - 1; w >= 0; --w)
      for (std::uint64_t bits = mask[w]; bits;) {
        const int top = 63 - __builtin_clzll(bits);
        dofs_[static_cast<std::size_t>(count++)] = 64 * w + top;
        bits ^= std::uint64_t{1} << top;
      }
    dynamics_->whiten(columns_.data() + static_cast<std::ptrdiff_t>(set.articulated) * 3 * nv_articulated_, set.rows,
                      dofs_.data(), count);
  }
  for (int side = 0; side < set.num_free; ++side) {
    const auto& whitener = dynamics_->free_whitener(set.free[side]);
    if (set.rows == 3)
      multiply_upper<3>(set.y[side], whitener);
    else
      multiply_upper<1>(set.y[side], whitener);
  }
}

/// The velocity of a set += factor u[v].
void Assembler::add_term(Set& set, Index v, double factor) {
  if (set.num_terms == 0) set.first_term = static_cast<int>(terms_.size());
  terms_.push_back({static_cast<int>(v), factor});
  ++set.num_terms;
}

void Assembler::add_tendon_terms(Set& set, int tendon, double factor) {
  for (const Tendon::Term& term : world_->tendons()[static_cast<std::size_t>(tendon)].terms)
    add_term(set, world_->joints()[static_cast<std::size_t>(term.joint)].v_index, factor * term.coefficient);
}

/// Rows of a set that has none yet.
void Assembler::build_rows(Set& set) {
  if (set.built) return;
  set.built = true;
  if (set.num_terms > 0) {
    for (int k = 0; k < set.num_terms; ++k) {
      const Term& term = terms_[static_cast<std::size_t>(set.first_term + k)];
      add_velocity(set, term.v, term.factor);
    }
  } else if (set.row < 3) {
    return set.rows == 3 ? build_point_rows(set) : build_loop_rows(*(&set - set.row));
  } else {
    add_rotation(*dynamics_, set, set.frame_a, -1.0);
    add_rotation(*dynamics_, set, set.frame_b, 1.0);
  }
  whiten(set);
  if (is_moment(set)) {  // one scale for the set (T12)
    const double trace = squares(set);
    if (trace > 0.0) set.load_weight = set.source == SetSource::Rolling ? 0.5 * trace : trace;
  }
}

/// Trace of the set's block of G.
double Assembler::squares(const Set& set) const {
  double sum = 0.0;
  if (set.articulated >= 0) {
    const double* y = columns_.data() + static_cast<std::ptrdiff_t>(set.articulated) * 3 * nv_articulated_;
    for (Index k = 0; k < set.rows * nv_articulated_; ++k) sum += y[k] * y[k];
  }
  for (int side = 0; side < set.num_free; ++side)
    for (int k = 0; k < 6 * set.rows; ++k) sum += set.y[side][k] * set.y[side][k];
  return sum;
}

/// Rows of the relative velocity of two points.
void Assembler::build_point_rows(Set& set) {
  std::size_t shared = 0;  // velocities that move both points alike
  const auto moves = [this](int frame) { return frame > 0 && dynamics_->free_body(frame) < 0; };
  if (moves(set.frame_a) && moves(set.frame_b) && set.point_a == set.point_b) {
    const std::vector<int>&a = dynamics_->support(set.frame_a), &b = dynamics_->support(set.frame_b);
    while (shared < a.size() && shared < b.size() && a[shared] == b[shared]) ++shared;
  }
  add_point(*dynamics_, set, set.frame_a, set.point_a, -1.0, shared);
  add_point(*dynamics_, set, set.frame_b, set.point_b, 1.0, shared);
  whiten(set);
}

/// The same for an equality of points, whose three rows are three sets, `first` and the next two.
void Assembler::build_loop_rows(Set& first) {
  Set all;
  all.rows = 3;
  all.frame = first.frame;
  all.frame_a = first.frame_a, all.frame_b = first.frame_b;
  all.point_a = first.point_a, all.point_b = first.point_b;
  build_point_rows(all);
  for (int r = 0; r < 3; ++r) {
    Set& set = *(&first + r);
    set.built = true;
    if (all.articulated >= 0) {
      double* to = articulated_columns(set);
      const double* from = columns_.data() + static_cast<std::ptrdiff_t>(all.articulated) * 3 * nv_articulated_;
      const std::uint64_t* mask = masks_.data() + static_cast<std::ptrdiff_t>(all.articulated) * words_;
      std::copy_n(mask, words_, masks_.data() + static_cast<std::ptrdiff_t>(set.articulated) * words_);
      for (Index k = 0; k < nv_articulated_; ++k) to[k] = from[3 * k + r];
    }
    set.num_free = all.num_free;
    for (int side = 0; side < all.num_free; ++side) {
      set.free[side] = all.free[side];
      for (int k = 0; k < 6; ++k) set.y[side][k] = all.y[side][3 * k + r];
    }
  }
}

double Assembler::rigid_correction(double gap) const {
  const double share = settings_.baumgarte * std::min(1.0, settings_.time_step / kCorrectionTime);
  if (gap >= kTouching) return (gap - (1.0 - share) * kTouching) / settings_.time_step;
  return std::max(share * gap / settings_.time_step, -settings_.max_correction_speed);
}

void Assembler::set_spring(Set& set, double gap, double stiffness, double damping, bool one_sided) const {
  const double dt = settings_.time_step;
  if (std::isinf(stiffness)) {
    set.correction = one_sided ? rigid_correction(gap)
                               : std::clamp(gap / dt, -settings_.max_correction_speed, settings_.max_correction_speed);
    return;
  }
  const double k = dt * stiffness + damping;
  set.compliance = 1.0 / (dt * k);
  set.correction = stiffness * gap / k;
}

void Assembler::add_contacts(const std::vector<ContactPoint>& contacts) {
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const ContactPoint& contact = contacts[i];
    Set& set = new_set(SetSource::Contact, static_cast<int>(i), 0, 3);
    const bool same_pair =
        i > 0 && contacts[i - 1].geometry_a == contact.geometry_a && contacts[i - 1].geometry_b == contact.geometry_b;
    const Set* last = same_pair ? &sets_[i - 1] : nullptr;  // points of a flat patch have one normal
    set.frame = last && contacts[i - 1].normal == contact.normal ? last->frame : contact_frame(contact.normal);
    set.material = last ? last->material : world_->material(contact.geometry_a, contact.geometry_b);
    all_sets_.add_friction_cone(set.material.friction);
    set.frame_a = geometry_frame_[static_cast<std::size_t>(contact.geometry_a)];
    set.frame_b = geometry_frame_[static_cast<std::size_t>(contact.geometry_b)];
    set.point_a = set.point_b = contact.position;
    if (contact.swept) set.point_a -= contact.way_a, set.point_b -= contact.way_b;
    set.gap = contact.distance;
    set.spare = contact.spare;
    set_spring(set, contact.distance, set.material.stiffness / contact.patch_size,
               set.material.damping / contact.patch_size, true);
  }
}

/// Torsion and rolling are cones too, of friction 1, whose normal row is the load (S16).
void Assembler::add_moments() {
  has_moments_ = false;
  const std::size_t num_contacts = sets_.size();
  for (std::size_t i = 0; i < num_contacts; ++i) {
    for (const SetSource source : {SetSource::Rolling, SetSource::Torsion}) {
      const Material& material = sets_[i].material;
      const double factor = source == SetSource::Rolling ? material.rolling : material.torsion;
      if (factor == 0.0) continue;
      Set& set = new_set(source, static_cast<int>(i), 3, 3);
      Set& contact = sets_[i];  // new_set() may have moved it
      if (contact.num_moments++ == 0) contact.first_moment = static_cast<int>(sets_.size()) - 1;
      set.frame = contact.frame;
      set.frame_a = contact.frame_a, set.frame_b = contact.frame_b;
      set.load_factor = factor;
      all_sets_.add_friction_cone(1.0);
      has_moments_ = true;
    }
  }
}

void Assembler::set_loads(VectorRef impulse) const {
  if (!has_moments_) return;
  for (const Set& set : sets_)
    if (is_moment(set))
      impulse[set.start + 2] = set.load_factor * impulse[sets_[static_cast<std::size_t>(set.index)].start + 2];
}

void Assembler::set_load_speed(Set& set, double speed) {
  g_[set.start + 2] = set.correction = speed;  // their row of J is 0
  if (set.offset >= 0) problem_.set_free_velocity(set.offset + 2, speed);
}

void Assembler::set_load_speeds() {
  for (Set& set : sets_)
    if (is_moment(set)) set_load_speed(set, std::hypot(g_[set.start], g_[set.start + 1]));
}

bool Assembler::shift_loads(const ConstVectorRef& sigma, const ConstVectorRef& impulse, double tolerance, bool first) {
  if (!has_moments_) return false;
  double largest = 0.0, scale = 0.0, square = 0.0, product = 0.0;
  const bool known = !first && load_changes_.size() == static_cast<Index>(selection_.size());
  load_changes_.resize(static_cast<Index>(selection_.size()));
  for (std::size_t k = 0; k < selection_.size(); ++k) {
    const Set& set = sets_[static_cast<std::size_t>(selection_[k])];
    if (!is_moment(set)) continue;
    double& change = load_changes_[static_cast<Index>(k)];
    const double last = known ? change : 0.0;
    change = std::hypot(sigma[set.start], sigma[set.start + 1]) - set.correction;
    square += last * last, product += last * change;
    largest = std::max(largest, std::abs(change) / set.load_weight);
    const double stops = std::hypot(g_[set.start], g_[set.start + 1]) / set.load_weight;
    scale = std::max({scale, impulse[set.start + 2], kRounding / tolerance * stops});
  }
  if (!(largest > tolerance * scale)) return false;
  // A change takes half of itself back where a moment acts alone, more where many share a turn: the secant says.
  const double step = square > product ? load_step_ * square / (square - product) : 0.0;
  load_step_ = known ? std::clamp(step, 1.0, kLongestLoadStep) : kFirstLoadStep;
  for (std::size_t k = 0; k < selection_.size(); ++k) {
    Set& set = sets_[static_cast<std::size_t>(selection_[k])];
    if (is_moment(set))
      set_load_speed(set, std::max(0.0, set.correction + load_step_ * load_changes_[static_cast<Index>(k)]));
  }
  return true;
}

/// A limit within reach; its terms are the caller's.
void Assembler::add_limit(SetSource source, int index, double gap, double stiffness, double damping) {
  Set& set = new_set(source, index, 0, 1);
  set_spring(set, gap, stiffness, damping, true);
  all_sets_.add_half_line();
}

void Assembler::add_limits(const ConstVectorRef& q, const ConstVectorRef& v, const ConstVectorRef& free_v,
                           const Vector* reach) {
  // Rows only where the limit is within reach: twice the way of a step, and a little.
  const auto reached_by = [reach](Index k) { return reach ? std::abs((*reach)[k]) : 0.0; };
  const auto way = [this](double speed) { return 2.0 * settings_.time_step * speed + 2e-3; };
  for (const int j : limited_joints_) {
    const Joint& joint = world_->joints()[static_cast<std::size_t>(j)];
    const Index k = joint.v_index;
    if (joint.type == JointType::Ball) {
      const Eigen::Quaterniond turn(Eigen::Vector4d(q.segment<4>(joint.q_index)));
      const Vector3 angle = rotation_vector(turn.toRotationMatrix());
      const Vector3 reached(reached_by(k), reached_by(k + 1), reached_by(k + 2));
      const double fastest = std::max({v.segment<3>(k).norm(), free_v.segment<3>(k).norm(), reached.norm()});
      const double gap = joint.upper - angle.norm();
      if (!(gap <= way(fastest)) || angle.isZero(1e-9)) continue;
      add_limit(SetSource::UpperLimit, j, gap, joint.limit_stiffness, joint.limit_damping);
      const Vector3 axis = angle.normalized();
      for (int i = 0; i < 3; ++i) add_term(sets_.back(), k + i, -axis[i]);
      continue;
    }
    const double reached = way(std::max({std::abs(v[k]), std::abs(free_v[k]), reached_by(k)}));
    for (const bool lower : {true, false}) {
      const double gap = lower ? q[joint.q_index] - joint.lower : joint.upper - q[joint.q_index];
      if (!(gap <= reached)) continue;
      add_limit(lower ? SetSource::LowerLimit : SetSource::UpperLimit, j, gap, joint.limit_stiffness,
                joint.limit_damping);
      add_term(sets_.back(), k, lower ? 1.0 : -1.0);
    }
  }
  for (const int t : limited_tendons_) {
    const Tendon& tendon = world_->tendons()[static_cast<std::size_t>(t)];
    double most = 0.0;
    for (const Tendon::Term& term : tendon.terms)
      most += std::abs(term.coefficient) * reached_by(world_->joints()[static_cast<std::size_t>(term.joint)].v_index);
    const double reached =
        way(std::max({std::abs(tendon_rate(tendon, v)), std::abs(tendon_rate(tendon, free_v)), most}));
    const double length = tendon_length(*world_, tendon, q);
    for (const bool lower : {true, false}) {
      const double gap = lower ? length - tendon.lower : tendon.upper - length;
      if (!(gap <= reached)) continue;
      add_limit(lower ? SetSource::LowerLimit : SetSource::UpperLimit, static_cast<int>(world_->joints().size()) + t,
                gap, tendon.limit_stiffness, tendon.limit_damping);
      add_tendon_terms(sets_.back(), t, lower ? 1.0 : -1.0);
    }
  }
}

bool Assembler::passes_limit(const ConstVectorRef& q, const ConstVectorRef& u) const {
  const auto passes = [&](SetSource source, int index, double gap, double rate) {
    return gap + settings_.time_step * rate < 0.0 &&
           std::none_of(
               sets_.begin(), sets_.end(), [&](const Set& set) { return set.source == source && set.index == index; });
  };
  for (const int j : limited_joints_) {
    const Joint& joint = world_->joints()[static_cast<std::size_t>(j)];
    const Index k = joint.v_index;
    if (joint.type == JointType::Ball) {
      const Eigen::Quaterniond turn(Eigen::Vector4d(q.segment<4>(joint.q_index)));
      const Vector3 angle = rotation_vector(turn.toRotationMatrix());
      const double gap = joint.upper - angle.norm(), rate = -angle.normalized().dot(u.segment<3>(k));
      if (!angle.isZero(1e-9) && passes(SetSource::UpperLimit, j, gap, rate)) return true;
    } else if (passes(SetSource::LowerLimit, j, q[joint.q_index] - joint.lower, u[k]) ||
               passes(SetSource::UpperLimit, j, joint.upper - q[joint.q_index], -u[k])) {
      return true;
    }
  }
  for (const int t : limited_tendons_) {
    const Tendon& tendon = world_->tendons()[static_cast<std::size_t>(t)];
    const double length = tendon_length(*world_, tendon, q), rate = tendon_rate(tendon, u);
    const int index = static_cast<int>(world_->joints().size()) + t;
    if (passes(SetSource::LowerLimit, index, length - tendon.lower, rate) ||
        passes(SetSource::UpperLimit, index, tendon.upper - length, -rate))
      return true;
  }
  return false;
}

double Assembler::tendon_rate(const Tendon& tendon, const ConstVectorRef& u) const {
  double sum = 0.0;
  for (const Tendon::Term& term : tendon.terms)
    sum += term.coefficient * u[world_->joints()[static_cast<std::size_t>(term.joint)].v_index];
  return sum;
}

void Assembler::add_joint_friction() {
  const auto num_v = static_cast<int>(world_->num_v());
  for (const auto& [velocity, force] : friction_velocities_) {
    Set& set = new_set(SetSource::JointFriction, velocity, 0, 1);
    if (velocity < num_v)
      add_term(set, velocity, 1.0);
    else
      add_tendon_terms(set, velocity - num_v, 1.0);
    all_sets_.add_interval(-settings_.time_step * force, settings_.time_step * force);
  }
}

void Assembler::add_equalities(const Dynamics& dynamics, const ConstVectorRef& q, const ConstVectorRef& v) {
  for (std::size_t i = 0; i < world_->constraints().size(); ++i) {
    const EqualityConstraint& c = world_->constraints()[i];
    const int index = static_cast<int>(i);
    if (c.type == ConstraintType::Coupling) {
      const auto value = [&](int joint, int tendon) {
        return tendon >= 0 ? tendon_length(*world_, world_->tendons()[static_cast<std::size_t>(tendon)], q)
                           : q[world_->joints()[static_cast<std::size_t>(joint)].q_index];
      };
      const bool driven = c.joint_a >= 0 || c.tendon_a >= 0;
      double target = c.coefficients[0], slope = 0.0;
      if (driven) {
        const double x = value(c.joint_a, c.tendon_a) - c.reference_a;
        target = c.coefficients[4];
        for (int k = 3; k >= 0; --k) slope = slope * x + target, target = target * x + c.coefficients[k];
      }
      Set& set = new_set(SetSource::Equality, index, 0, 1);
      const auto add = [&](int joint, int tendon, double factor) {
        if (tendon >= 0)
          add_tendon_terms(set, tendon, factor);
        else
          add_term(set, world_->joints()[static_cast<std::size_t>(joint)].v_index, factor);
      };
      add(c.joint_b, c.tendon_b, 1.0);
      if (driven) add(c.joint_a, c.tendon_a, -slope);
      set_spring(set, value(c.joint_b, c.tendon_b) - c.reference_b - target, c.stiffness, c.damping, false);
      all_sets_.add_equality();
      continue;
    }
    const Body& a = world_->bodies()[static_cast<std::size_t>(c.body_a)];
    const Body& b = world_->bodies()[static_cast<std::size_t>(c.body_b)];
    if (a.frame == b.frame) continue;  // fixed to each other: nothing moves
    const Placement on_a = dynamics.frames()[static_cast<std::size_t>(a.frame)] * a.in_frame * c.placement_a;
    const Placement on_b = dynamics.frames()[static_cast<std::size_t>(b.frame)] * b.in_frame * c.placement_b;
    // Rows along the world's axes.
    // The way along curved paths counts too, or loops would gape by O(dt^2) (S7).
    const Vector3 drift = dynamics.drift(b.frame, on_b.translation, v) - dynamics.drift(a.frame, on_a.translation, v);
    const Vector3 gap = on_b.translation - on_a.translation + 0.5 * settings_.time_step * settings_.time_step * drift;
    const bool weld = c.type == ConstraintType::Weld;
    const Vector3 turn =
        weld ? Vector3(on_a.rotation * rotation_vector(on_a.rotation.transpose() * on_b.rotation)) : Vector3::Zero();
    for (int row = 0; row < (weld ? 6 : 3); ++row) {
      Set& set = new_set(SetSource::Equality, index, row, 1);
      set.frame.setIdentity();
      set.frame_a = a.frame, set.frame_b = b.frame;
      set.point_a = on_a.translation, set.point_b = on_b.translation;
      if (row < 3)
        set_spring(set, gap[row], c.stiffness, c.damping, false);
      else
        set_spring(set, turn[row - 3], c.turn_stiffness, c.turn_damping, false);
      all_sets_.add_equality();
    }
  }
}

void Assembler::set_velocity(const Set& set, const ConstVectorRef& u, const std::vector<Twist>& twists,
                             double* velocity) const {
  if (set.num_terms > 0) {
    *velocity = 0.0;
    for (int k = 0; k < set.num_terms; ++k) {
      const Term& term = terms_[static_cast<std::size_t>(set.first_term + k)];
      *velocity += term.factor * u[term.v];
    }
    return;
  }
  const Twist &a = twists[static_cast<std::size_t>(set.frame_a)], &b = twists[static_cast<std::size_t>(set.frame_b)];
  if (is_moment(set))
    set_moment(set, b.angular - a.angular, velocity);
  else if (set.rows == 3)
    Eigen::Map<Vector3>{velocity} = set.frame.transpose() * (b.at(set.point_b) - a.at(set.point_a));
  else if (set.row < 3)
    *velocity = set.frame.col(set.row).dot(b.at(set.point_b) - a.at(set.point_a));
  else
    *velocity = set.frame.col(set.row - 3).dot(b.angular - a.angular);
}

void Assembler::velocities(const ConstVectorRef& u, VectorRef out) {
  dynamics_->twists(u, twists_);
  for (const Set& set : sets_) set_velocity(set, u, twists_, out.data() + set.start);
}

bool Assembler::copy_impulses(const std::vector<Set>& sets, const ConstVectorRef& impulse, VectorRef own) const {
  if (!sets.empty() && impulse.size() != sets.back().start + sets.back().rows) return false;
  std::vector<std::uint8_t> used(sets.size(), 0);
  for (const Set& set : sets_) {
    if (is_moment(set)) continue;  // with its contact
    std::size_t found = sets.size();
    double nearest = kSamePoint;  // detectors list the points of a pair in any order
    for (std::size_t k = 0; k < sets.size(); ++k) {
      const Set& other = sets[k];
      if (used[k] || other.source != set.source || other.row != set.row) continue;
      if (set.source == SetSource::Contact) {
        const double away = (other.point_b - set.point_b).norm();
        if (other.frame_a != set.frame_a || other.frame_b != set.frame_b || !(away < nearest)) continue;
        nearest = away;
      } else if (other.index != set.index) {
        continue;
      }
      found = k;
      if (set.source != SetSource::Contact) break;
    }
    if (found == sets.size()) continue;
    used[found] = 1;
    const auto theirs = impulse.segment(sets[found].start, set.rows);
    if (set.source == SetSource::Contact)
      own.segment<3>(set.start) = set.frame.transpose() * (sets[found].frame * Vector3(theirs));
    else
      own.segment(set.start, set.rows) = theirs;
    if (set.num_moments == 0) continue;
    Vector3 moment = Vector3::Zero();
    for (int k = 0; k < sets[found].num_moments; ++k) {
      const Set& from = sets[static_cast<std::size_t>(sets[found].first_moment + k)];
      moment += moment_of(from, impulse.data() + from.start);
    }
    for (int k = 0; k < set.num_moments; ++k) {
      const Set& to = sets_[static_cast<std::size_t>(set.first_moment + k)];
      set_moment(to, moment, own.data() + to.start);
    }
  }
  set_loads(own);
  for (std::size_t k = 0; k < sets.size(); ++k)
    if (!used[k] && sets[k].source == SetSource::Contact && !impulse.segment<3>(sets[k].start).isZero(0.0))
      return false;
  return true;
}

void Assembler::add_forces(const ConstVectorRef& impulse, double factor, std::vector<Wrench>& wrenches,
                           VectorRef force) const {
  for (const Set& set : sets_) {
    const double* x = impulse.data() + set.start;
    for (int k = 0; k < set.num_terms; ++k) {
      const Term& term = terms_[static_cast<std::size_t>(set.first_term + k)];
      force[term.v] += factor * term.factor * *x;
    }
    if (set.num_terms > 0) continue;
    Wrench &a = wrenches[static_cast<std::size_t>(set.frame_a)], &b = wrenches[static_cast<std::size_t>(set.frame_b)];
    if (is_moment(set)) {
      const Vector3 moment = factor * moment_of(set, x);
      b.moment += moment;
      a.moment -= moment;
      continue;
    }
    const Vector3 f = set.rows == 3 ? Vector3(factor * (set.frame * Eigen::Map<const Vector3>(x)))
                                    : Vector3(factor * *x * set.frame.col(set.row % 3));
    if (set.row < 3) {
      b.add(f, set.point_b);
      a.add(-f, set.point_a);
    } else {
      b.moment += f;
      a.moment -= f;
    }
  }
}

/// g of all sets; a bounce replaces the gap's correction where the approach is fast and would close the gap in this
/// step (S8).
void Assembler::correct(const ConstVectorRef& v) {
  set_free_velocity(free_v_);
  const auto may_bounce = [](const Set& set) {
    return set.source == SetSource::Contact && set.material.restitution > 0.0;
  };
  if (std::none_of(sets_.begin(), sets_.end(), may_bounce)) return;
  dynamics_->twists(v, twists_now_);
  for (std::size_t i = 0; i < sets_.size(); ++i) {
    Set& set = sets_[i];
    if (!may_bounce(set)) continue;
    double now[3];
    set_velocity(set, v, twists_now_, now);
    if (!(now[2] < -settings_.restitution_threshold)) continue;
    set.bounce = set.material.restitution * now[2];
    set.gap_correction = set.correction;
    const double arrives = g_[set.start + 2] - set.correction;
    set_bounce(i, set.gap + settings_.time_step * arrives <= 0.0);
  }
}

void Assembler::set_free_velocity(const ConstVectorRef& free_v) {
  free_v_ = free_v;
  g_.resize(rows_);
  velocities(free_v_, g_);
  for (const Set& set : sets_) g_[set.start + set.rows - 1] += set.correction;
}

void Assembler::set_bounce(std::size_t index, bool bounces) {
  Set& set = sets_[index];
  const double before = set.correction;
  set.bounces = bounces;
  set.correction = set.gap_correction;
  if (bounces) set.correction = set.bounce + (std::isinf(set.material.stiffness) ? 0.0 : set.gap_correction);
  g_[set.start + 2] += set.correction - before;
}

void Assembler::multiply_blocks(const std::vector<int>& selection, const ConstraintSets& sets,
                                BlockDelassus& delassus) {
  pairs_.clear();
  blocks_of_free_.clear();
  for (const int body : touched_free_) sets_of_free_[static_cast<std::size_t>(body)].clear();
  touched_free_.clear();
  articulated_sets_.clear();
  const auto selected = [&](int i) -> const Set& {
    return sets_[static_cast<std::size_t>(selection[static_cast<std::size_t>(i)])];
  };
  for (int i = 0; i < static_cast<int>(selection.size()); ++i) {
    const Set& set = selected(i);
    partners_.clear();
    if (set.articulated >= 0) {
      const std::uint64_t* mask = masks_.data() + static_cast<std::ptrdiff_t>(set.articulated) * words_;
      for (const int j : articulated_sets_) {
        const std::uint64_t* other = masks_.data() + static_cast<std::ptrdiff_t>(selected(j).articulated) * words_;
        for (int w = 0; w < words_; ++w)
          if (mask[w] & other[w]) {
            partners_.push_back(j);
            break;
          }
      }
      articulated_sets_.push_back(i);
    }
    for (int side = 0; side < set.num_free; ++side)
      for (const Touch& other : sets_of_free_[static_cast<std::size_t>(set.free[side])]) partners_.push_back(other.set);
    std::sort(partners_.begin(), partners_.end());
    partners_.erase(std::unique(partners_.begin(), partners_.end()), partners_.end());
    for (int side = 0; side < set.num_free; ++side) {
      std::vector<Touch>& list = sets_of_free_[static_cast<std::size_t>(set.free[side])];
      if (list.empty()) touched_free_.push_back(set.free[side]);
      const std::size_t first_block = blocks_of_free_.size();
      auto partner = partners_.begin();
      for (const Touch& other : list) {
        while (*partner != other.set) ++partner;
        blocks_of_free_.push_back(static_cast<Index>(pairs_.size()) + (partner - partners_.begin()));
      }
      list.push_back({i, side, set.rows, first_block});
    }
    for (const int j : partners_) pairs_.emplace_back(i, j);
  }
  delassus.reset(sets, pairs_);

  const auto visit = [this](const Set& a, const Set& b, double* block) {  // rows of a x rows of b, column-major
    if (a.articulated >= 0 && b.articulated >= 0 && a.group == b.group) {
      const Group& group = groups_[static_cast<std::size_t>(a.group)];
      const double* from =
          products_.data() + group.product + static_cast<std::ptrdiff_t>(b.group_row) * group.rows + a.group_row;
      add_block(a.rows, b.rows, from, group.rows, block);
    }
  };
  if (!articulated_sets_.empty()) {
    for (int i = 0; i < static_cast<int>(selection.size()); ++i)
      visit(selected(i), selected(i), delassus.diagonal_block(i));
    for (std::size_t k = 0; k < pairs_.size(); ++k)
      visit(selected(pairs_[k].first), selected(pairs_[k].second), delassus.block(static_cast<Index>(k)));
  }
  for (const int body : touched_free_) add_free_products(selection, body, delassus);
  if (has_moments_) add_loads(selection, delassus);
}

/// G += Y_b Y_b^T of a free body b, over the sets that act on it.
void Assembler::add_free_products(const std::vector<int>& selection, int body, BlockDelassus& delassus) {
  const std::vector<Touch>& list = sets_of_free_[static_cast<std::size_t>(body)];
  int rows = 0;
  for (const Touch& touch : list) rows += touch.rows;
  packed_.resize(std::max(packed_.size(), 6 * static_cast<std::size_t>(rows)));
  double* to = packed_.data();
  for (const Touch& touch : list) {
    const Set& set = sets_[static_cast<std::size_t>(selection[static_cast<std::size_t>(touch.set)])];
    const double* y = set.y[touch.side];
    for (int k = 0; k < 6; ++k)
      for (int r = 0; r < touch.rows; ++r) to[k * rows + r] = *y++;
    to += touch.rows;
  }
  products_.resize(std::max(products_.size(), static_cast<std::size_t>(rows) * static_cast<std::size_t>(rows)));
  dense_kernels().symmetric_product(rows, 6, packed_.data(), products_.data());
  const double* from = products_.data();
  for (const Touch& touch : list) {
    const double* own = from;
    const Index* block = blocks_of_free_.data() + touch.first_block;
    for (const Touch* other = list.data(); other != &touch; ++other) {
      add_block(touch.rows, other->rows, own, rows, delassus.block(*block++));
      own += other->rows * rows;
    }
    add_block(touch.rows, touch.rows, own, rows, delassus.diagonal_block(touch.set));
    from += touch.rows;
  }
}

template <typename Add>
void Assembler::add_load(const Set& moment, Index normal, Index first, const Add& add) const {
  tie_load(normal, first, {false, moment.source == SetSource::Torsion}, moment.load_weight, moment.load_factor, add);
}

/// After the blocks of `selection`, whose pairs are pairs_.
void Assembler::add_loads(const std::vector<int>& selection, BlockDelassus& delassus) const {
  for (std::size_t i = 0; i < selection.size(); ++i) {
    const Set& moment = sets_[static_cast<std::size_t>(selection[i])];
    if (!is_moment(moment)) continue;
    const auto contact = std::lower_bound(selection.begin(), selection.end(), moment.index) - selection.begin();
    const BlockDelassus::Pair both(static_cast<int>(i), static_cast<int>(contact));
    const auto pair = std::lower_bound(pairs_.begin(), pairs_.end(), both);
    double* blocks[2][2] = {
        {delassus.diagonal_block(contact), nullptr},  // [row][column]: of the contact, of the moment
        {nullptr, delassus.diagonal_block(static_cast<Index>(i))}};
    if (pair != pairs_.end() && *pair == both) blocks[1][0] = delassus.block(pair - pairs_.begin());
    add_load(moment, 2, 3, [&](Index row, Index column, double value) {
      double* block = blocks[row / 3][column / 3];
      if (block) block[3 * (column % 3) + row % 3] += value;
    });
  }
}

void Assembler::add_loads(double* matrix, int rows) const {
  for (const int i : selection_) {
    const Set& moment = sets_[static_cast<std::size_t>(i)];
    if (!is_moment(moment)) continue;
    add_load(moment, sets_[static_cast<std::size_t>(moment.index)].offset + 2, moment.offset,
             [&](Index row, Index column, double value) { matrix[column * rows + row] += value; });
  }
}

/// products_ = Y Y^T of the articulated rows, lower triangles, group by group: sets that share no velocity, directly
/// or through others, are in different groups.
void Assembler::multiply_articulated(const std::vector<int>& selection) {
  groups_.clear();
  group_masks_.clear();
  for (const int i : selection) {
    Set& set = sets_[static_cast<std::size_t>(i)];
    if (set.articulated < 0) continue;
    const std::uint64_t* mask = masks_.data() + static_cast<std::ptrdiff_t>(set.articulated) * words_;
    int own = -1;
    for (int g = 0; g < static_cast<int>(groups_.size()); ++g) {
      std::uint64_t* other = group_masks_.data() + static_cast<std::ptrdiff_t>(g) * words_;
      bool meets = false;
      for (int w = 0; w < words_; ++w) meets = meets || (mask[w] & other[w]);
      if (!meets) continue;
      if (own < 0) {
        own = g;
        for (int w = 0; w < words_; ++w) other[w] |= mask[w];
      } else {  // this set joins two groups
        std::uint64_t* joined = group_masks_.data() + static_cast<std::ptrdiff_t>(own) * words_;
        for (int w = 0; w < words_; ++w) joined[w] |= other[w], other[w] = 0;
        for (const int k : selection)
          if (sets_[static_cast<std::size_t>(k)].articulated >= 0 && sets_[static_cast<std::size_t>(k)].group == g)
            sets_[static_cast<std::size_t>(k)].group = own;
      }
    }
    if (own < 0) {
      own = static_cast<int>(groups_.size());
      groups_.emplace_back();
      group_masks_.insert(group_masks_.end(), mask, mask + words_);
    }
    set.group = own;
  }
  for (const int i : selection) {
    Set& set = sets_[static_cast<std::size_t>(i)];
    if (set.articulated < 0) continue;
    Group& group = groups_[static_cast<std::size_t>(set.group)];
    set.group_row = group.rows;
    group.rows += set.rows;
  }
  std::size_t total = 0;
  for (Group& group : groups_) {
    group.product = static_cast<std::ptrdiff_t>(total);
    total += static_cast<std::size_t>(group.rows) * static_cast<std::size_t>(group.rows);
  }
  products_.resize(std::max(products_.size(), total));
  for (std::size_t g = 0; g < groups_.size(); ++g) {
    const Group& group = groups_[g];
    if (group.rows == 0) continue;
    dofs_.clear();
    const std::uint64_t* mask = group_masks_.data() + static_cast<std::ptrdiff_t>(g) * words_;
    for (int w = 0; w < words_; ++w)
      for (std::uint64_t bits = mask[w]; bits; bits &= bits - 1) dofs_.push_back(64 * w + __builtin_ctzll(bits));
    packed_.resize(std::max(packed_.size(), dofs_.size() * static_cast<std::size_t>(group.rows)));
    for (const int i : selection) {
      const Set& set = sets_[static_cast<std::size_t>(i)];
      if (set.articulated < 0 || set.group != static_cast<int>(g)) continue;
      const double* y = columns_.data() + static_cast<std::ptrdiff_t>(set.articulated) * 3 * nv_articulated_;
      double* to = packed_.data() + set.group_row;
      for (const int k : dofs_) {
        const double* yk = y + k * set.rows;
        to[0] = yk[0];
        if (set.rows == 3) to[1] = yk[1], to[2] = yk[2];
        to += group.rows;
      }
    }
    dense_kernels().symmetric_product(group.rows, static_cast<int>(dofs_.size()), packed_.data(),
                                      products_.data() + group.product);
  }
}

/// Compliance of rigid equalities that others all but determine (S19), after multiply_articulated(): a Cholesky
/// factorisation of their part of G, each constraint scaled to 1, the largest pivot first, none below kRedundant.
void Assembler::soften_redundant(const std::vector<int>& selection) {
  if (softened_) return;
  softened_ = true;
  for (std::size_t g = 0; g < groups_.size(); ++g) {
    const Group& group = groups_[g];
    loop_sets_.clear();
    for (const int i : selection) {
      Set& set = sets_[static_cast<std::size_t>(i)];
      const bool rigid = set.source == SetSource::Equality && set.compliance == 0.0;
      if (rigid && set.articulated >= 0 && set.group == static_cast<int>(g)) loop_sets_.push_back(&set);
    }
    const std::size_t n = loop_sets_.size();
    if (n < 2) continue;
    const double* product = products_.data() + group.product;
    const auto entry = [&](const Set& a, const Set& b) {  // of G
      const auto [c, r] = std::minmax(a.group_row, b.group_row);
      return product[static_cast<std::ptrdiff_t>(c) * group.rows + r];
    };
    // Rows of one constraint along different axes are one length or one angle: the axis of a plane linkage, which is
    // moved by rounding alone, must not be scaled up.
    loop_scale_.resize(n);
    for (std::size_t k = 0; k < n;) {
      const Set& first = *loop_sets_[k];
      double largest = 0.0;
      std::size_t end = k;
      for (; end < n && loop_sets_[end]->index == first.index && loop_sets_[end]->row / 3 == first.row / 3; ++end)
        largest = std::max(largest, entry(*loop_sets_[end], *loop_sets_[end]));
      for (; k < end; ++k) loop_scale_[k] = largest > 0.0 ? 1.0 / std::sqrt(largest) : 0.0;
    }
    loops_.resize(n * n);  // lower triangle, column by column
    for (std::size_t c = 0; c < n; ++c)
      for (std::size_t r = c; r < n; ++r)
        loops_[c * n + r] = entry(*loop_sets_[c], *loop_sets_[r]) * loop_scale_[c] * loop_scale_[r];
    const auto at = [&](std::size_t r, std::size_t c) -> double& {
      return loops_[std::min(r, c) * n + std::max(r, c)];
    };
    for (std::size_t k = 0; k < n; ++k) {
      std::size_t largest = k;
      for (std::size_t i = k + 1; i < n; ++i)
        if (loops_[i * n + i] > loops_[largest * n + largest]) largest = i;
      if (largest != k) {
        for (std::size_t i = k; i < n; ++i)
          if (i != k && i != largest) std::swap(at(i, k), at(i, largest));
        std::swap(at(k, k), at(largest, largest));
        std::swap(loop_sets_[k], loop_sets_[largest]);
        std::swap(loop_scale_[k], loop_scale_[largest]);
      }
      double* column = loops_.data() + k * n;
      if (!(column[k] >= kRedundant)) {
        if (loop_scale_[k] > 0.0)
          loop_sets_[k]->compliance = (kRedundant - column[k]) / (loop_scale_[k] * loop_scale_[k]);
        column[k] = kRedundant;
      }
      const double inverse = 1.0 / column[k];
      for (std::size_t c = k + 1; c < n; ++c) {
        const double factor = column[c] * inverse;
        for (std::size_t r = c; r < n; ++r) loops_[c * n + r] -= factor * column[r];
      }
    }
  }
}

void Assembler::clear() {
  softened_ = false;
  sets_.clear();
  terms_.clear();
  selection_.clear();
  all_sets_.clear();
  rows_ = num_slots_ = 0;
}

void Assembler::assemble(const Dynamics& dynamics, const ConstVectorRef& q, const ConstVectorRef& v,
                         const ConstVectorRef& free_v, const std::vector<ContactPoint>& contacts, const Vector* reach) {
  if (support_masks_.empty()) {  // once: the masks of the tree
    nv_articulated_ = dynamics.num_articulated();
    words_ = static_cast<int>((nv_articulated_ + 63) / 64);
    const int num_frames = world_->num_frames() - dynamics.num_free_bodies();
    chain_masks_.assign(static_cast<std::size_t>(nv_articulated_ * words_), 0);
    for (Index k = 0; k < nv_articulated_; ++k)
      for (int d = static_cast<int>(k); d >= 0; d = dynamics.factor_parent()[static_cast<std::size_t>(d)])
        chain_masks_[static_cast<std::size_t>(k * words_ + d / 64)] |= std::uint64_t{1} << (d % 64);
    support_masks_.assign(static_cast<std::size_t>(num_frames * words_ + 1), 0);
    for (int frame = 1; frame < num_frames; ++frame)
      for (const int k : dynamics.support(frame))
        for (int w = 0; w < words_; ++w)
          support_masks_[static_cast<std::size_t>(frame * words_ + w)] |=
              chain_masks_[static_cast<std::size_t>(k * words_ + w)];
    sets_of_free_.resize(static_cast<std::size_t>(dynamics.num_free_bodies()));
  }
  clear();
  sets_.reserve(contacts.size() + 2 * (limited_joints_.size() + limited_tendons_.size()) + friction_velocities_.size() +
                6 * world_->constraints().size());
  dynamics_ = &dynamics;
  free_v_ = free_v;
  add_contacts(contacts);
  add_moments();
  add_limits(q, v, free_v, reach);
  add_joint_friction();
  add_equalities(dynamics, q, v);
  correct(v);
}

/// An impulse of zero does not do for this set at the velocity sigma, of which sigma points at its rows.
bool Assembler::violated(const Set& set, const double* sigma, Law law) const {
  if (is_moment(set)) return false;  // comes with its contact
  if (set.source != SetSource::Contact) return sigma[0] < 0.0;
  const double sliding = law == Law::Ccp ? set.material.friction * std::hypot(sigma[0], sigma[1]) : 0.0;
  return sigma[2] < sliding - (set.spare ? kSpareSlack : 0.0);
}

void Assembler::write_problem() {
  constraint_sets_.clear();
  int rows = 0;
  for (const int i : selection_) {
    Set& set = sets_[static_cast<std::size_t>(i)];
    build_rows(set);
    set.offset = rows;
    rows += set.rows;
    constraint_sets_.add(all_sets_[i]);
  }
  multiply_articulated(selection_);
  soften_redundant(selection_);
  // One group that holds all rows: its product is G.
  const bool coupled = groups_.size() == 1 && groups_[0].rows == rows && rows <= kCoupledRows &&
                       std::all_of(selection_.begin(), selection_.end(),
                                   [this](int i) { return sets_[static_cast<std::size_t>(i)].num_free == 0; });
  if (coupled) {
    double* to = coupled_->reset(rows);
    for (int c = 0; c < rows; ++c)
      for (int r = c; r < rows; ++r)
        to[c * rows + r] = to[r * rows + c] = products_[static_cast<std::size_t>(c * rows + r)];
    if (has_moments_) add_loads(to, rows);
  } else {
    multiply_blocks(selection_, constraint_sets_, *delassus_);
  }
  problem_g_.resize(rows);
  problem_compliance_.setZero(rows);
  for (const int i : selection_) {
    const Set& set = sets_[static_cast<std::size_t>(i)];
    for (int r = 0; r < set.rows; ++r) problem_g_[set.offset + r] = g_[set.start + r];
    problem_compliance_[set.offset + set.rows - 1] = set.compliance;
  }
  problem_.assign(coupled ? std::shared_ptr<const DelassusOperator>(coupled_) : delassus_, problem_g_, constraint_sets_,
                  problem_compliance_, largest_left_out());
}

/// |g| / sqrt(d) of the set left out whose |g| is largest, d as in ContactProblem::scale(): about the largest such
/// value, and never more.
double Assembler::largest_left_out() {
  Set* farthest = nullptr;
  double square = 0.0;
  for (Set& set : sets_) {
    if (set.offset >= 0 || is_moment(set)) continue;
    double own = 0.0;
    for (int r = 0; r < set.rows; ++r) own += g_[set.start + r] * g_[set.start + r];
    if (own > square) square = own, farthest = &set;
  }
  if (!farthest) return 0.0;
  build_rows(*farthest);
  double trace = farthest->compliance + squares(*farthest);
  for (int k = 0; k < farthest->num_moments; ++k) {
    Set& moment = sets_[static_cast<std::size_t>(farthest->first_moment + k)];
    build_rows(moment);
    trace += moment.load_weight * moment.load_factor * moment.load_factor;
  }
  return trace > 0.0 ? std::sqrt(square * farthest->rows / trace) : 0.0;
}

void Assembler::select(const ConstVectorRef& guess, Law law, bool all) {
  if (law == Law::Ccp) set_load_speeds();
  selection_.clear();
  for (std::size_t i = 0; i < sets_.size(); ++i) {
    const Set& set = sets_[i];
    bool acts = set.source == SetSource::JointFriction || set.source == SetSource::Equality;
    if (is_moment(set))
      acts = std::binary_search(selection_.begin(), selection_.end(), set.index);
    else
      for (int r = 0; r < set.rows; ++r) acts = acts || guess[set.start + r] != 0.0;
    if (all || acts || (!set.spare && violated(set, g_.data() + set.start, law)))
      selection_.push_back(static_cast<int>(i));
  }
  write_problem();
}

bool Assembler::select_violated(const ConstVectorRef& impulse, Law law, VectorRef sigma) {
  whitened_.setZero(free_v_.size());
  for (const int i : selection_) add_row_products(sets_[static_cast<std::size_t>(i)], impulse);
  dynamics_->solve_half_transposed(whitened_);
  velocity_ = free_v_ + whitened_;
  if (selection_.size() == sets_.size()) return false;
  dynamics_->twists(velocity_, twists_);
  const std::size_t before = selection_.size();
  const auto joins = [&](std::size_t i) {
    const Set& set = sets_[i];
    return is_moment(set) ? std::binary_search(selection_.begin() + static_cast<std::ptrdiff_t>(before),
                                               selection_.end(), set.index)
                          : violated(set, sigma.data() + set.start, law);
  };
  bool spare = false;
  for (std::size_t i = 0; i < sets_.size(); ++i) {
    Set& set = sets_[i];
    if (set.offset >= 0) continue;
    double* own = sigma.data() + set.start;
    set_velocity(set, velocity_, twists_, own);
    if (law == Law::Ccp && is_moment(set)) set_load_speed(set, std::hypot(own[0], own[1]));  // (S17), load 0
    own[set.rows - 1] += set.correction;
    spare = spare || set.spare;
    if (!set.spare && joins(i)) selection_.push_back(static_cast<int>(i));
  }
  // Spare contacts only where nothing else is violated: with that they may not be.
  if (spare && selection_.size() == before)
    for (std::size_t i = 0; i < sets_.size(); ++i)
      if (sets_[i].offset < 0 && (sets_[i].spare || is_moment(sets_[i])) && joins(i))
        selection_.push_back(static_cast<int>(i));
  if (selection_.size() == before) return false;
  std::sort(selection_.begin(), selection_.end());
  write_problem();
  return true;
}

ContactProblem Assembler::whole_problem() {
  std::vector<int> all(sets_.size());
  for (std::size_t i = 0; i < sets_.size(); ++i) {
    all[i] = static_cast<int>(i);
    build_rows(sets_[i]);
  }
  const auto delassus = std::make_shared<BlockDelassus>();
  multiply_articulated(all);
  soften_redundant(all);
  Vector compliance = Vector::Zero(rows_);
  for (const Set& set : sets_) compliance[set.start + set.rows - 1] = set.compliance;
  multiply_blocks(all, all_sets_, *delassus);
  return ContactProblem(delassus, g_, all_sets_, compliance);
}

/// whitened_ += Y^T impulse, of one set.
void Assembler::add_row_products(const Set& set, const ConstVectorRef& impulse) {
  const double* x = impulse.data() + set.start;
  if (set.articulated >= 0) {
    const double* y = columns_.data() + static_cast<std::ptrdiff_t>(set.articulated) * 3 * nv_articulated_;
    const std::uint64_t* mask = masks_.data() + static_cast<std::ptrdiff_t>(set.articulated) * words_;
    for (int w = 0; w < words_; ++w)
      for (std::uint64_t bits = mask[w]; bits; bits &= bits - 1) {
        const int k = 64 * w + __builtin_ctzll(bits);
        const double* yk = y + k * set.rows;
        double& out = whitened_[k];
        out = set.rows == 3 ? out + yk[0] * x[0] + yk[1] * x[1] + yk[2] * x[2] : out + yk[0] * x[0];
      }
  }
  for (int side = 0; side < set.num_free; ++side) {
    double* out = whitened_.data() + nv_articulated_ + 6 * static_cast<std::ptrdiff_t>(set.free[side]);
    const double* y = set.y[side];
    for (int k = 0; k < 6; ++k, y += set.rows)
      out[k] = set.rows == 3 ? out[k] + y[0] * x[0] + y[1] * x[1] + y[2] * x[2] : out[k] + y[0] * x[0];
  }
}

}  // namespace signorini
