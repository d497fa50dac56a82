#include "closest_motion.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include "assembly/tie_load.hpp"
#include "signorini/delassus/dense.hpp"
#include "signorini/problem/de_saxce.hpp"
#include "signorini/solver/inverse.hpp"
#include "signorini/solver/solve.hpp"

namespace signorini {
namespace {

constexpr double kProximalShare = 1e-3;  // rho over the mean of G's diagonal
constexpr int kProximalSteps = 50;
constexpr double kGain = 0.1;
constexpr int kConvexSteps = 6;
constexpr double kLeastGain = 1e-3;
constexpr int kShiftRounds = 50;        // until loads fit, under the CCP
constexpr double kImpulseShare = 1e-4;  // of the same mean: weight of impulses beside that of motions

double mean_diagonal(const Matrix& g) { return g.rows() > 0 ? g.diagonal().mean() : 1.0; }

/// The solution of a contact problem next to `impulse`, by proximal steps from there: each is a problem with the
/// compliance R + rho, which always has a solution (T41). Solved when judge_inverse() finds at most `allowed` [m/s].
Status solve_next_to(Vector& impulse, const Matrix& delassus, const Vector& g, const ConstraintSets& sets,
                     const Vector& compliance, const Settings& settings, double allowed) {
  const auto shared = std::make_shared<DenseDelassus>(delassus);
  const ContactProblem problem(shared, g, sets, compliance);
  const double rho = kProximalShare * mean_diagonal(delassus);
  InverseSolution judged;
  Vector sigma(impulse.size()), best = impulse;
  double least = std::numeric_limits<double>::infinity();
  for (int k = 0;; ++k) {
    problem.velocity(impulse, sigma);
    judged.impulse = impulse;
    judge_inverse(sigma - compliance.cwiseProduct(impulse), compliance, sets, settings.law, 1.0, judged);
    const bool gains = judged.residual < kGain * least;
    if (judged.residual < least) least = judged.residual, best = impulse;
    // A start that is good enough stays what it is; else further, as long as that gains much.
    if (least <= allowed && (k == 0 || !gains || least == 0.0)) break;
    if (k == kProximalSteps) break;
    const Guess from{impulse, 0.0};
    impulse = solve(ContactProblem(shared, g - rho * impulse, sets, Vector(compliance.array() + rho)), settings, &from)
                  .impulse;
    // That may be just inside a border on which it belongs: one step along -s puts it there.
    problem.velocity(impulse, sigma);
    add_de_saxce_correction(sets, settings.law, sigma);
    sets.project(Vector(impulse - sigma.cwiseQuotient(problem.scale())), impulse);
  }
  impulse = best;
  return least <= allowed ? Status::Solved : Status::MaxIterations;
}

/// A piece of (S15): impulse = fixed + spread y, and rows over (change, impulse) whose values lie in the duals of
/// `sets`.
struct Piece {
  struct Row {
    Vector motion, impulse;  // times the change, times the impulse
    double constant;
  };
  Vector fixed;
  std::vector<std::pair<Index, Vector>> spread;  // columns: first row, values
  std::vector<Row> rows;
  ConstraintSets sets;
};

/// (S13): candidates, and downhill from them.
class Search {
 public:
  explicit Search(const ClosestProblem& problem);

  ClosestMotion run();

 private:
  struct Candidate {
    Status status = Status::Invalid;
    Vector change, impulse;
  };
  void tie_loads();
  Status solve_for_root(Vector& impulse, const Matrix& delassus, Vector g) const;
  Candidate joints_as_asked() const;
  Candidate torques_as_asked() const;
  Status project_on_allowed(Vector& change) const;
  Piece piece_of(const Candidate& from, bool stick) const;
  Candidate least_change(const Piece& piece) const;
  Vector unactuated_change(const Vector& change, const Vector& impulse) const;
  bool obeys(const Candidate& candidate) const;
  double energy(const Candidate& candidate) const { return candidate.change.dot(p_.mass * candidate.change); }

  const ClosestProblem& p_;
  Eigen::LLT<Matrix> mass_, unactuated_mass_;
  Matrix ties_;                        // of loads to normal impulses (S16), a part of every G
  std::vector<std::uint8_t> settled_;  // by set: feels the unactuated velocities
  std::vector<Index> rows_;            // theirs
  ConstraintSets coupled_;
};

Search::Search(const ClosestProblem& problem) : p_(problem), mass_(problem.mass) {
  unactuated_mass_.compute(Matrix(p_.mass(p_.unactuated, p_.unactuated)));
  for (const ConstraintSet& set : p_.sets)
    settled_.push_back(!p_.jacobian.middleRows(set.offset, set.size())(Eigen::all, p_.unactuated).isZero(1e-12));
  tie_loads();
  for (Index i = 0; i < p_.sets.num_sets(); ++i) {
    const ConstraintSet& set = p_.sets[i];
    if (!settled_[static_cast<std::size_t>(i)]) continue;
    coupled_.add(set);
    for (Index r = 0; r < set.size(); ++r) rows_.push_back(set.offset + r);
  }
}

/// A contact and its moments are settled together, or not.
void Search::tie_loads() {
  ties_ = Matrix::Zero(p_.sets.size(), p_.sets.size());
  const auto settled = [this](Index set) -> std::uint8_t& { return settled_[static_cast<std::size_t>(set)]; };
  for (const ClosestProblem::Tie& tie : p_.ties) {
    settled(tie.contact) |= settled(tie.moment);
    const Index first = p_.sets[tie.moment].offset, normal = p_.sets[tie.contact].offset + 2;
    const Matrix j = p_.jacobian.middleRows(first, 2);
    const Vector own = (j * mass_.solve(j.transpose())).diagonal();
    const double weight = own.maxCoeff() > 0.0 ? own.maxCoeff() : 1.0;
    tie_load(normal, first, {own[0] == 0.0, own[1] == 0.0}, weight, tie.factor,
             [this](Index row, Index column, double value) { ties_(row, column) += value; });
  }
  for (const ClosestProblem::Tie& tie : p_.ties) settled(tie.moment) = settled(tie.contact);
}

/// Impulses of rows_; under the CCP again until loads fit (S17).
Status Search::solve_for_root(Vector& impulse, const Matrix& delassus, Vector g) const {
  const Vector compliance = p_.compliance(rows_);
  std::vector<Index> loads;  // rows of `impulse`
  if (p_.solver.law == Law::Ccp)
    for (const ClosestProblem::Tie& tie : p_.ties)
      if (settled_[static_cast<std::size_t>(tie.moment)])
        loads.push_back(std::lower_bound(rows_.begin(), rows_.end(), p_.sets[tie.moment].offset) - rows_.begin() + 2);
  for (int round = 0;; ++round) {
    const Status status = solve_next_to(impulse, delassus, g, coupled_, compliance, p_.solver, p_.allowed);
    const Vector sigma = delassus * impulse + g;
    double largest = 0.0;
    for (const Index load : loads) {
      const double change = sigma.segment<2>(load - 2).norm() - g[load];
      largest = std::max(largest, std::abs(change));
      g[load] += change;
    }
    if (largest <= p_.allowed) return status;
    if (round == kShiftRounds) return Status::MaxIterations;
  }
}

/// change <- the least change that rigid contacts, limits and equalities allow at all: convex programs of the sets that
/// touch or are violated, until no other is. Contacts may not approach; under the CCP, not slide without lifting.
Status Search::project_on_allowed(Vector& change) const {
  change = Vector::Zero(p_.mass.rows());
  Status status = Status::Solved;
  std::vector<std::uint8_t> taken(static_cast<std::size_t>(p_.sets.num_sets()), 0);
  for (bool first = true;; first = false) {
    const Vector now = p_.velocity + p_.jacobian * change;
    bool violated = false;
    ConstraintSets sets;
    std::vector<Index> rows;
    for (Index i = 0; i < p_.sets.num_sets(); ++i) {
      const ConstraintSet& set = p_.sets[i];
      const auto at = static_cast<std::size_t>(i);
      if (!p_.kinematic[at]) continue;
      const Index row = set.offset + set.size() - 1;
      const bool both = set.type == SetType::Equality;
      const bool cone = set.type == SetType::FrictionCone && p_.solver.law == Law::Ccp;
      const double sliding = cone ? set.friction * now.segment<2>(set.offset).norm() : 0.0;
      if (!taken[at]) {
        const bool breaks = both ? std::abs(now[row]) > p_.allowed : now[row] < sliding - p_.allowed;
        violated = violated || breaks;
        taken[at] = breaks || (first && (both || now[row] <= sliding + p_.allowed));
      }
      if (!taken[at]) continue;
      if (cone) {
        sets.add_friction_cone(set.friction);
        for (Index k = 0; k < 3; ++k) rows.push_back(set.offset + k);
        continue;
      }
      both ? sets.add_equality() : sets.add_half_line();
      rows.push_back(row);
    }
    if (!violated) return status;
    const Matrix j = p_.jacobian(rows, Eigen::all);
    const Matrix back = mass_.solve(j.transpose());
    const Solution found =
        solve(ContactProblem(std::make_shared<DenseDelassus>(j * back), Vector(p_.velocity(rows)), sets), p_.solver);
    status = found.status;
    change = back * found.impulse;
  }
}

/// Of the unactuated velocities, given that of the others and the impulses (S13).
Vector Search::unactuated_change(const Vector& change, const Vector& impulse) const {
  Vector others = change;
  others(p_.unactuated).setZero();
  const Vector lacks = p_.jacobian(rows_, p_.unactuated).transpose() * impulse(rows_) - p_.missing -
                       Vector((p_.mass * others)(p_.unactuated));
  return unactuated_mass_.solve(lacks);
}

/// Joints as asked, as far as they are allowed to; what is not actuated moves as contact lets it: one NCP (S14).
Search::Candidate Search::joints_as_asked() const {
  Candidate found;
  found.status = project_on_allowed(found.change);
  found.impulse = p_.guess;
  if (!p_.unactuated.empty()) {
    found.change(p_.unactuated) = unactuated_change(found.change, Vector::Zero(p_.guess.size()));
    if (!rows_.empty()) {
      const Matrix j = p_.jacobian(rows_, p_.unactuated);
      const Matrix delassus = j * unactuated_mass_.solve(j.transpose()) + ties_(rows_, rows_);
      const Vector g = p_.velocity(rows_) + p_.jacobian(rows_, Eigen::all) * found.change;
      Vector own = p_.guess(rows_);
      const Status status = solve_for_root(own, delassus, g);
      if (status != Status::Solved) found.status = status;
      found.impulse(rows_) = own;
      found.change(p_.unactuated) = unactuated_change(found.change, found.impulse);
    }
  }
  return found;
}

/// The piece with the contact modes of a candidate; stick: all contacts that push stick. NCP only.
Piece Search::piece_of(const Candidate& from, bool stick) const {
  const Index nv = p_.mass.rows(), n = p_.sets.size();
  const Vector sigma =
      p_.velocity + p_.compliance.cwiseProduct(from.impulse) + ties_ * from.impulse + p_.jacobian * from.change;
  Piece piece;
  piece.fixed = Vector::Zero(n);
  ConstraintSets& sets = piece.sets;
  // along^T (c + J change + ties impulse) + soft times the set's last impulse
  const auto motion_row = [&](const Vector& along, Index at, Index size, double soft) {
    piece.rows.push_back({p_.jacobian.middleRows(at, size).transpose() * along,
                          ties_.middleRows(at, size).transpose() * along, along.dot(p_.velocity.segment(at, size))});
    piece.rows.back().impulse[at + size - 1] += soft;
  };
  const auto impulse_row = [&](Index at, double sign, double constant) {
    piece.rows.push_back({Vector::Zero(nv), sign * Vector::Unit(n, at), constant});
  };
  const auto free_impulse = [&](Index at, const Vector& values) { piece.spread.emplace_back(at, values); };
  const Vector one = Vector::Ones(1);
  for (Index i = 0; i < p_.sets.num_sets(); ++i) {
    const ConstraintSet& set = p_.sets[i];
    const Index at = set.offset, size = set.size();
    const double soft = p_.compliance[at + size - 1];
    const bool settled = settled_[static_cast<std::size_t>(i)];
    const Vector normal = Vector::Unit(size, size - 1);
    if (!settled) {  // its impulses are free: only motions count
      if (!p_.kinematic[static_cast<std::size_t>(i)]) continue;
      motion_row(normal, at, size, 0.0);
      set.type == SetType::Equality ? sets.add_equality() : sets.add_half_line();
      continue;
    }
    const auto x = from.impulse.segment(at, size);
    switch (set.type) {
      case SetType::FrictionCone: {
        if (!(x[2] > 0.0)) {
          motion_row(normal, at, 3, 0.0);
          sets.add_half_line();
          break;
        }
        motion_row(normal, at, 3, soft);
        sets.add_equality();
        const double speed = sigma.segment<2>(at).norm();
        if (set.friction == 0.0) {
          free_impulse(at, normal);
          impulse_row(at + 2, 1.0, 0.0);
          sets.add_half_line();
        } else if (stick || speed <= p_.allowed) {
          for (Index k = 0; k < 2; ++k) motion_row(Vector::Unit(3, k), at, 3, 0.0), sets.add_equality();
          for (Index k = 0; k < 3; ++k) free_impulse(at, Vector::Unit(3, k));
          for (Index k = 0; k < 3; ++k) impulse_row(at + k, 1.0, 0.0);
          sets.add_friction_cone(1.0 / set.friction);  // whose dual is the cone of the impulse
        } else {
          const Vector3 along(sigma[at] / speed, sigma[at + 1] / speed, 0.0);
          motion_row(Vector3(-along[1], along[0], 0.0), at, 3, 0.0);
          sets.add_equality();
          motion_row(along, at, 3, 0.0);
          sets.add_half_line();
          free_impulse(at, Vector3(-set.friction * along[0], -set.friction * along[1], 1.0));
          impulse_row(at + 2, 1.0, 0.0);
          sets.add_half_line();
        }
        break;
      }
      case SetType::HalfLine:
        motion_row(one, at, 1, soft);
        if (x[0] > 0.0) {
          sets.add_equality();
          free_impulse(at, one);
          impulse_row(at, 1.0, 0.0);
        }
        sets.add_half_line();
        break;
      case SetType::Equality:
        motion_row(one, at, 1, soft);
        sets.add_equality();
        free_impulse(at, one);
        break;
      case SetType::Interval: {
        if (x[0] > set.lower && x[0] < set.upper) {
          motion_row(one, at, 1, soft);
          sets.add_equality();
          free_impulse(at, one);
          for (const double sign : {1.0, -1.0}) {
            const double bound = sign > 0.0 ? set.lower : set.upper;
            if (std::isinf(bound)) continue;
            impulse_row(at, sign, -sign * bound);
            sets.add_half_line();
          }
        } else {
          piece.fixed[at] = x[0];
          motion_row(x[0] <= set.lower ? one : Vector(-one), at, 1, 0.0);
          sets.add_half_line();
        }
        break;
      }
    }
  }
  return piece;
}

/// The convex problem on a piece; its dual is a contact problem with the CCP's law.
Search::Candidate Search::least_change(const Piece& piece) const {
  const Index nv = p_.mass.rows(), n = p_.sets.size();
  const auto num_unactuated = static_cast<Index>(p_.unactuated.size());
  const auto m = static_cast<Index>(piece.spread.size());
  const Index total = static_cast<Index>(piece.rows.size()) + num_unactuated;
  Matrix spread = Matrix::Zero(n, m);
  Vector start(m);  // y of the guess
  for (Index k = 0; k < m; ++k) {
    const auto& [at, values] = piece.spread[static_cast<std::size_t>(k)];
    spread.col(k).segment(at, values.size()) = values;
    start[k] = values.dot(p_.guess.segment(at, values.size())) / values.squaredNorm();
  }
  Matrix b = Matrix::Zero(total, nv + m);
  Vector g(total);
  for (std::size_t k = 0; k < piece.rows.size(); ++k) {
    const auto at = static_cast<Index>(k);
    b.row(at).head(nv) = piece.rows[k].motion.transpose();
    b.row(at).tail(m) = piece.rows[k].impulse.transpose() * spread;
    g[at] = piece.rows[k].constant + piece.rows[k].impulse.dot(piece.fixed);
  }
  // U^T M change - J_u^T impulse + missing = 0
  const Matrix j = p_.jacobian(Eigen::all, p_.unactuated);
  b.bottomLeftCorner(num_unactuated, nv) = p_.mass(p_.unactuated, Eigen::all);
  b.bottomRightCorner(num_unactuated, m) = -j.transpose() * spread;
  g.tail(num_unactuated) = p_.missing - j.transpose() * piece.fixed;
  ConstraintSets sets = piece.sets;
  sets.add_equality(num_unactuated);

  const double weight = kImpulseShare * mean_diagonal(p_.jacobian * mass_.solve(p_.jacobian.transpose()));
  Matrix back(nv + m, total);
  back.topRows(nv) = mass_.solve(b.leftCols(nv).transpose());
  back.bottomRows(m) = b.rightCols(m).transpose() / weight;
  g += b.rightCols(m) * start;
  Settings settings = p_.solver;
  settings.law = Law::Ccp;
  const Solution dual = solve(ContactProblem(std::make_shared<DenseDelassus>(b * back), g, sets), settings);
  Candidate found;
  if (dual.status != Status::Solved) return found;
  const Vector x = back * dual.impulse;
  found.change = x.head(nv);
  found.impulse = piece.fixed + spread * (start + x.tail(m));
  p_.sets.project(found.impulse, found.impulse);
  found.change(p_.unactuated) = unactuated_change(found.change, found.impulse);
  for (Index i = 0; i < p_.sets.num_sets(); ++i)
    if (!settled_[static_cast<std::size_t>(i)])
      found.impulse.segment(p_.sets[i].offset, p_.sets[i].size()) =
          p_.guess.segment(p_.sets[i].offset, p_.sets[i].size());
  found.status = obeys(found) ? Status::Solved : Status::MaxIterations;
  return found;
}

/// The law holds for what is settled, and nothing rigid is run into.
bool Search::obeys(const Candidate& candidate) const {
  const Vector c = p_.velocity + p_.jacobian * candidate.change;
  for (Index i = 0; i < p_.sets.num_sets(); ++i) {
    const ConstraintSet& set = p_.sets[i];
    const double last = c[set.offset + set.size() - 1];
    if (settled_[static_cast<std::size_t>(i)] || !p_.kinematic[static_cast<std::size_t>(i)]) continue;
    if (last < -p_.allowed || (set.type == SetType::Equality && last > p_.allowed)) return false;
  }
  InverseSolution judged;
  judged.impulse = candidate.impulse(rows_);
  judge_inverse(Vector(c + ties_ * candidate.impulse)(rows_), p_.compliance(rows_), coupled_, p_.solver.law, 1.0,
                judged);
  return judged.residual <= p_.allowed;
}

/// What a step makes of the torques that the wanted motion would take without contact: one NCP of all sets.
Search::Candidate Search::torques_as_asked() const {
  Vector lacks = Vector::Zero(p_.mass.rows());
  lacks(p_.unactuated) = -p_.missing;
  const Matrix back = mass_.solve(p_.jacobian.transpose());
  const Vector free = mass_.solve(lacks);
  Candidate found;
  found.impulse = p_.guess;
  found.status = solve_next_to(found.impulse, p_.jacobian * back + ties_, p_.velocity + p_.jacobian * free, p_.sets,
                               p_.compliance, p_.solver, p_.allowed);
  found.change = free + back * found.impulse;
  return found;
}

ClosestMotion Search::run() {
  Candidate best = joints_as_asked();
  // Where the law of contact leaves a choice of modes: those of two motions, and from there downhill.
  const bool feasible = best.status == Status::Solved && best.change.lpNorm<Eigen::Infinity>() <= p_.allowed;
  if (p_.solver.law == Law::Ncp && !rows_.empty() && !feasible)
    for (const Candidate& start : {best, torques_as_asked()}) {
      if (start.status != Status::Solved) continue;
      if (best.status != Status::Solved || energy(start) < energy(best)) best = start;
      Candidate now = start;
      for (int k = 0; k < kConvexSteps; ++k) {
        const Candidate next = least_change(piece_of(now, k == 0));
        const bool gains = next.status == Status::Solved && energy(next) < (1.0 - kLeastGain) * energy(now);
        if (gains) now = next;
        if (k > 0 && !gains) break;
      }
      if (energy(now) < energy(best)) best = now;
    }
  return {best.status, best.change, best.impulse, settled_};
}

}  // namespace

ClosestMotion closest_motion(const ClosestProblem& problem) { return Search(problem).run(); }

}  // namespace signorini
