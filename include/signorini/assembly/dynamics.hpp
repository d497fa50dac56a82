#pragma once

#include <memory>
#include <vector>

#include "signorini/model/world.hpp"

namespace signorini {

/// Velocity of a frame: of its point at the world's origin, and angular; world axes.
struct Twist {
  Vector3 linear = Vector3::Zero(), angular = Vector3::Zero();
  Vector3 at(const Vector3& point) const { return linear + angular.cross(point); }
};

/// A force and its moment about the world's origin; world axes.
struct Wrench {
  Vector3 force = Vector3::Zero(), moment = Vector3::Zero();  ///< [N, N m]
  void add(const Vector3& f, const Vector3& point) { force += f, moment += point.cross(f); }
};

/// Coefficients times joint values, summed.
double tendon_length(const World& world, const Tendon& tendon, const ConstVectorRef& q);

/// A world at one state: placements, mass matrix, bias, all in O(bodies) for free bodies. With M^ = M + what resists
/// (S1), Y = J M^^-1/2 (rows whitened: G = J M^^-1 J^T = Y Y^T) is what contact rows are kept as. Velocities of free
/// joints count in the frame of the body as it stands at the start of the step, held still: so bias() has no term that
/// only turns that frame (docs/simulation.md, S3).
class Dynamics {
 public:
  explicit Dynamics(std::shared_ptr<const World> world);
  ~Dynamics();
  Dynamics(Dynamics&&) noexcept;

  /// Placements, mass matrix and bias at (q, v); the factor is stale until factor().
  void update(const ConstVectorRef& q, const ConstVectorRef& v);
  /// Placements only.
  void update_placements(const ConstVectorRef& q);
  /// After it: velocities and inertias, all that inverse() needs.
  void update_velocities(const ConstVectorRef& v);
  const std::vector<Placement>& frames() const { return frames_; }

  /// Generalised force of gravity and Coriolis terms: M dv/dt = force - bias.
  const Vector& bias() const { return bias_; }

  /// force = M acceleration + bias - J^T wrenches by one sweep outwards and one back (the recursive Newton-Euler
  /// algorithm), wrenches one a frame. After update_velocities() or update().
  void inverse(const ConstVectorRef& acceleration, const std::vector<Wrench>& wrenches, VectorRef force);

  /// Acceleration of a point that moves with a frame while all velocities stay as they were in update() [m/s^2].
  Vector3 drift(int frame, const Vector3& point, const ConstVectorRef& v) const;

  /// Of every frame, when the joints move at v; after update().
  void twists(const ConstVectorRef& v, std::vector<Twist>& out) const;

  /// Values that say M^ - M: one a velocity, on the diagonal, then one a tendon, times c c^T of its coefficients c.
  Index num_implicit() const;
  /// product += (M^ - M) x
  void add_implicit(const ConstVectorRef& implicit, const ConstVectorRef& x, VectorRef product) const;
  /// Factors M^; implicit >= 0, num_implicit() values. False when M^ is not positive definite.
  bool factor(const ConstVectorRef& implicit);
  /// x <- M^^-1 x
  void solve(VectorRef x) const;
  /// x <- W^-1 x and x <- W^-T x with M^ = W W^T: W^-T takes whitened velocities back, W^-1 whitens forces.
  void solve_half(VectorRef x) const;
  void solve_half_transposed(VectorRef x) const;
  /// x <- W^T x: whitened velocity, Y (W^T v) = J v.
  void multiply_half_transposed(VectorRef x) const;

  // The articulated part: velocities 0 .. num_articulated() - 1.
  Index num_articulated() const;
  /// Of a velocity: the next one on its way to the root in the elimination tree of M^, or -1.
  const std::vector<int>& factor_parent() const;
  /// Velocities (ascending) that move an articulated frame.
  const std::vector<int>& support(int frame) const { return support_[static_cast<std::size_t>(frame)]; }
  /// 6 values of velocity k: linear velocity at the world's origin, angular velocity, both in world axes.
  const double* motion(Index k) const;
  /// Whitens `rows` rows of J stored column by column (rows values a velocity) in place: y <- y W^-T. `dofs` descends
  /// and holds every velocity in use with all those on its way to the root.
  void whiten(double* y, int rows, const int* dofs, int count) const;

  // The free bodies.
  /// -1 where the frame is articulated or the world.
  int free_body(int frame) const { return frame >= first_free_frame_ ? frame - first_free_frame_ : -1; }
  int num_free_bodies() const;
  Index free_v(int body) const;
  /// W_b^-T of a free body, 6 x 6: Y_b = J_b W_b^-T.
  const Eigen::Matrix<double, 6, 6>& free_whitener(int body) const;

  double kinetic_energy(const ConstVectorRef& v) const;    ///< after update()
  double potential_energy(const ConstVectorRef& q) const;  ///< gravity and joint springs; after update()
  /// 6 x nv: velocity of a point of a body (in the body's frame [m]), then its angular velocity, world axes; updates
  /// placements and velocities.
  Matrix jacobian(const ConstVectorRef& q, int body, const Vector3& point);
  /// Mass matrix, dense, both triangles; for people and tests.
  Matrix mass_matrix() const;
  /// Linear and angular momentum about the world's origin, after update().
  Eigen::Matrix<double, 6, 1> momentum(const ConstVectorRef& v) const;

 private:
  struct Impl;
  std::shared_ptr<const World> world_;
  std::unique_ptr<Impl> impl_;
  std::vector<Placement> frames_;
  std::vector<std::vector<int>> support_;
  Vector bias_;
  int first_free_frame_ = 0;
};

}  // namespace signorini
