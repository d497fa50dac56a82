// The pyramid's section at x_N is the regular polygon of k facets around the disc of radius mu x_N, one facet across
// t1. It is the sum of k / 2 segments along d_j, the edges of the polygon, each of half length tan(pi / k) mu x_N: so
// each row is a box of its own, and k = 4 is ODE's. Letters: x, sigma impulse and velocity; omega over-relaxation.
#include "signorini/solver/lcp_pgs.hpp"

#include <algorithm>
#include <cmath>

#include "sweeps.hpp"

namespace signorini {
namespace {

constexpr double kPi = 3.14159265358979323846;

/// The polygon around the disc of radius 1.
struct Polygon {
  explicit Polygon(int k) : facets(k), half_edge(std::tan(kPi / k)) {}

  int facets;
  double half_edge;

  /// The facet in whose sector (x, y) is.
  int sector(double x, double y) const {
    return static_cast<int>(std::lround(std::atan2(y, x) * facets / (2.0 * kPi)) + facets) % facets;
  }
  double angle(int facet) const { return 2.0 * kPi * facet / facets; }

  /// Projection on the polygon around the disc of this radius, in place.
  void project(double radius, double& x, double& y) const {
    const double turn = angle(sector(x, y)), c = std::cos(turn), s = std::sin(turn);
    const double across = c * x + s * y;
    if (across <= radius) return;
    const double along = std::clamp(c * y - s * x, -radius * half_edge, radius * half_edge);
    x = c * radius - s * along;
    y = s * radius + c * along;
  }
};

class PyramidSweep {
 public:
  PyramidSweep(const ContactProblem& problem, const Settings& settings, const Polygon& polygon,
               LcpPgsWorkspace& workspace)
      : problem_(problem), omega_(settings.pgs.over_relaxation), polygon_(polygon), w_(workspace) {}

  void operator()() {
    for (Index i = 0; i < problem_.num_sets(); ++i) {
      const ConstraintSet& set = problem_.sets()[i];
      const double step = omega_ * w_.normal_step[static_cast<std::size_t>(i)];
      if (set.type == SetType::FrictionCone)
        contact(set, step, &w_.tangent[static_cast<std::size_t>(i) * static_cast<std::size_t>(polygon_.facets / 2)]);
      else
        w_.rows.project_step(set, step);
    }
  }

 private:
  void contact(const ConstraintSet& set, double step, LcpPgsWorkspace::Row* tangent) {
    const Index t1 = set.offset, t2 = t1 + 1, n = t1 + 2;
    const Vector &x = w_.rows.impulse, &sigma = w_.rows.sigma;
    w_.rows.assign(n, std::max(0.0, x[n] - step * sigma[n]));
    const double limit = polygon_.half_edge * set.friction * x[n];
    for (int j = 0; j < polygon_.facets / 2; ++j) {
      LcpPgsWorkspace::Row& row = tangent[j];
      const double velocity = row.x * sigma[t1] + row.y * sigma[t2];
      const double share = std::clamp(row.share - omega_ * row.step * velocity, -limit, limit),
                   change = share - row.share;
      if (change == 0.0) continue;
      row.share = share;
      w_.rows.assign(t1, x[t1] + row.x * change);
      w_.rows.assign(t2, x[t2] + row.y * change);
    }
  }

  const ContactProblem& problem_;
  const double omega_;
  const Polygon& polygon_;
  LcpPgsWorkspace& w_;
};

/// Directions, steps and shares of a contact, whose impulse is put into the pyramid. Shares of a point of the polygon:
/// as much of the box as its gauge, with the signs of the facet it is behind; the rest is along that facet.
void start(const Polygon& polygon, const ConstraintSet& set, const Eigen::Matrix3d& block, Vector& impulse,
           LcpPgsWorkspace::Row* tangent) {
  double &x = impulse[set.offset], &y = impulse[set.offset + 1], &normal = impulse[set.offset + 2];
  normal = std::max(normal, 0.0);
  polygon.project(set.friction * normal, x, y);
  const int facet = polygon.sector(x, y), half = polygon.facets / 2;
  const double nx = std::cos(polygon.angle(facet)), ny = std::sin(polygon.angle(facet)), across = nx * x + ny * y;
  for (int j = 0; j < half; ++j) {
    LcpPgsWorkspace::Row& row = tangent[j];
    row.x = -std::sin(polygon.angle(j));
    row.y = std::cos(polygon.angle(j));
    const double entry = row.x * row.x * block(0, 0) + 2.0 * row.x * row.y * block(0, 1) + row.y * row.y * block(1, 1);
    row.step = entry > 0.0 ? 1.0 / entry : 0.0;
    row.share =
        j == facet % half ? row.x * x + row.y * y : std::copysign(across * polygon.half_edge, row.x * nx + row.y * ny);
  }
}

}  // namespace

void solve_lcp_pgs(const ContactProblem& problem, const Settings& settings, LcpPgsWorkspace& w, const Guess* guess,
                   Solution& solution) {
  const Polygon polygon(settings.pyramid.facets);
  const std::size_t half = static_cast<std::size_t>(polygon.facets / 2);
  w.rows.setup(problem, guess);
  w.normal_step.assign(static_cast<std::size_t>(problem.num_sets()), 0.0);
  w.tangent.assign(w.normal_step.size() * half, {});
  for (std::size_t i = 0; i < w.normal_step.size(); ++i) {
    const ConstraintSet& set = problem.sets()[static_cast<Index>(i)];
    const Eigen::Matrix3d block = w.rows.block(set);
    const double entry = block(set.size() - 1, set.size() - 1);
    w.normal_step[i] = entry > 0.0 ? 1.0 / entry : 0.0;
    if (set.type == SetType::FrictionCone)
      start(polygon, set, block, w.rows.impulse, &w.tangent[i * half]);
    else
      project(set, &w.rows.impulse[set.offset], &w.rows.impulse[set.offset]);
  }
  // |l - P(l - t)|: Signorini's normal, and the polygon of the normal impulse, in which friction dissipates the most.
  const auto contact_error = [&](Index, const ConstraintSet& set) {
    const Index o = set.offset;
    const double root = std::sqrt(problem.scale()[o]);
    double l[3], t[3];
    for (Index k = 0; k < 3; ++k) l[k] = root * w.rows.impulse[o + k], t[k] = w.rows.sigma[o + k] / root;
    double x = l[0] - t[0], y = l[1] - t[1];
    polygon.project(set.friction * l[2], x, y);
    return std::hypot(std::hypot(l[0] - x, l[1] - y), std::min(l[2], t[2]));
  };
  solve_model(
      problem, settings, w.rows, PyramidSweep(problem, settings, polygon, w),
      [&] { return model_relative(problem, settings.tolerance, w.rows, contact_error); }, solution);
}

}  // namespace signorini
