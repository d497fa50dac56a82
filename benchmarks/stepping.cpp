// The solver in a stepping loop: scenes of its own, or sequences recorded by a simulator (sequence.hpp).
//     benchmark_stepping [--tolerance 1e-6] [--aim 0] [--budget 60] [--repeat 3] [--only NAME] [--record FOLDER]
//     [FOLDER]
// Times are of assign() and solve() alone, all in: the best of `repeat` solves of each step from the same guess.
#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "sequence.hpp"
#include "signorini/problem/residual.hpp"
#include "signorini/solver/solve.hpp"

using namespace signorini;
using namespace signorini::benchmarks;

namespace {

using Vector3 = Eigen::Vector3d;
using Matrix3 = Eigen::Matrix3d;

constexpr double kStep = 1e-3, kGravity = 9.81, kMargin = 2e-3, kBaumgarte = 0.1;

double correction(double distance) { return (distance >= 0.0 ? 1.0 : kBaumgarte) * distance / kStep; }

/// Where a scene's steps come from, and where their answers go.
class Scene {
 public:
  virtual ~Scene() = default;
  /// Fills the next step; false when the scene is over.
  virtual bool next(Step& step) = 0;
  virtual void take(const ConstVectorRef&) {}
};

/// Impulses of the last step by name of the contact.
class Memory {
 public:
  void start() { next_.clear(); }
  void recall(long name, Index rows, double* guess) {
    const auto known = std::lower_bound(last_.begin(), last_.end(), name,
                                        [](const Entry& entry, long value) { return entry.name < value; });
    const bool found = known != last_.end() && known->name == name;
    for (Index k = 0; k < rows; ++k) guess[k] = found ? known->impulse[k] : 0.0;
    next_.push_back({name, rows, {}});
  }
  void keep(const ConstVectorRef& impulse) {
    Index row = 0;
    for (Entry& entry : next_)
      for (Index k = 0; k < entry.rows; ++k) entry.impulse[k] = impulse[row++];
    std::sort(next_.begin(), next_.end(), [](const Entry& a, const Entry& b) { return a.name < b.name; });
    last_.swap(next_);
  }

 private:
  struct Entry {
    long name;
    Index rows;
    double impulse[3];
  };
  std::vector<Entry> last_, next_;
};

struct Body {
  double mass = 1.0;
  Matrix3 inertia = Matrix3::Identity();  // in the body's frame
  Vector3 position = Vector3::Zero(), velocity = Vector3::Zero(), spin = Vector3::Zero();
  Eigen::Quaterniond attitude = Eigen::Quaterniond::Identity();
  Matrix3 inverse_inertia = Matrix3::Identity();  // in the world's

  void move() {
    position += kStep * velocity;
    const double angle = spin.norm() * kStep;
    if (angle > 0.0) attitude = (Eigen::AngleAxisd(angle, spin.normalized()) * attitude).normalized();
    refresh();
  }
  void refresh() {
    const Matrix3 r = attitude.toRotationMatrix();
    inverse_inertia = r * inertia.inverse() * r.transpose();
  }
};

struct Contact {
  int a, b;  // bodies; a < 0: the ground
  Vector3 point;
  Matrix3 frame;  // t1, t2, n
  double distance, friction;
  long name;
};

/// Free bodies and their contacts.
class FreeBodies : public Scene {
 public:
  bool next(Step& step) override {
    if (now_++ >= steps_) return false;
    find_contacts();
    std::sort(contacts_.begin(), contacts_.end(), [](const Contact& x, const Contact& y) { return x.name < y.name; });
    for (Body& body : bodies_) body.velocity.z() -= kStep * kGravity;
    const auto count = static_cast<int>(contacts_.size());
    step.sets.clear();
    for (const Contact& c : contacts_) step.sets.add_friction_cone(c.friction);
    std::vector<std::vector<int>> touching(bodies_.size());
    for (int k = 0; k < count; ++k)
      for (const int body : {contacts_[k].a, contacts_[k].b})
        if (body >= 0) touching[body].push_back(k);
    step.blocks.clear();
    for (const auto& list : touching)
      for (std::size_t x = 0; x < list.size(); ++x)
        for (std::size_t y = 0; y < x; ++y) step.blocks.emplace_back(list[x], list[y]);
    std::sort(step.blocks.begin(), step.blocks.end());
    step.blocks.erase(std::unique(step.blocks.begin(), step.blocks.end()), step.blocks.end());
    step.delassus.reset(step.sets, step.blocks);
    for (int k = 0; k < count; ++k)
      Eigen::Map<Matrix3>(step.delassus.diagonal_block(k)) = coupling(contacts_[k], contacts_[k]);
    for (std::size_t k = 0; k < step.blocks.size(); ++k)
      Eigen::Map<Matrix3>(step.delassus.block(static_cast<Index>(k))) =
          coupling(contacts_[step.blocks[k].first], contacts_[step.blocks[k].second]);
    step.free_velocity.resize(3 * count);
    step.compliance.setZero(3 * count);
    step.guess.resize(3 * count);
    memory_.start();
    for (int k = 0; k < count; ++k) {
      const Contact& c = contacts_[k];
      Vector3 v = Vector3::Zero();
      if (c.b >= 0) v += bodies_[c.b].velocity + bodies_[c.b].spin.cross(c.point - bodies_[c.b].position);
      if (c.a >= 0) v -= bodies_[c.a].velocity + bodies_[c.a].spin.cross(c.point - bodies_[c.a].position);
      v = c.frame.transpose() * v;
      v.z() += correction(c.distance);
      step.free_velocity.segment<3>(3 * k) = v;
      memory_.recall(c.name, 3, step.guess.data() + 3 * k);
    }
    return true;
  }

  void take(const ConstVectorRef& impulse) override {
    memory_.keep(impulse);
    for (std::size_t k = 0; k < contacts_.size(); ++k) {
      const Contact& c = contacts_[k];
      const Vector3 p = c.frame * impulse.segment<3>(3 * static_cast<Index>(k));
      for (const auto& [body, sign] : {std::pair{c.a, -1.0}, std::pair{c.b, 1.0}}) {
        if (body < 0) continue;
        bodies_[body].velocity += sign * p / bodies_[body].mass;
        bodies_[body].spin += sign * (bodies_[body].inverse_inertia * (c.point - bodies_[body].position).cross(p));
      }
    }
    for (Body& body : bodies_) body.move();
    moved();
  }

 protected:
  virtual void find_contacts() = 0;
  virtual void moved() {}

  Matrix3 coupling(const Contact& x, const Contact& y) const {
    Matrix3 g = Matrix3::Zero();
    for (const auto& [bx, sx] : {std::pair{x.a, -1.0}, std::pair{x.b, 1.0}})
      for (const auto& [by, sy] : {std::pair{y.a, -1.0}, std::pair{y.b, 1.0}}) {
        if (bx < 0 || bx != by) continue;
        const Body& body = bodies_[bx];
        Matrix3 ax, ay;
        for (int k = 0; k < 3; ++k) {
          ax.col(k) = (x.point - body.position).cross(x.frame.col(k));
          ay.col(k) = (y.point - body.position).cross(y.frame.col(k));
        }
        g += sx * sy * (x.frame.transpose() * y.frame / body.mass + ax.transpose() * body.inverse_inertia * ay);
      }
    return g;
  }

  int steps_ = 0, now_ = 0;
  std::vector<Body> bodies_;
  std::vector<Contact> contacts_;
  Memory memory_;
};

/// 15 cubes on each other, masses from 1 (bottom) to `ratio` (top), kicked sideways after 100 steps if asked.
class CubeStack final : public FreeBodies {
 public:
  CubeStack(double ratio, double kick, int steps) : kick_(kick) {
    steps_ = steps;
    constexpr int kCubes = 15;
    for (int i = 0; i < kCubes; ++i) {
      Body cube;
      cube.mass = std::pow(ratio, i / (kCubes - 1.0));
      cube.inertia = cube.mass * (2.0 * kHalf) * (2.0 * kHalf) / 6.0 * Matrix3::Identity();
      cube.position.z() = (2 * i + 1) * kHalf;
      cube.refresh();
      bodies_.push_back(cube);
    }
  }

 private:
  static constexpr double kHalf = 0.1;

  void find_contacts() override {
    if (kick_ != 0.0 && now_ == 100) {
      std::mt19937 random(7);
      std::uniform_real_distribution<double> push(-kick_, kick_);
      for (Body& cube : bodies_) cube.velocity.x() += push(random), cube.velocity.y() += push(random);
    }
    contacts_.clear();
    for (int i = 0; i < static_cast<int>(bodies_.size()); ++i) {
      const Body& cube = bodies_[i];
      for (int corner = 0; corner < 4; ++corner) {
        const Vector3 local((corner & 1 ? 1 : -1) * kHalf, (corner & 2 ? 1 : -1) * kHalf, -kHalf);
        Contact c{i - 1, i, cube.position + cube.attitude * local, Matrix3::Identity(), 0.0, 0.5, 4 * i + corner};
        if (i == 0) {
          c.distance = c.point.z();
        } else {
          c.frame = bodies_[i - 1].attitude.toRotationMatrix();
          const Vector3 own = c.frame.transpose() * (c.point - bodies_[i - 1].position);
          if (std::abs(own.x()) > 1.3 * kHalf || std::abs(own.y()) > 1.3 * kHalf) continue;
          c.distance = own.z() - kHalf;
        }
        if (c.distance < kMargin) contacts_.push_back(c);
      }
    }
  }

  double kick_;
};

/// Spheres on a floor, close enough to run into each other: many small islands.
class Spheres final : public FreeBodies {
 public:
  Spheres(int side, int steps) {
    steps_ = steps;
    std::mt19937 random(3);
    std::uniform_real_distribution<double> spread(-1.0, 1.0);
    for (int i = 0; i < side * side; ++i) {
      Body ball;
      ball.mass = 1.0;
      ball.inertia = 0.4 * kRadius * kRadius * Matrix3::Identity();
      ball.position = Vector3(2.3 * kRadius * (i % side), 2.3 * kRadius * (i / side), kRadius);
      ball.velocity = 0.2 * Vector3(spread(random), spread(random), 0.0);
      ball.refresh();
      bodies_.push_back(ball);
    }
  }

 private:
  static constexpr double kRadius = 0.05;

  void find_contacts() override {
    contacts_.clear();
    const auto count = static_cast<long>(bodies_.size());
    std::map<std::pair<int, int>, std::vector<int>> cells;
    for (int i = 0; i < count; ++i) {
      const Vector3& p = bodies_[i].position;
      if (p.z() - kRadius < kMargin)
        contacts_.push_back({-1, i, Vector3(p.x(), p.y(), 0.0), Matrix3::Identity(), p.z() - kRadius, 0.5, i});
      const int cx = static_cast<int>(std::floor(p.x() / (3 * kRadius)));
      const int cy = static_cast<int>(std::floor(p.y() / (3 * kRadius)));
      for (int x = cx - 1; x <= cx + 1; ++x)
        for (int y = cy - 1; y <= cy + 1; ++y) {
          const auto cell = cells.find({x, y});
          if (cell == cells.end()) continue;
          for (const int j : cell->second) {
            const Vector3 d = p - bodies_[j].position;
            const double distance = d.norm() - 2 * kRadius;
            if (distance >= kMargin) continue;
            Contact c{j, i, 0.5 * (p + bodies_[j].position), Matrix3(), distance, 0.5, count * (i + 1) + j};
            const Vector3 n = d.normalized();
            c.frame.col(2) = n;
            c.frame.col(0) = n.unitOrthogonal();
            c.frame.col(1) = n.cross(c.frame.col(0));
            contacts_.push_back(c);
          }
        }
      cells[{cx, cy}].push_back(i);
    }
  }
};

/// One articulated tree, by its equations alone: bodies whose Jacobians have the support of a tree and turn slowly;
/// feet and hands above a floor; joint limits; now and then a kick.
class Humanoid final : public Scene {
 public:
  Humanoid(int limbs, int joints_a_limb, int contacts_a_limb, int steps, unsigned seed, double dry_friction)
      : steps_(steps), dry_friction_(dry_friction), random_(seed) {
    const auto axis = [&] {
      Eigen::Matrix<double, 6, 1> s;
      for (int k = 0; k < 6; ++k) s[k] = uniform(-1.0, 1.0) * (k < 3 ? 0.3 : 1.0);
      return s;
    };
    for (int limb = 0; limb < limbs; ++limb) {
      std::vector<int> path;
      for (int j = 0; j < joints_a_limb; ++j) {
        joints_.push_back({axis(), axis(), uniform(0.5, 2.0)});
        path.push_back(static_cast<int>(joints_.size()) - 1);
        links_.push_back({path, uniform(1.0, 4.0)});
      }
      for (int c = 0; c < contacts_a_limb; ++c) {
        const Vector3 arm(uniform(-0.1, 0.1), uniform(-0.1, 0.1), uniform(-0.1, 0.1));
        points_.push_back({static_cast<int>(links_.size()) - 1 - c % 2, arm, uniform(0.02, 0.2)});
      }
    }
    links_.push_back({{}, 10.0});
    nv_ = 6 + static_cast<Index>(joints_.size());
    q_.setZero(nv_), v_.setZero(nv_);
  }

  bool next(Step& step) override {
    if (now_ >= steps_) return false;
    const double time = kStep * now_++;
    if (now_ % 400 == 0)
      for (Index k = 0; k < nv_; ++k) v_[k] += uniform(-1.0, 1.0) * (k < 3 ? 0.5 : 1.0);
    std::vector<Matrix> jacobians;  // 6 x nv, linear first
    mass_ = 0.02 * Matrix::Identity(nv_, nv_);
    Vector force = -2.0 * v_.tail(nv_).cwiseProduct(Vector::Constant(nv_, 0.05));
    for (const Link& link : links_) {
      Matrix j = Matrix::Zero(6, nv_);
      j.leftCols(6).setIdentity();
      for (const int k : link.path) {
        const Joint& joint = joints_[static_cast<std::size_t>(k)];
        j.col(6 + k) = std::cos(joint.rate * time) * joint.s + std::sin(joint.rate * time) * joint.c;
      }
      mass_ +=
          link.mass * (j.topRows(3).transpose() * j.topRows(3) + 0.01 * j.bottomRows(3).transpose() * j.bottomRows(3));
      force -= link.mass * kGravity * j.row(2).transpose();
      jacobians.push_back(j);
    }
    const Eigen::LLT<Matrix> factor(mass_);
    free_ = v_ + kStep * factor.solve(force);

    step.sets.clear();
    memory_.start();
    std::vector<Eigen::RowVectorXd> rows;
    std::vector<double> corrections, guess;
    active_.clear();
    const auto remember = [&](long name, Index count) {
      double known[3];
      memory_.recall(name, count, known);
      guess.insert(guess.end(), known, known + count);
    };
    for (std::size_t p = 0; p < points_.size(); ++p) {
      const Point& point = points_[p];
      Matrix j = jacobians[static_cast<std::size_t>(point.link)].topRows(3);
      for (Index k = 0; k < nv_; ++k)
        j.col(k) += Vector3(jacobians[static_cast<std::size_t>(point.link)].col(k).tail<3>()).cross(point.arm);
      heights_.push_back(j.row(2));
      if (point.height >= 5.0 * kMargin) continue;
      step.sets.add_friction_cone(0.8);
      for (int k = 0; k < 3; ++k)
        rows.push_back(j.row(k)), corrections.push_back(k < 2 ? 0.0 : correction(point.height));
      remember(static_cast<long>(p), 3);
    }
    for (Index k = 6; k < nv_; ++k)
      for (const double side : {-1.0, 1.0}) {
        const double distance = kLimit - side * q_[k];
        if (distance >= 0.02) continue;
        step.sets.add_half_line();
        rows.push_back(-side * Eigen::RowVectorXd::Unit(nv_, k)), corrections.push_back(correction(distance));
        remember(1000 + 2 * k + (side > 0.0), 1);
      }
    if (dry_friction_ > 0.0)
      for (Index k = 6; k < nv_; ++k) {
        step.sets.add_interval(-kStep * dry_friction_, kStep * dry_friction_);
        rows.push_back(Eigen::RowVectorXd::Unit(nv_, k)), corrections.push_back(0.0);
        remember(2000 + k, 1);
      }
    const auto n = static_cast<Index>(rows.size());
    jacobian_.resize(n, nv_);
    for (Index r = 0; r < n; ++r) jacobian_.row(r) = rows[static_cast<std::size_t>(r)];
    response_ = factor.solve(jacobian_.transpose());
    const Matrix g = jacobian_ * response_;
    const Vector correction_vector = Eigen::Map<const Vector>(corrections.data(), n);
    step.free_velocity = jacobian_ * free_ + correction_vector;
    step.compliance.setZero(n);
    step.guess.resize(n);
    for (Index r = 0; r < n; ++r) step.guess[r] = guess[static_cast<std::size_t>(r)];
    step.blocks.clear();
    for (int i = 0; i < static_cast<int>(step.sets.num_sets()); ++i)
      for (int j = 0; j < i; ++j) step.blocks.emplace_back(i, j);
    step.delassus.reset(step.sets, step.blocks);
    const auto fill = [&](int i, int j, double* to) {
      const ConstraintSet &a = step.sets[i], &b = step.sets[j];
      Eigen::Map<Matrix>(to, a.size(), b.size()) = g.block(a.offset, b.offset, a.size(), b.size());
    };
    for (int i = 0; i < static_cast<int>(step.sets.num_sets()); ++i) fill(i, i, step.delassus.diagonal_block(i));
    for (std::size_t k = 0; k < step.blocks.size(); ++k)
      fill(step.blocks[k].first, step.blocks[k].second, step.delassus.block(static_cast<Index>(k)));
    return true;
  }

  void take(const ConstVectorRef& impulse) override {
    memory_.keep(impulse);
    v_ = free_ + response_ * impulse;
    q_ += kStep * v_;
    for (std::size_t p = 0; p < points_.size(); ++p) points_[p].height += kStep * heights_[p].dot(v_);
    heights_.clear();
  }

 private:
  static constexpr double kLimit = 0.4;
  struct Joint {
    Eigen::Matrix<double, 6, 1> s, c;
    double rate;
  };
  struct Link {
    std::vector<int> path;
    double mass;
  };
  struct Point {
    int link;
    Vector3 arm;
    double height;
  };

  double uniform(double lower, double upper) { return std::uniform_real_distribution<double>(lower, upper)(random_); }

  int steps_, now_ = 0;
  double dry_friction_;
  std::mt19937 random_;
  Index nv_ = 0;
  std::vector<Joint> joints_;
  std::vector<Link> links_;
  std::vector<Point> points_;
  std::vector<Eigen::RowVectorXd> heights_;
  std::vector<int> active_;
  Vector q_, v_, free_;
  Matrix mass_, jacobian_, response_;
  Memory memory_;
};

/// A recorded sequence: guesses are the simulator's.
class Recorded final : public Scene {
 public:
  explicit Recorded(const std::string& path) : reader_(path) {}
  bool next(Step& step) override { return reader_.read(step); }

 private:
  SequenceReader reader_;
};

struct Options {
  Settings settings;
  int repeat = 3;
  std::string only, record, folder;
};

double percentile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const auto k = static_cast<std::size_t>(share * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(k), values.end());
  return values[k];
}

void run(const std::string& name, Scene& scene, const Options& options) {
  if (!options.only.empty() && name.find(options.only) == std::string::npos) return;
  auto step = std::make_shared<Step>();
  const std::shared_ptr<const DelassusOperator> delassus(step, &step->delassus);
  std::unique_ptr<SequenceWriter> writer;
  if (!options.record.empty()) writer = std::make_unique<SequenceWriter>(options.record + "/" + name + ".steps");
  ContactProblem problem;
  Workspace workspace;
  Solution solution;
  Guess guess;
  std::vector<double> micros, factorizations, certificates, rows;
  int unsolved = 0, guesses = 0;
  while (scene.next(*step)) {
    if (writer) writer->write(step->sets, step->delassus, step->free_velocity, step->compliance, step->guess);
    guess.impulse = step->guess;
    double best = 1e300;
    for (int repeat = 0; repeat < options.repeat; ++repeat) {
      const auto start = std::chrono::steady_clock::now();
      problem.assign(delassus, step->free_velocity, step->sets, step->compliance);
      solve(problem, options.settings, workspace, solution, &guess);
      best =
          std::min(best, std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - start).count());
    }
    scene.take(solution.impulse);
    if (problem.size() == 0) continue;
    micros.push_back(best);
    rows.push_back(static_cast<double>(problem.size()));
    factorizations.push_back(solution.factorizations);
    certificates.push_back(std::isnan(solution.residual.relative) ? 1e300 : solution.residual.relative);
    unsolved += solution.status != Status::Solved;
    guesses += solution.factorizations == 0;
  }
  double mean = 0.0, factors = 0.0;
  for (std::size_t k = 0; k < micros.size(); ++k) mean += micros[k], factors += factorizations[k];
  const auto count = static_cast<double>(std::max<std::size_t>(micros.size(), 1));
  std::printf("%-22s %6zu %5.0f | %8.2f %8.2f %8.2f %9.2f %9.2f | %6.2f %4.0f %5.1f%% | %5d | %8.1e %8.1e %8.1e\n",
              name.c_str(), micros.size(), percentile(rows, 0.5), mean / count, percentile(micros, 0.5),
              percentile(micros, 0.99), percentile(micros, 0.999), percentile(micros, 1.0), factors / count,
              percentile(factorizations, 1.0), 100.0 * guesses / count, unsolved, percentile(certificates, 0.5),
              percentile(certificates, 0.99), percentile(certificates, 1.0));
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  options.settings.max_iterations = 60;
  for (int k = 1; k < argc; ++k) {
    const std::string flag = argv[k];
    const auto value = [&] {
      if (++k >= argc) std::fprintf(stderr, "%s needs a value\n", flag.c_str()), std::exit(2);
      return std::string(argv[k]);
    };
    if (flag == "--tolerance")
      options.settings.tolerance = std::atof(value().c_str());
    else if (flag == "--aim")
      options.settings.aim = std::atof(value().c_str());
    else if (flag == "--budget")
      options.settings.max_iterations = std::atoi(value().c_str());
    else if (flag == "--repeat")
      options.repeat = std::atoi(value().c_str());
    else if (flag == "--only")
      options.only = value();
    else if (flag == "--record")
      options.record = value();
    else
      options.folder = flag;
  }
  std::printf("%-22s %6s %5s | %8s %8s %8s %9s %9s | %6s %4s %6s | %5s | %8s %8s %8s\n", "scene", "steps", "rows",
              "mean us", "p50", "p99", "p99.9", "max", "factor", "max", "guess", "fail", "cert p50", "p99", "max");
  if (!options.folder.empty()) {
    std::vector<std::filesystem::path> files;
    for (const auto& entry : std::filesystem::directory_iterator(options.folder))
      if (entry.path().extension() == ".steps") files.push_back(entry.path());
    std::sort(files.begin(), files.end());
    for (const auto& file : files) {
      Recorded scene(file.string());
      run(file.stem().string(), scene, options);
    }
    return 0;
  }
  for (const auto& [name, ratio] :
       {std::pair{"stack_1", 1.0}, std::pair{"stack_100", 1e2}, std::pair{"stack_1e4", 1e4}}) {
    CubeStack rest(ratio, 0.0, 2000), kicked(ratio, 1.0, 1500);
    run(name, rest, options);
    run(std::string(name) + "_kicked", kicked, options);
  }
  for (unsigned seed = 1; seed <= 3; ++seed) {
    Humanoid humanoid(4, 5, 2, 4000, seed, 0.0);
    run("humanoid_" + std::to_string(seed), humanoid, options);
  }
  Humanoid talos(4, 7, 3, 4000, 11, 0.0), dry(4, 5, 2, 4000, 12, 0.5);
  run("talos", talos, options);
  run("humanoid_dry", dry, options);
  Spheres spheres(32, 300), more(64, 100);
  run("spheres_1024", spheres, options);
  run("spheres_4096", more, options);
}
