// One step, in the order of docs/simulation.md.
#include "signorini/simulation/simulator.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>

#include "contact_report.hpp"
#include "forces.hpp"
#include "frame_motions.hpp"
#include "hash.hpp"
#include "integration.hpp"
#include "require.hpp"
#include "world_collision.hpp"

namespace signorini {
namespace {

constexpr int kLoadRounds = 50;    // of the CCP, until loads fit
constexpr int kMostMeetings = 10;  // rounds of sweeps for fast bodies; in the last one all that meets counts

// Bytes of save(): a tag, values one after the other, the hash of all that.
constexpr char kTag[] = "signorini state 5";

class Writer {
 public:
  void value(double x) { raw(&x, sizeof x); }
  void value(std::uint64_t x) { raw(&x, sizeof x); }
  void vector(const ConstVectorRef& x) {
    value(static_cast<std::uint64_t>(x.size()));
    raw(x.data(), static_cast<std::size_t>(x.size()) * sizeof(double));
  }
  void text(const std::string& x) {
    value(static_cast<std::uint64_t>(x.size()));
    raw(x.data(), x.size());
  }
  std::string bytes;

 private:
  void raw(const void* data, std::size_t size) { bytes.append(static_cast<const char*>(data), size); }
};

class Reader {
 public:
  explicit Reader(const std::string& bytes) : bytes_(bytes) {}
  double number() {
    double x;
    raw(&x, sizeof x);
    return x;
  }
  std::uint64_t count() {
    std::uint64_t x;
    raw(&x, sizeof x);
    return x;
  }
  void vector(Vector& x, Index size) {
    if (count() != static_cast<std::uint64_t>(size)) fail("was saved from another world");
    x.resize(size);
    raw(x.data(), static_cast<std::size_t>(size) * sizeof(double));
  }
  void any_vector(Vector& x) {
    const std::uint64_t size = count();
    if (size > bytes_.size() / sizeof(double)) fail("is damaged");
    x.resize(static_cast<Index>(size));
    raw(x.data(), static_cast<std::size_t>(size) * sizeof(double));
  }
  std::string text() {
    const std::uint64_t size = count();
    if (size > bytes_.size()) fail("is damaged");
    std::string x(static_cast<std::size_t>(size), '\0');
    raw(x.data(), x.size());
    return x;
  }
  /// The last value is the hash of those before.
  void check() const {
    std::uint64_t hash;
    if (bytes_.size() < sizeof hash) fail("ends too early");
    const std::size_t before = bytes_.size() - sizeof hash;
    std::memcpy(&hash, bytes_.data() + before, sizeof hash);
    if (hash != fnv1a_of_words(bytes_.data(), before)) fail("is damaged: its checksum is not what save() gave");
  }
  void end() {
    if (at_ != bytes_.size()) fail("has something after its end");
  }
  [[noreturn]] static void fail(const char* what) { throw InvalidInput("bytes", what); }

 private:
  void raw(void* data, std::size_t size) {
    if (size > bytes_.size() - at_) fail("ends too early");
    if (size == 0) return;  // data may be null
    std::memcpy(data, bytes_.data() + at_, size);
    at_ += size;
  }
  const std::string& bytes_;
  std::size_t at_ = 0;
};

}  // namespace

std::vector<TouchingPair> touching_pairs(const std::shared_ptr<const World>& world, const ConstVectorRef& q,
                                         double margin) {
  DetectorSettings settings;
  settings.margin = margin;
  Detector detector(collision_geometries(*world), collision_filter(*world), settings);
  Dynamics dynamics(world);
  dynamics.update_placements(q);
  std::vector<TouchingPair> pairs;
  for (const ContactPoint& point : detector.detect(dynamics.frames())) {
    const bool same =
        !pairs.empty() && pairs.back().geometry_a == point.geometry_a && pairs.back().geometry_b == point.geometry_b;
    if (!same) pairs.push_back({point.geometry_a, point.geometry_b, point.distance});
    pairs.back().distance = std::min(pairs.back().distance, point.distance);
  }
  return pairs;
}

void SimulatorSettings::validate() const {
  require(time_step >= 1e-6 && time_step <= 0.1, "time_step", time_step, "in [1e-6, 0.1] s");
  require(baumgarte >= 0.0 && baumgarte <= 1.0, "baumgarte", baumgarte, "in [0, 1]");
  require(max_correction_speed >= 0.0 && max_correction_speed <= 1e6, "max_correction_speed", max_correction_speed,
          "in [0, 1e6] m/s");
  require(restitution_threshold >= 0.0 && restitution_threshold <= 1e6, "restitution_threshold", restitution_threshold,
          "in [0, 1e6] m/s");
  require(contact_margin <= 1.0, "contact_margin", contact_margin, "at most 1 m, or negative for the default");
  solver.validate();
}

struct Simulator::Impl {
  Impl(std::shared_ptr<const World> w, const SimulatorSettings& s)
      : world(std::move(w)),
        settings(s),
        dynamics(world),
        forces(*world),
        detector(collision_geometries(*world), collision_filter(*world), detector_settings(s)),
        motions(*world, s.time_step, detector_settings(s).sweep_from),
        assembler(world, correction_settings(s)) {
    const Index nv = world->num_v();
    q = world->initial_q();
    for (Vector* x : {&v, &applied, &force, &free_v, &reach}) *x = Vector::Zero(nv);
    implicit = friction_guess = Vector::Zero(dynamics.num_implicit());
    lower_guess = upper_guess = Vector::Zero(static_cast<Index>(world->joints().size() + world->tendons().size()));
    control = activation = input = Vector::Zero(world->num_controls());
    wrench = Matrix::Zero(6, static_cast<Index>(world->bodies().size()));
    for (const EqualityConstraint& c : world->constraints()) {
      equality_start.push_back(num_equality_rows);
      num_equality_rows += c.type == ConstraintType::Connect ? 3 : c.type == ConstraintType::Weld ? 6 : 1;
    }
    equality_guess = Vector::Zero(num_equality_rows);
  }

  void find_motion();
  void find_contacts();
  bool find_meetings(int round);
  bool passes_limits();
  void keep_round();
  void guess_from_round();
  std::uint64_t key_of(const Assembler::Set& set) const;
  void make_guess();
  void solve_contacts(bool answers);
  void solve_selected();
  void keep_impulses();

  std::shared_ptr<const World> world;
  SimulatorSettings settings;
  Dynamics dynamics;
  Forces forces;
  Detector detector;
  FrameMotions motions;
  Assembler assembler;
  Workspace workspace;
  Solution solution;
  Guess guess;
  StepReport report;

  Vector q, v, control, activation, applied;
  Vector input;  // of actuators: their control, or their activation
  double time = 0.0;
  Matrix wrench;
  Vector force, implicit, free_v;  // implicit: what depends on the new velocity, added to M (S2)
  Vector step_q, step_v;           // at the start of the last step
  Vector reach;                    // limits that this speed comes near are in the problem
  GrowVector impulse, sigma;       // of all sets, those left out of the problem too

  // Impulses of the last step, for the next one to start from: of the contacts in world axes, three a point; of limits
  // and dry friction by velocity; of equalities by row.
  GrowVector contact_guess, moment_guess;
  Vector friction_guess, lower_guess, upper_guess, equality_guess;
  std::vector<Assembler::Set> start_sets;  // of warm_start(), for the next step
  Vector start_impulse;
  struct RoundSet {
    SetSource source;
    std::uint64_t key;
    int row;
    Index start;
  };
  std::vector<RoundSet> round_sets;  // of the last round of (S18), and its answer
  GrowVector round_impulse;
  std::vector<int> equality_start;
  int num_equality_rows = 0;
};

Simulator::Simulator(std::shared_ptr<const World> world, const SimulatorSettings& settings) {
  if (!world) throw InvalidInput("world", "is null");
  settings.validate();
  impl_ = std::make_unique<Impl>(std::move(world), settings);
}
Simulator::~Simulator() = default;
Simulator::Simulator(Simulator&&) noexcept = default;

const World& Simulator::world() const { return *impl_->world; }
std::shared_ptr<const World> Simulator::world_ptr() const { return impl_->world; }
const SimulatorSettings& Simulator::settings() const { return impl_->settings; }
Vector& Simulator::q() { return impl_->q; }
Vector& Simulator::v() { return impl_->v; }
const Vector& Simulator::v() const { return impl_->v; }
double& Simulator::time() { return impl_->time; }
Vector& Simulator::control() { return impl_->control; }
Vector& Simulator::activation() { return impl_->activation; }
Vector& Simulator::applied_force() { return impl_->applied; }
Matrix& Simulator::external_wrench() { return impl_->wrench; }
const StepReport& Simulator::report() const { return impl_->report; }
const Assembler& Simulator::assembler() const { return impl_->assembler; }
const std::vector<ContactPoint>& Simulator::points() const { return impl_->detector.points(); }
bool Simulator::stepped_from(const ConstVectorRef& q, const ConstVectorRef& v) const {
  const Impl& s = *impl_;
  return s.assembler.num_rows() > 0 && q.size() == s.step_q.size() && v.size() == s.step_v.size() && q == s.step_q &&
         v == s.step_v;
}
ConstVectorRef Simulator::impulse() const { return impl_->impulse; }
ContactProblem Simulator::contact_problem() {
  Impl& s = *impl_;
  if (s.assembler.sets().empty()) return ContactProblem();
  s.dynamics.update(s.step_q, s.step_v);  // as they were when the sets were made
  s.dynamics.factor(s.implicit);
  return s.assembler.whole_problem();
}

void Simulator::Impl::make_guess() {
  impulse.resize(assembler.num_rows());
  if (!start_sets.empty()) {
    impulse.setZero();
    const bool fits = assembler.copy_impulses(start_sets, start_impulse, impulse);
    start_sets.clear();
    if (fits) return;
  }
  const std::vector<ContactPoint>& points = detector.points();
  for (const Assembler::Set& set : assembler.sets()) {
    double& x = impulse[set.start];
    switch (set.source) {
      case SetSource::Contact: {
        const int previous = points[static_cast<std::size_t>(set.index)].previous;
        auto own = impulse.segment<3>(set.start);
        if (previous >= 0 && 3 * previous + 3 <= contact_guess.size())
          own = set.frame.transpose() * contact_guess.segment<3>(3 * previous);
        else
          own.setZero();
        break;
      }
      case SetSource::Torsion:
      case SetSource::Rolling: {
        const int previous = points[static_cast<std::size_t>(set.index)].previous;
        const bool known = previous >= 0 && 3 * previous + 3 <= moment_guess.size();
        set_moment(set, known ? Vector3(moment_guess.segment<3>(3 * previous)) : Vector3::Zero(), &x);
        break;
      }
      case SetSource::LowerLimit:
        x = lower_guess[set.index];
        break;
      case SetSource::UpperLimit:
        x = upper_guess[set.index];
        break;
      case SetSource::JointFriction:
        x = friction_guess[set.index];
        break;
      case SetSource::Equality:
        x = equality_guess[equality_start[static_cast<std::size_t>(set.index)] + set.row];
        break;
    }
  }
  assembler.set_loads(impulse);
}

void Simulator::Impl::keep_impulses() {
  contact_guess.resize(3 * static_cast<Index>(detector.points().size()));
  if (assembler.has_moments())
    moment_guess.setZero(contact_guess.size());
  else
    moment_guess.resize(0);
  lower_guess.setZero();
  upper_guess.setZero();
  for (const Assembler::Set& set : assembler.sets()) {
    const double& x = impulse[set.start];
    switch (set.source) {
      case SetSource::Contact:
        contact_guess.segment<3>(3 * set.index) = set.frame * impulse.segment<3>(set.start);
        break;
      case SetSource::Torsion:
      case SetSource::Rolling:
        moment_guess.segment<3>(3 * set.index) += moment_of(set, &x);
        break;
      case SetSource::LowerLimit:
        lower_guess[set.index] = x;
        break;
      case SetSource::UpperLimit:
        upper_guess[set.index] = x;
        break;
      case SetSource::JointFriction:
        friction_guess[set.index] = x;
        break;
      case SetSource::Equality:
        equality_guess[equality_start[static_cast<std::size_t>(set.index)] + set.row] = x;
        break;
    }
  }
}

void Simulator::warm_start(const std::vector<Assembler::Set>& sets, const ConstVectorRef& impulse) {
  const Index rows = sets.empty() ? 0 : sets.back().start + sets.back().rows;
  if (impulse.size() != rows)
    throw InvalidInput("impulse",
                       "has " + std::to_string(impulse.size()) + " values, must have " + std::to_string(rows));
  impl_->start_sets = sets;
  impl_->start_impulse = impulse;
}

/// Begins where the last round of (S18) ended: its sets are there, in the same order, with new ones in between.
void Simulator::Impl::guess_from_round() {
  std::size_t k = 0;
  for (const Assembler::Set& set : assembler.sets()) {
    if (k == round_sets.size()) return;
    const RoundSet& last = round_sets[k];
    if (last.source != set.source || last.key != key_of(set) || last.row != set.row) continue;
    impulse.segment(set.start, set.rows) = round_impulse.segment(last.start, set.rows);
    ++k;
  }
}

void Simulator::Impl::keep_round() {
  round_impulse = impulse;
  round_sets.clear();
  for (const Assembler::Set& set : assembler.sets())
    round_sets.push_back({set.source, key_of(set), set.row, static_cast<Index>(set.start)});
}

/// What tells sets of a source and a row apart, whatever is added.
std::uint64_t Simulator::Impl::key_of(const Assembler::Set& set) const {
  const bool at_point = set.source == SetSource::Contact || is_moment(set);
  return at_point ? detector.points()[static_cast<std::size_t>(set.index)].id : static_cast<std::uint64_t>(set.index);
}

/// Solves the assembler's problem, starting from `impulse`.
void Simulator::Impl::solve_selected() {
  guess.impulse.resize(assembler.problem().size());
  for (const Assembler::Set& set : assembler.sets())
    for (int r = 0; set.offset >= 0 && r < set.rows; ++r) guess.impulse[set.offset + r] = impulse[set.start + r];
  solve(assembler.problem(), settings.solver, workspace, solution, &guess);
  guess.answers = true;
  report.iterations += solution.iterations;
  report.factorizations += solution.factorizations;
  for (const Assembler::Set& set : assembler.sets()) {
    for (int r = 0; set.offset >= 0 && r < set.rows; ++r) {
      impulse[set.start + r] = solution.impulse[set.offset + r];
      sigma[set.start + r] = solution.velocity[set.offset + r];
    }
  }
}

/// Solves the problem of the sets that act, starting from `impulse`, and again with those that its answer violates.
/// answers: that is of the last round.
void Simulator::Impl::solve_contacts(bool answers) {
  guess.answers = answers;
  const Law law = settings.solver.model_law();
  sigma.resize(impulse.size());
  assembler.select(impulse, law);
  do {
    solve_selected();
    if (law != Law::Ccp) continue;
    for (int round = 0; assembler.shift_loads(sigma, impulse, settings.solver.tolerance, round == 0); ++round) {
      guess.answers = false;  // what the loads do to every island is asked here
      solve_selected();
      if (round < kLoadRounds) continue;
      if (solution.status == Status::Solved) solution.status = Status::MaxIterations;
      break;
    }
  } while (assembler.select_violated(impulse, law, sigma));
  // Some contacts may have no answer where all of them have one.
  const bool gives_up = settings.solver.solver != SolverType::Auto || settings.solver.max_iterations > 0;
  const auto num_sets = static_cast<Index>(assembler.sets().size());
  if (solution.status == Status::Solved || law == Law::Ccp || gives_up || assembler.problem().num_sets() == num_sets)
    return;
  assembler.select(impulse, law, true);
  solve_selected();
  assembler.select_violated(impulse, law, sigma);
}

/// Near ones, and those that fast bodies will meet if they go on as they do.
void Simulator::Impl::find_contacts() {
  if (motions.find(dynamics, step_v))
    detector.detect(dynamics.frames(), motions.list(), settings.time_step);
  else
    detector.detect(dynamics.frames());
}

/// Adds what the velocity just found would run into; false if there is nothing.
bool Simulator::Impl::find_meetings(int round) {
  if (!motions.find(dynamics, assembler.velocity(), true)) return false;
  if (round <= kMostMeetings) {
    keep_round();
    return detector.add_meetings(motions.list(), settings.time_step, round == kMostMeetings);
  }
  detector.hold_back(motions.list(), settings.time_step);
  return false;
}

/// Whether the velocity just found leads past limits that are not in the problem: of a joint that was slow, and is hit.
bool Simulator::Impl::passes_limits() {
  const Vector& u = assembler.velocity();
  if (!assembler.passes_limit(step_q, u)) return false;
  reach = reach.cwiseMax(u.cwiseAbs());
  keep_round();
  return true;
}

/// The velocity at the end of the step: without constraint impulses (S1, S2); then contacts, the problem, its solution;
/// again with those that a fast body meets on the way it would take now (S18).
void Simulator::Impl::find_motion() {
  if (!dynamics.factor(implicit))
    throw InvalidInput("q", "makes the mass matrix lose its definiteness (numbers too large?)");
  free_v = settings.time_step * force;
  dynamics.solve(free_v);
  free_v += step_v;
  find_contacts();
  report.iterations = report.factorizations = 0;
  reach.setZero();
  int round = 0;
  bool again = false;
  do {
    assembler.assemble(dynamics, step_q, step_v, free_v, detector.points(), &reach);
    make_guess();
    if (again) guess_from_round();
    solve_contacts(again);
    again = true;
  } while (passes_limits() || find_meetings(++round));
}

const Vector& Simulator::rehearse(const ConstVectorRef& q, const ConstVectorRef& v, const Vector& force,
                                  const Vector& implicit, const std::vector<Assembler::Set>& sets,
                                  const ConstVectorRef& impulse) {
  Impl& s = *impl_;
  reset();
  warm_start(sets, impulse);
  s.step_q = q, s.step_v = v;
  s.dynamics.update(q, v);
  s.force = force - s.dynamics.bias();
  s.implicit = implicit;
  s.find_motion();
  return s.assembler.velocity();
}

void Simulator::step() {
  Impl& s = *impl_;
  require_finite("v", s.v);
  require(std::isfinite(s.time), "time", s.time, "finite");
  require_finite("control", s.control);
  require_finite("activation", s.activation);
  require_finite("applied_force", s.applied);
  require_finite("external_wrench", Eigen::Map<const Vector>(s.wrench.data(), s.wrench.size()));
  s.world->normalize(s.q, "q");

  s.step_q = s.q, s.step_v = s.v;

  s.dynamics.update(s.q, s.v);
  s.force = s.applied - s.dynamics.bias();
  s.implicit.setZero();
  s.forces.set_input(s.control, s.activation, s.input);
  s.forces.add(s.dynamics, s.q, s.v, &s.input, &s.wrench, s.settings.time_step, s.force, s.implicit);
  s.find_motion();
  s.keep_impulses();

  // Velocity, position.
  s.free_v = s.assembler.velocity();
  require_finite("v (after the step)", s.free_v);
  s.v = s.free_v;
  advance(*s.world, s.settings.time_step, s.q, s.v, s.detector.shares());
  s.motions.keep(s.v);
  s.forces.advance_activation(s.control, s.settings.time_step, s.activation);
  s.time += s.settings.time_step;

  StepReport& r = s.report;
  r.status = s.solution.status;
  r.solver = s.solution.solver;
  r.residual = s.solution.residual;
  r.num_contacts = static_cast<Index>(points().size());
  r.deepest_overlap = 0.0;
  for (const ContactPoint& point : points())
    if (!point.swept) r.deepest_overlap = std::max(r.deepest_overlap, -point.distance);
  r.num_constraints = s.assembler.problem().num_sets();
  ++r.steps;
  if (r.status != Status::Solved) ++r.unsolved;
}

std::vector<Contact> Simulator::contacts() const {
  const Impl& s = *impl_;
  return contact_reports(s.assembler, s.detector.points(), s.impulse, s.sigma, s.settings.time_step);
}

Vector3 Simulator::contact_force(int body_a, int body_b) const {
  Vector3 total = Vector3::Zero();
  for (const Contact& contact : contacts()) {
    const int a = impl_->world->geometries()[static_cast<std::size_t>(contact.geometry_a)].body;
    const int b = impl_->world->geometries()[static_cast<std::size_t>(contact.geometry_b)].body;
    if (a == body_a && b == body_b) total += contact.frame * contact.force;
    if (a == body_b && b == body_a) total -= contact.frame * contact.force;
  }
  return total;
}

double Simulator::kinetic_energy() {
  impl_->dynamics.update(impl_->q, impl_->v);
  return impl_->dynamics.kinetic_energy(impl_->v);
}
double Simulator::potential_energy() {
  impl_->dynamics.update_placements(impl_->q);
  return impl_->dynamics.potential_energy(impl_->q);
}
Eigen::Matrix<double, 6, 1> Simulator::momentum() {
  impl_->dynamics.update(impl_->q, impl_->v);
  return impl_->dynamics.momentum(impl_->v);
}
const std::vector<Placement>& Simulator::frames() {
  impl_->dynamics.update_placements(impl_->q);
  return impl_->dynamics.frames();
}
Matrix Simulator::mass_matrix() {
  impl_->dynamics.update(impl_->q, impl_->v);
  return impl_->dynamics.mass_matrix();
}

void Simulator::reset() {
  Impl& s = *impl_;
  s.q = s.world->initial_q();
  for (Vector* x : {&s.v, &s.applied, &s.control, &s.activation, &s.friction_guess, &s.lower_guess, &s.upper_guess,
                    &s.equality_guess})
    x->setZero();
  s.wrench.setZero();
  s.time = 0.0;
  s.contact_guess.resize(0);
  s.moment_guess.resize(0);
  s.detector.reset();
  s.assembler.clear();
  s.start_sets.clear();
  s.impulse.resize(0);
  s.report = StepReport();
}

std::string Simulator::save() const {
  const Impl& s = *impl_;
  Writer out;
  out.text(kTag);
  out.value(s.settings.time_step);
  out.value(s.time);
  for (const Vector* x : {&s.q, &s.v, &s.control, &s.activation, &s.applied, &s.friction_guess, &s.lower_guess,
                          &s.upper_guess, &s.equality_guess})
    out.vector(*x);
  out.vector(s.contact_guess);
  out.vector(s.moment_guess);
  out.vector(Eigen::Map<const Vector>(s.wrench.data(), s.wrench.size()));
  out.text(s.detector.save());
  out.value(s.report.steps);
  out.value(s.report.unsolved);
  out.value(fnv1a_of_words(out.bytes.data(), out.bytes.size()));
  return out.bytes;
}

void Simulator::restore(const std::string& bytes) {
  Impl& s = *impl_;
  Reader in(bytes);
  if (in.text() != kTag) Reader::fail("is not a saved state, or of another version");
  in.check();
  if (in.number() != s.settings.time_step) Reader::fail("was saved with another time step");
  const double time = in.number();
  Vector q, v, control, activation, applied, friction, lower, upper, equality, contact, moment, wrench;
  in.vector(q, s.q.size());
  in.vector(v, s.v.size());
  in.vector(control, s.control.size());
  in.vector(activation, s.activation.size());
  in.vector(applied, s.applied.size());
  in.vector(friction, s.friction_guess.size());
  in.vector(lower, s.lower_guess.size());
  in.vector(upper, s.upper_guess.size());
  in.vector(equality, s.equality_guess.size());
  in.any_vector(contact);
  in.any_vector(moment);
  in.vector(wrench, s.wrench.size());
  const std::string detector = in.text();
  const std::uint64_t steps = in.count(), unsolved = in.count();
  in.count();  // the hash
  in.end();
  s.detector.load(detector);
  s.assembler.clear();
  s.start_sets.clear();
  s.impulse.resize(0);
  s.time = time;
  s.q = q, s.v = v, s.control = control, s.activation = activation, s.applied = applied;
  s.friction_guess = friction, s.lower_guess = lower, s.upper_guess = upper, s.equality_guess = equality;
  s.contact_guess = contact;
  s.moment_guess = moment;
  s.wrench = Eigen::Map<const Matrix>(wrench.data(), 6, s.wrench.cols());
  s.report = StepReport();
  s.report.steps = steps;
  s.report.unsolved = unsolved;
}

std::uint64_t Simulator::state_hash() const {
  std::uint64_t hash = kHashStart;
  const auto add = [&hash](const void* data, std::size_t size) { hash = fnv1a(data, size, hash); };
  add(impl_->q.data(), static_cast<std::size_t>(impl_->q.size()) * sizeof(double));
  add(impl_->v.data(), static_cast<std::size_t>(impl_->v.size()) * sizeof(double));
  add(&impl_->time, sizeof(double));
  add(impl_->activation.data(),
      impl_->forces.has_activations() ? static_cast<std::size_t>(impl_->activation.size()) * sizeof(double) : 0);
  return hash;
}

}  // namespace signorini
