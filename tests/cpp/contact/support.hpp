#pragma once

#include <Eigen/Cholesky>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "signorini/delassus/block.hpp"
#include "signorini/delassus/coupled.hpp"
#include "signorini/delassus/dense.hpp"
#include "signorini/delassus/mass_space.hpp"
#include "signorini/delassus/sparse.hpp"
#include "signorini/errors.hpp"
#include "signorini/problem/contact_problem.hpp"
#include "signorini/problem/residual.hpp"
#include "signorini/solver/solve.hpp"

namespace signorini::testing {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// The same numbers everywhere, unlike those of <random>'s distributions.
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed * 0x9e3779b97f4a7c15ull + 1) {}

  double uniform(double lower, double upper) {
    state_ ^= state_ >> 12, state_ ^= state_ << 25, state_ ^= state_ >> 27;
    const std::uint64_t bits = (state_ * 0x2545f4914f6cdd1dull) >> 11;
    return lower + (upper - lower) * static_cast<double>(bits) / 9007199254740992.0;
  }
  Vector vector(Index n, double size = 1.0) {
    Vector v(n);
    for (Index i = 0; i < n; ++i) v[i] = uniform(-size, size);
    return v;
  }
  Matrix matrix(Index rows, Index columns) {
    Matrix m(rows, columns);
    for (Index j = 0; j < columns; ++j) m.col(j) = vector(rows);
    return m;
  }

 private:
  std::uint64_t state_;
};

inline std::shared_ptr<const DelassusOperator> dense(const Matrix& g) { return std::make_shared<DenseDelassus>(g); }

inline Vector vector3(double x, double y, double z) { return Eigen::Vector3d(x, y, z); }

/// One point of given mass on the ground, moving at `velocity` if nothing stops it.
inline ContactProblem point_on_ground(double mass, double friction, const Vector& velocity,
                                      const Vector& compliance = Vector()) {
  return ContactProblem(dense(Matrix::Identity(3, 3) / mass), velocity,
                        ConstraintSets::friction_cones(Vector::Constant(1, friction)), compliance);
}

/// Problems without a solution: a contact that closes and that no impulse moves; a body between two closing walls. The
/// impulses of an iteration grow without bound.
inline std::vector<ContactProblem> unsolvable_problems() {
  Matrix g = Matrix::Zero(6, 6);
  g.topLeftCorner(3, 3).setIdentity();
  Vector free = Vector::Zero(6);
  free[2] = free[5] = -1.0;
  Matrix opposed(2, 2);
  opposed << 1.0, -1.0, -1.0, 1.0;
  ConstraintSets lines;
  lines.add_half_line();
  lines.add_half_line();
  return {ContactProblem(dense(g), free, ConstraintSets::friction_cones(Vector::Constant(2, 0.5))),
          ContactProblem(dense(opposed), Vector::Constant(2, -1.0), lines)};
}

enum class Operator { Dense, Sparse, MassSpace, Block, Coupled };
inline constexpr Operator kOperators[] = {Operator::Dense, Operator::Sparse, Operator::MassSpace, Operator::Block,
                                          Operator::Coupled};

inline const char* operator_name(Operator type) {
  switch (type) {
    case Operator::Dense:
      return "dense";
    case Operator::Sparse:
      return "sparse";
    case Operator::MassSpace:
      return "mass space";
    case Operator::Block:
      return "block";
    case Operator::Coupled:
      return "coupled";
  }
  return "";
}

/// Fills `delassus` with the blocks of g; blocks that are exactly zero are left out.
inline void fill_blocks(const ConstraintSets& sets, const Matrix& g, BlockDelassus& delassus) {
  const auto block = [&](Index i, Index j) {
    return g.block(sets[i].offset, sets[j].offset, sets[i].size(), sets[j].size());
  };
  std::vector<BlockDelassus::Pair> pairs;
  for (int i = 0; i < static_cast<int>(sets.num_sets()); ++i)
    for (int j = 0; j < i; ++j)
      if (!block(i, j).isZero(0.0)) pairs.emplace_back(i, j);
  delassus.reset(sets, pairs);
  for (Index i = 0; i < sets.num_sets(); ++i)
    Eigen::Map<Matrix>(delassus.diagonal_block(i), sets[i].size(), sets[i].size()) = block(i, i);
  for (Index k = 0; k < delassus.num_blocks(); ++k) {
    const auto [i, j] = delassus.pair(k);
    Eigen::Map<Matrix>(delassus.block(k), sets[i].size(), sets[j].size()) = block(i, j);
  }
}

/// G = J M^-1 J^T as one of the operators.
inline std::shared_ptr<const DelassusOperator> make_operator(Operator type, const ConstraintSets& sets,
                                                             const Matrix& mass, const Matrix& jacobian) {
  if (type == Operator::MassSpace) {
    return std::make_shared<MassSpaceDelassus>(SparseMatrix(mass.sparseView()), SparseMatrix(jacobian.sparseView()));
  }
  const Matrix g = jacobian * mass.llt().solve(Matrix(jacobian.transpose()));
  if (type == Operator::Dense) return std::make_shared<DenseDelassus>(g);
  if (type == Operator::Block) {
    auto blocks = std::make_shared<BlockDelassus>();
    fill_blocks(sets, g, *blocks);
    return blocks;
  }
  if (type == Operator::Coupled) {
    auto coupled = std::make_shared<CoupledDelassus>();
    Eigen::Map<Matrix>(coupled->reset(g.rows()), g.rows(), g.cols()) = 0.5 * (g + g.transpose());
    return coupled;
  }
  return std::make_shared<SparseDelassus>(SparseMatrix(g.sparseView()));
}

/// A problem made from its solution.
struct Planted {
  ContactProblem problem;
  Vector impulse, velocity;
};

/// Contacts between bodies of three velocities each, sticking, slipping and open in turn; then, if `extras`, a half
/// line, an interval and an equality. Draws impulse and velocity that obey the law, and chooses g for them.
inline Planted plant(std::uint64_t seed, Index contacts, Law law, Operator type = Operator::Dense, bool extras = false,
                     const Vector& compliance = Vector()) {
  Random random(seed);
  const Index n = 3 * contacts + (extras ? 4 : 0), bodies = contacts + 2, nv = 3 * bodies;
  Matrix mass = Matrix::Zero(nv, nv), jacobian = Matrix::Zero(n, nv);
  for (Index b = 0; b < bodies; ++b) {
    mass.block(3 * b, 3 * b, 3, 3) = random.uniform(0.5, 2.0) * Matrix::Identity(3, 3);
    mass(3 * b, 3 * b + 1) = mass(3 * b + 1, 3 * b) = 0.1;
  }
  for (Index c = 0; c < contacts; ++c) {
    jacobian.block(3 * c, 3 * c, 3, 3) = Matrix::Identity(3, 3) + 0.2 * random.matrix(3, 3);
    if (c % 3 != 0) jacobian.block(3 * c, 3 * c - 3, 3, 3) = -Matrix::Identity(3, 3) + 0.2 * random.matrix(3, 3);
  }
  if (extras) jacobian.bottomRightCorner(4, 6) = random.matrix(4, 6), jacobian.bottomLeftCorner(1, 3).setConstant(0.3);

  ConstraintSets sets;
  Vector x = Vector::Zero(n), sigma = Vector::Zero(n);
  for (Index c = 0; c < contacts; ++c) {
    const double mu = random.uniform(0.2, 1.0), angle = random.uniform(0.0, 6.28);
    const Eigen::Vector2d direction(std::cos(angle), std::sin(angle));
    sets.add_friction_cone(mu);
    const double normal = random.uniform(0.5, 2.0), speed = random.uniform(0.1, 1.0);
    switch (c % 3) {
      case 0:  // sticks
        x.segment(3 * c, 2) = 0.7 * mu * normal * direction, x[3 * c + 2] = normal;
        break;
      case 1:  // slips; without the De Saxce term it also lifts off
        x.segment(3 * c, 2) = -mu * normal * direction, x[3 * c + 2] = normal;
        sigma.segment(3 * c, 2) = speed * direction;
        if (law == Law::Ccp) sigma[3 * c + 2] = mu * speed;
        break;
      default:  // opens
        sigma.segment(3 * c, 2) = speed * direction, sigma[3 * c + 2] = 2.0 * speed;
    }
  }
  if (extras) {
    sets.add_half_line(), x[3 * contacts] = 1.0;
    sets.add_half_line(), sigma[3 * contacts + 1] = 0.5;
    sets.add_interval(-0.3, 0.6), x[3 * contacts + 2] = 0.6, sigma[3 * contacts + 2] = -0.4;
    sets.add_equality(), x[3 * contacts + 3] = -0.8;
  }
  const auto delassus = make_operator(type, sets, mass, jacobian);
  Vector g(n);
  delassus->apply(x, g);
  if (compliance.size() > 0) g += compliance.cwiseProduct(x);
  return {ContactProblem(delassus, sigma - g, sets, compliance), x, sigma};
}

inline const std::array<SolverType, 5> kAllSolvers = {SolverType::Auto, SolverType::Admm, SolverType::Pgs,
                                                      SolverType::InteriorPoint, SolverType::Newton};

/// Models of contact other than the law, which the certificate seldom calls solved.
inline constexpr std::array<SolverType, 3> kModels = {SolverType::LcpPgs, SolverType::ConvexNewton,
                                                      SolverType::Bisection};

inline Settings settings_for(SolverType solver, double tolerance = 1e-8, Law law = Law::Ncp) {
  Settings settings;
  settings.solver = solver;
  settings.tolerance = tolerance;
  settings.law = law;
  settings.max_iterations = solver == SolverType::Pgs ? 20000 : 0;
  return settings;
}

/// The field that InvalidInput names, or "" when nothing is raised.
template <typename Function>
std::string refused_field(Function&& function) {
  try {
    function();
  } catch (const InvalidInput& error) {
    return error.field();
  }
  return "";
}

}  // namespace signorini::testing
