// Letters in this file: x, sigma  impulse and velocity;  c  velocity of a contact without its own impulse;  theta
// direction of the tangential impulse;  alpha  share of the new impulse.
#include "signorini/solver/bisection.hpp"

#include <Eigen/Eigenvalues>
#include <cmath>

#include "sweeps.hpp"

namespace signorini {
namespace {

constexpr int kBisections = 50;
constexpr double kStride = 3.14159265358979323846 / 16.0;  // of the search for an interval
constexpr int kStrides = 32;
constexpr double kSingular = 1e-12;

/// The curve |x_T| = mu x_N, sigma_N = 0, by the angle of x_T.
class SlipCurve {
 public:
  SlipCurve(const Eigen::Matrix3d& block, double friction, const double* c) : g_(block), mu_(friction), c_(c) {}

  /// Puts the curve's point at theta into x; false where the curve is not: there no impulse on the cone stops the
  /// normal. slope: of the energy along the curve.
  bool point(double theta, double* x, double& slope) const {
    const double cosine = std::cos(theta), sine = std::sin(theta);
    const double denominator = g_(2, 2) + mu_ * (g_(2, 0) * cosine + g_(2, 1) * sine);
    if (!(denominator > kSingular * g_(2, 2))) return false;
    x[2] = -c_[2] / denominator;
    x[0] = mu_ * x[2] * cosine, x[1] = mu_ * x[2] * sine;
    const double change = -x[2] * mu_ * (g_(2, 1) * cosine - g_(2, 0) * sine) / denominator;  // of x_N by theta
    const double s0 = g_(0, 0) * x[0] + g_(0, 1) * x[1] + g_(0, 2) * x[2] + c_[0];
    const double s1 = g_(1, 0) * x[0] + g_(1, 1) * x[1] + g_(1, 2) * x[2] + c_[1];
    slope = mu_ * (s0 * (change * cosine - x[2] * sine) + s1 * (change * sine + x[2] * cosine));
    return true;
  }

 private:
  const Eigen::Matrix3d& g_;
  const double mu_;
  const double* c_;
};

}  // namespace

void solve_contact_by_bisection(const Eigen::Matrix3d& block, const Eigen::Matrix3d& inverse, double friction,
                                const double* c, double* x) {
  x[0] = x[1] = x[2] = 0.0;
  if (c[2] >= 0.0 || !(block(2, 2) > 0.0)) return;
  if (friction == 0.0) {
    x[2] = -c[2] / block(2, 2);
    return;
  }
  for (int k = 0; k < 3; ++k) x[k] = -(inverse(k, 0) * c[0] + inverse(k, 1) * c[1] + inverse(k, 2) * c[2]);
  if (std::hypot(x[0], x[1]) <= friction * x[2]) return;

  const SlipCurve curve(block, friction, c);
  const double towards_stick = std::atan2(x[1], x[0]);
  double slope = 0.0;
  if (!curve.point(towards_stick, x, slope)) {  // a block that is not definite
    x[0] = x[1] = 0.0, x[2] = -c[2] / block(2, 2);
    return;
  }
  // Downhill until the slope turns, or the curve ends, where the energy is infinite; then halve.
  const double sign = slope < 0.0 ? 1.0 : -1.0;
  double down = towards_stick, up = down;
  for (int k = 0; k < kStrides; ++k) {
    up = down + sign * kStride;
    if (!curve.point(up, x, slope) || sign * slope >= 0.0) break;
    down = up;
  }
  for (int k = 0; k < kBisections; ++k) {
    const double middle = 0.5 * (down + up);
    (curve.point(middle, x, slope) && sign * slope < 0.0 ? down : up) = middle;
  }
  curve.point(down, x, slope);
}

void solve_bisection(const ContactProblem& problem, const Settings& settings, BisectionWorkspace& w, const Guess* guess,
                     Solution& solution) {
  w.rows.setup(problem, guess);
  problem.sets().project(w.rows.impulse, w.rows.impulse);
  w.block.resize(static_cast<std::size_t>(problem.num_sets()));
  w.inverse.resize(w.block.size());
  for (std::size_t i = 0; i < w.block.size(); ++i) {
    const ConstraintSet& set = problem.sets()[static_cast<Index>(i)];
    w.block[i] = w.rows.block(set);
    w.inverse[i].setZero();
    if (set.size() == 1) {
      if (w.block[i](0, 0) > 0.0) w.inverse[i](0, 0) = 1.0 / w.block[i](0, 0);
      continue;
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(w.block[i]);
    for (int k = 0; k < 3; ++k) {  // without the directions in which nothing moves
      const double value = eigen.eigenvalues()[k];
      if (value > kSingular * eigen.eigenvalues()[2] && value > 0.0)
        w.inverse[i] += eigen.eigenvectors().col(k) * eigen.eigenvectors().col(k).transpose() / value;
    }
  }
  const auto own = [&](std::size_t i, const ConstraintSet& set, double* x) {
    const Index o = set.offset;
    double c[3];
    for (int k = 0; k < 3; ++k) {
      c[k] = w.rows.sigma[o + k];
      for (int j = 0; j < 3; ++j) c[k] -= w.block[i](k, j) * w.rows.impulse[o + j];
    }
    solve_contact_by_bisection(w.block[i], w.inverse[i], set.friction, c, x);
  };
  const double least = settings.bisection.least_relaxation;
  double alpha = 1.0;
  const auto sweep = [&] {
    for (std::size_t i = 0; i < w.block.size(); ++i) {
      const ConstraintSet& set = problem.sets()[static_cast<Index>(i)];
      if (set.type != SetType::FrictionCone) {
        w.rows.project_step(set, alpha * w.inverse[i](0, 0));
        continue;
      }
      double x[3];
      own(i, set, x);
      for (int k = 0; k < 3; ++k) {
        const double before = w.rows.impulse[set.offset + k];
        w.rows.assign(set.offset + k, before + alpha * (x[k] - before));
      }
    }
    alpha = least + settings.bisection.relaxation_decay * (alpha - least);
  };
  // What a contact's own solution would still change.
  const auto contact_error = [&](Index i, const ConstraintSet& set) {
    double x[3];
    own(static_cast<std::size_t>(i), set, x);
    const double* now = w.rows.impulse.data() + set.offset;
    return std::sqrt(problem.scale()[set.offset]) * std::hypot(std::hypot(x[0] - now[0], x[1] - now[1]), x[2] - now[2]);
  };
  solve_model(
      problem, settings, w.rows, sweep,
      [&] { return model_relative(problem, settings.tolerance, w.rows, contact_error); }, solution);
}

}  // namespace signorini
