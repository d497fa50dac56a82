#include "signorini/simulation/inverse_dynamics.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "closest_motion.hpp"
#include "contact_report.hpp"
#include "forces.hpp"
#include "frame_motions.hpp"
#include "integration.hpp"
#include "require.hpp"
#include "world_collision.hpp"

namespace signorini {
namespace {

constexpr double kSlowest = 1e-6;     // [m/s] speeds are never judged against less: rounding is no motion
constexpr int kRounds = 8;            // until bounces and limits are consistent
constexpr double kReturns = 1e-11;    // of the fastest: the step leads to the wanted motion
constexpr double kRehearsed = 1e-12;  // tolerance of that step
constexpr double kReaches = 1e-6;     // [m] the wanted motion of a fast body that ends so near to a surface meets it

}  // namespace

struct InverseDynamics::Impl {
  Impl(std::shared_ptr<const World> w, const SimulatorSettings& s, const InverseSettings& i)
      : world(std::move(w)),
        settings(s),
        inverse(i),
        dynamics(world),
        forces(*world),
        detector(collision_geometries(*world), collision_filter(*world), detector_settings(s)),
        motions(*world, s.time_step, detector_settings(s).sweep_from),
        assembler(world, correction_settings(s)),
        wrenches(static_cast<std::size_t>(world->num_frames())) {
    const Index nv = world->num_v();
    for (Vector* x : {&u, &acceleration, &other, &joint_force, &result.force, &result.v_next}) *x = Vector::Zero(nv);
    implicit = Vector::Zero(dynamics.num_implicit());
    drive = Vector::Zero(world->num_controls());
    default_actuated = InverseDynamics::actuated(*world);
  }

  const InverseDynamicsResult& solve(const Input& input);
  void forget();
  void find_near();
  void find_contacts(const Input& input);
  void set_contacts(const std::vector<ContactPoint>& found, const Input& input);
  void take_over(Vector& given) const;
  void check(const Input& input) const;
  void start(const Input& input, const Vector* reach);
  void restart(const Input& input);
  void set_guess(const Input& input);
  void set_speed();
  void find_impulses();
  void find_each();
  void add_up(bool with_impulses);
  void find_bounces();
  void find_impulses_and_bounces(const Input& input);
  bool undoes_step(const Input& input) const;
  void find_force(const Input& input);
  void find_force_of_step(const Input& input);
  bool change_inconsistent_bounces(const Input& input);
  void find_closest(const Input& input);
  bool misses_limit() const;
  Status move_to_closest(const Input& input);
  Status move_or_say_why(const Input& input);

  std::shared_ptr<const World> world;
  SimulatorSettings settings;
  InverseSettings inverse;
  Dynamics dynamics;
  Forces forces;
  Detector detector;
  FrameMotions motions;
  std::vector<ContactPoint> points;
  Assembler assembler;
  std::vector<Wrench> wrenches;  // of the constraints, by frame

  Vector q, u;                         // u: the velocity wanted, in the frames of the step
  Vector detected_at;                  // where `points` were found, as given; empty: they were given too
  std::vector<ContactPoint> near;      // at that configuration, while the points of a motion are others
  bool swept = false;                  // `points` are also of how the last motion went
  bool meets = false;                  // some of them are met by the wanted motion alone
  std::unique_ptr<Simulator> step;     // rehearses the step
  Vector given_impulse, given_moment;  // of `points`, or none
  Vector acceleration, other, implicit, joint_force;
  Vector drive;                  // what the actuators are driven by
  GrowVector compliance, guess;  // of all rows
  double speed = 0.0;
  InverseSolution solution;
  InverseDynamicsResult result;
  std::vector<std::uint8_t> settled;  // sets whose impulse is in guess, by set; empty: none
  std::vector<std::uint8_t> default_actuated;
};

InverseDynamics::InverseDynamics(std::shared_ptr<const World> world, const SimulatorSettings& settings,
                                 const InverseSettings& inverse) {
  if (!world) throw InvalidInput("world", "is null");
  settings.validate();
  inverse.validate();
  if (!solves_the_law(settings.solver.solver)) {
    throw InvalidInput("solver", std::string("is ") + name(settings.solver.solver) +
                                     ", must be one that solves the law: the closest motion obeys it");
  }
  impl_ = std::make_unique<Impl>(std::move(world), settings, inverse);
}
InverseDynamics::~InverseDynamics() = default;
InverseDynamics::InverseDynamics(InverseDynamics&&) noexcept = default;

const World& InverseDynamics::world() const { return *impl_->world; }
const std::vector<ContactPoint>& InverseDynamics::points() const { return impl_->points; }

std::vector<std::uint8_t> InverseDynamics::actuated(const World& world) {
  std::vector<std::uint8_t> has(static_cast<std::size_t>(world.num_v()), world.actuators().empty() ? 1 : 0);
  const auto at = [&](int joint) {
    return static_cast<std::size_t>(world.joints()[static_cast<std::size_t>(joint)].v_index);
  };
  for (const Actuator& a : world.actuators()) {
    if (a.joint >= 0) has[at(a.joint) + static_cast<std::size_t>(a.component)] = 1;
    if (a.tendon < 0) continue;
    for (const Tendon::Term& term : world.tendons()[static_cast<std::size_t>(a.tendon)].terms) has[at(term.joint)] = 1;
  }
  if (world.actuators().empty())
    for (const Joint& joint : world.joints())
      if (joint.type == JointType::Free) std::fill_n(has.begin() + joint.v_index, 6, std::uint8_t{0});
  return has;
}

void InverseDynamics::set_configuration(const ConstVectorRef& q, const std::vector<ContactPoint>& points) {
  Impl& s = *impl_;
  require_size("q", q.size(), s.world->num_q());
  require_finite("q", q);
  const auto num_geometries = static_cast<int>(s.world->geometries().size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const ContactPoint& point = points[i];
    const bool known = std::min(point.geometry_a, point.geometry_b) >= 0 &&
                       std::max(point.geometry_a, point.geometry_b) < num_geometries;
    const bool finite = point.position.allFinite() && point.normal.allFinite() && std::isfinite(point.distance);
    if (known && finite && point.patch_size >= 1) continue;
    throw InvalidInput("points[" + std::to_string(i) + "]", !known   ? "is of a geometry that the world does not have"
                                                            : finite ? "has a patch_size below 1"
                                                                     : "is not finite");
  }
  s.detected_at.resize(0);
  s.swept = false;
  s.q = q;
  s.world->normalize(s.q, "q");
  s.dynamics.update_placements(s.q);
  s.points = points;
  s.forget();  // contacts() and worst() are of these points
}

void InverseDynamics::set_configuration(const ConstVectorRef& q) {
  Impl& s = *impl_;
  if (!s.swept && s.detected_at.size() > 0 && s.detected_at.size() == q.size() && s.detected_at == q) {
    s.forget();
    return;
  }
  set_configuration(q, {});
  s.find_near();
  s.detected_at = q;
}

void InverseDynamics::Impl::find_near() {
  detector.reset();  // what it found before must not show
  points = detector.detect(dynamics.frames());
  swept = false;
}

/// Contacts of a motion with fast bodies, as a step has them: what they meet as they go now, and as they shall go.
void InverseDynamics::Impl::find_contacts(const Input& input) {
  given_impulse = input.impulse_guess, given_moment = input.moment_guess;
  meets = false;
  if (detected_at.size() == 0) return;
  const double dt = settings.time_step;
  // A step that is inverted knows what it met on ways that it did not go in the end.
  if (input.simulator && input.simulator->settings().time_step == dt && input.simulator->stepped_from(q, input.v)) {
    points = input.simulator->points();
    swept = true;
    return;
  }
  const bool now = motions.find(dynamics, input.v);
  if (!now && !motions.find(dynamics, u)) return;
  near = points;
  detector.reset();
  if (now)
    detector.detect(dynamics.frames(), motions.list(), dt);
  else
    detector.detect(dynamics.frames());
  meets = motions.find(dynamics, u) && detector.add_meetings(motions.list(), dt, true, kReaches);
  swept = now || meets;
  set_contacts(detector.points(), input);
}

/// Contacts of the motion, with what is given for those near the configuration.
void InverseDynamics::Impl::set_contacts(const std::vector<ContactPoint>& found, const Input& input) {
  points = found;
  given_impulse = input.impulse_guess, given_moment = input.moment_guess;
  take_over(given_impulse);
  take_over(given_moment);
}

/// What is given for each of the contacts near the configuration, for those of the motion; 0 for what it meets later.
void InverseDynamics::Impl::take_over(Vector& given) const {
  if (given.size() == 0) return;
  Vector own = Vector::Zero(3 * static_cast<Index>(points.size()));
  for (std::size_t i = 0; i < points.size(); ++i)
    for (std::size_t k = 0; k < near.size(); ++k)
      if (near[k].geometry_a == points[i].geometry_a && near[k].geometry_b == points[i].geometry_b &&
          near[k].position == points[i].position)
        own.segment<3>(3 * static_cast<Index>(i)) = given.segment<3>(3 * static_cast<Index>(k));
  given = own;
}

void InverseDynamics::Impl::check(const Input& input) const {
  const Index nv = world->num_v();
  if (q.size() == 0 && world->num_q() > 0) throw InvalidInput("q", "has not been set");
  require_size("v", input.v.size(), nv);
  require_size("v_next", input.v_next.size(), nv);
  require_size("control", input.control.size(), world->num_controls(), true);
  const auto bodies = static_cast<Index>(world->bodies().size());
  require_size("external_wrench", input.external_wrench.size(), 6 * bodies, true);
  if (input.external_wrench.size() > 0) require_size("external_wrench: a column", input.external_wrench.rows(), 6);
  if (input.simulator && input.simulator->world_ptr() != world)
    throw InvalidInput("impulse_guess", "is a simulator of another world");
  require_size("impulse_guess", input.impulse_guess.size(), 3 * static_cast<Index>(points.size()), true);
  require_size("moment_guess", input.moment_guess.size(), 3 * static_cast<Index>(points.size()), true);
  require_size("actuated", static_cast<Index>(input.actuated.size()), nv, true);
  require_finite("v", input.v);
  require_finite("v_next", input.v_next);
  require_finite("control", input.control);
  require_finite("external_wrench",
                 Eigen::Map<const Vector>(input.external_wrench.data(), input.external_wrench.size()));
  require_finite("impulse_guess", input.impulse_guess);
  require_finite("moment_guess", input.moment_guess);
}

/// The constraints as the motion u meets them; with the limits that joints of the speeds `reach` come near, or null.
void InverseDynamics::Impl::start(const Input& input, const Vector* reach) {
  assembler.assemble(dynamics, q, input.v, u, points, reach);
  const Index rows = assembler.num_rows();
  compliance.setZero(rows);
  for (const Assembler::Set& set : assembler.sets()) compliance[set.start + set.rows - 1] = set.compliance;
  set_guess(input);
  set_speed();
}

void InverseDynamics::Impl::set_guess(const Input& input) {
  guess.setZero(assembler.num_rows());  // contacts come first
  guess.head(given_impulse.size()) = given_impulse;
  if (given_moment.size() > 0)
    for (const Assembler::Set& set : assembler.sets())
      if (is_moment(set)) set_moment(set, set.frame * given_moment.segment<3>(3 * set.index), guess.data() + set.start);
  if (input.simulator &&
      !assembler.copy_impulses(input.simulator->assembler().sets(), input.simulator->impulse(), guess))
    throw InvalidInput("impulse_guess", "is a simulator whose last step had other contacts than this configuration");
  assembler.set_loads(guess);
  // The same forces, for another time.
  if (input.simulator) guess *= settings.time_step / input.simulator->settings().time_step;
}

/// What velocities are judged against: the fastest constraint, or a fall of one step.
void InverseDynamics::Impl::set_speed() {
  speed = std::max(kSlowest, settings.time_step * world->gravity().norm());
  for (const Assembler::Set& set : assembler.sets()) {
    double square = 0.0;
    for (int r = 0; r < set.rows; ++r) {
      const double moves = assembler.free_velocity()[set.start + r] - (r == set.rows - 1 ? set.correction : 0.0);
      square += moves * moves;
    }
    speed = std::max(speed, std::sqrt(square));
  }
}

/// Contacts by themselves, then moments: of what does not turn those of the guess, as far as the normal impulses allow
/// (S16).
void InverseDynamics::Impl::find_impulses() {
  if (inverse.law == Law::Ccp) assembler.set_load_speeds();
  find_each();
  if (!assembler.has_moments()) return;
  for (std::size_t i = 0; i < assembler.sets().size(); ++i) {
    const Assembler::Set& set = assembler.sets()[i];
    if (!is_moment(set) || (!settled.empty() && settled[i])) continue;
    const auto turns = assembler.free_velocity().segment<2>(set.start);
    const double load =
        set.load_factor * solution.impulse[assembler.sets()[static_cast<std::size_t>(set.index)].start + 2];
    const double fast = turns.norm(), held = guess.segment<2>(set.start).norm();
    auto own = solution.impulse.segment<3>(set.start);
    own = guess.segment<3>(set.start);
    if (fast > inverse.tolerance * speed)
      own.head<2>() = -load / fast * turns;
    else if (held > load)
      own.head<2>() *= load / held;
    own[2] = load;
  }
  judge_inverse(assembler.free_velocity(), compliance, assembler.constraint_sets(), inverse.law, speed, solution);
}

/// Each set by itself.
void InverseDynamics::Impl::find_each() {
  const ConstraintSets& sets = assembler.constraint_sets();
  const GrowVector& c = assembler.free_velocity();
  if (settled.empty()) {
    const ConstVectorRef from(guess);
    solve_inverse(c, compliance, sets, inverse, solution, &from, speed);
    return;
  }
  ConstraintSets others;  // all but those that the closest motion came with
  std::vector<Index> rows;
  for (Index i = 0; i < sets.num_sets(); ++i) {
    if (settled[static_cast<std::size_t>(i)]) continue;
    others.add(sets[i]);
    for (Index r = 0; r < sets[i].size(); ++r) rows.push_back(sets[i].offset + r);
  }
  const Vector start = guess(rows);
  const ConstVectorRef from(start);
  solve_inverse(c(rows), compliance(rows), others, inverse, solution, &from, speed);
  guess(rows) = Vector(solution.impulse);
  solution.impulse = guess;
  judge_inverse(c, compliance, sets, inverse.law, speed, solution);
}

/// result.force = M^ dv/dt + bias - J^T impulse / dt - everything else (S11).
void InverseDynamics::Impl::add_up(bool with_impulses) {
  std::fill(wrenches.begin(), wrenches.end(), Wrench());
  joint_force.setZero();
  if (with_impulses) assembler.add_forces(solution.impulse, 1.0 / settings.time_step, wrenches, joint_force);
  dynamics.inverse(acceleration, wrenches, result.force);
  dynamics.add_implicit(implicit, acceleration, result.force);
  result.force -= joint_force + other;
}

const InverseDynamicsResult& InverseDynamics::solve(const Input& input) {
  try {
    return impl_->solve(input);
  } catch (...) {
    impl_->forget();  // sets without impulses must not be looked at
    throw;
  }
}

void InverseDynamics::Impl::forget() {
  assembler.clear();
  solution.impulse.resize(0);
  solution.residual = 0.0;
}

const InverseDynamicsResult& InverseDynamics::Impl::solve(const Input& input) {
  if (swept) find_near();
  check(input);
  const double dt = settings.time_step;
  u = input.v_next;
  if (!turn_back(*world, dt, u))
    throw InvalidInput("v_next", "turns a free body too far in one step (about 20 rad, of a thin one less)");
  dynamics.update_velocities(input.v);
  find_contacts(input);
  other.setZero();
  implicit.setZero();
  if (input.control.size() > 0) forces.set_input(input.control, input.control, drive);
  forces.add(dynamics, q, input.v, input.control.size() > 0 ? &drive : nullptr,
             input.external_wrench.size() > 0 ? &input.external_wrench : nullptr, dt, other, implicit);
  result.v_next = input.v_next;
  settled.clear();
  inverse.keep = undoes_step(input);
  start(input, nullptr);
  if (input.closest)
    find_closest(input);
  else
    find_impulses_and_bounces(input);
  find_force(input);
  if (meets && !input.closest && solution.status == Status::Solved) find_force_of_step(input);
  result.status = solution.status;
  result.residual = solution.residual;
  result.relative = solution.relative;
  result.iterations = solution.iterations;
  result.contact_impulse = solution.impulse.head(3 * static_cast<Index>(points.size()));
  return result;
}

void InverseDynamics::Impl::find_force(const Input& input) {
  acceleration = (u - input.v) / settings.time_step;
  add_up(true);
}

/// What u meets the step may have met elsewhere, on its way to u (S18): rehearses it with the force found so far, and
/// takes its contacts, until it leads to u; or as near as that gets.
void InverseDynamics::Impl::find_force_of_step(const Input& input) {
  if (!step) {
    SimulatorSettings s = settings;
    s.solver.law = inverse.law;
    s.solver.tolerance = std::min(s.solver.tolerance, kRehearsed);
    s.solver.aim = std::min(s.solver.aim, s.solver.tolerance);
    step = std::make_unique<Simulator>(world, s);
  }
  const auto take = [&](const std::vector<ContactPoint>& found) {
    set_contacts(found, input);
    start(input, nullptr);
    find_impulses_and_bounces(input);
    find_force(input);
  };
  const double fastest = std::max(
      {u.lpNorm<Eigen::Infinity>(), input.v.lpNorm<Eigen::Infinity>(), settings.time_step * world->gravity().norm()});
  std::vector<ContactPoint> best;
  double least = kInfinity;
  for (int round = 0; round < kRounds; ++round) {
    const Vector& reached =
        step->rehearse(q, input.v, result.force + other, implicit, assembler.sets(), solution.impulse);
    const double off = (reached - u).lpNorm<Eigen::Infinity>();
    if (!(off < least)) break;
    least = off;
    if (off <= kReturns * fastest) return;
    best = points;
    take(step->points());
  }
  if (least < kInfinity) take(best);
}

/// Whether this is the very step that the given simulator made, certified to the tolerance asked for.
bool InverseDynamics::Impl::undoes_step(const Input& input) const {
  const Simulator* s = input.simulator;
  return s && !input.closest && detected_at.size() > 0 && s->settings().time_step == settings.time_step &&
         s->settings().baumgarte == settings.baumgarte &&
         s->settings().max_correction_speed == settings.max_correction_speed &&
         s->settings().restitution_threshold == settings.restitution_threshold &&
         s->settings().solver.law == inverse.law && s->stepped_from(q, input.v) && s->v() == input.v_next &&
         s->report().residual.solves(inverse.tolerance);
}

void InverseDynamics::Impl::find_impulses_and_bounces(const Input& input) {
  if (inverse.keep) {
    // Its impulses are the answer. Their certificate counts in impulses, and may allow a little more than `relative`.
    for (const Assembler::Set& theirs : input.simulator->assembler().sets()) {
      if (theirs.bounce == 0.0) continue;
      for (std::size_t i = 0; i < assembler.sets().size(); ++i)
        if (assembler.sets()[i].source == theirs.source && assembler.sets()[i].index == theirs.index)
          assembler.set_bounce(i, theirs.bounces);
    }
    find_impulses();
    if (solution.status != Status::Invalid) solution.status = Status::Solved;
    return;
  }
  find_bounces();
  for (int round = 0; round < kRounds; ++round) {
    find_impulses();
    if (!change_inconsistent_bounces(input)) return;
  }
  solution.status = Status::MaxIterations;
}

/// Whether a contact that approaches fast bounces depends on the velocity without contact, which follows from the
/// answer (S12): start with what comes closest to the guess.
void InverseDynamics::Impl::find_bounces() {
  for (std::size_t i = 0; i < assembler.sets().size(); ++i) {
    const Assembler::Set& set = assembler.sets()[i];
    if (set.bounce == 0.0) continue;
    const double wanted = guess[set.start + 2];
    double away[2];
    for (const bool bounces : {false, true}) {
      assembler.set_bounce(i, bounces);
      const auto own = assembler.free_velocity().segment<3>(set.start);
      const double sliding = inverse.law == Law::Ccp ? set.material.friction * own.head<2>().norm() : 0.0;
      const double c = own[2] - sliding;  // 0 where it is closed
      if (set.compliance > 0.0)
        away[bounces] = std::abs(std::max(0.0, -c / set.compliance) - wanted);
      else  // any impulse where c = 0, none where it separates
        away[bounces] = std::abs(c) <= inverse.tolerance * speed ? 0.0 : c > 0.0 ? std::abs(wanted) : kInfinity;
    }
    assembler.set_bounce(i, away[1] < away[0]);
  }
}

/// Bounces only what would close its gap without contact impulses. True when something changed.
bool InverseDynamics::Impl::change_inconsistent_bounces(const Input& input) {
  const std::vector<Assembler::Set>& sets = assembler.sets();
  if (std::none_of(sets.begin(), sets.end(), [](const Assembler::Set& set) { return set.bounce != 0.0; })) return false;
  dynamics.update(q, input.v);
  dynamics.factor(implicit);
  acceleration.setZero();
  std::fill(wrenches.begin(), wrenches.end(), Wrench());
  joint_force.setZero();
  assembler.add_forces(solution.impulse, 1.0, wrenches, joint_force);
  Vector momentum(u.size());  // J^T impulse: what the wrenches take from the bias
  dynamics.inverse(acceleration, wrenches, momentum);
  momentum = dynamics.bias() - momentum + joint_force;
  dynamics.solve(momentum);
  const Vector free_v = u - momentum;
  GrowVector free;
  free.resize(assembler.num_rows());
  assembler.velocities(free_v, free);
  bool changed = false;
  for (std::size_t i = 0; i < sets.size(); ++i) {
    if (sets[i].bounce == 0.0) continue;
    const bool closes = sets[i].gap + settings.time_step * free[sets[i].start + 2] <= 0.0;
    if (closes == sets[i].bounces) continue;
    assembler.set_bounce(i, closes);
    changed = true;
  }
  return changed;
}

/// The closest motion and its impulses (S13, S14). Which contacts bounce and which limits count follows from the
/// answer: again until they are right.
void InverseDynamics::Impl::find_closest(const Input& input) {
  const Vector wanted = u;
  Vector reach = u.cwiseAbs();
  for (int round = 0; round < kRounds; ++round) {
    const Status status = move_or_say_why(input);
    find_impulses();
    if (solution.status == Status::Solved) solution.status = status;
    if (solution.status == Status::Solved && !(solution.relative <= inverse.tolerance))
      solution.status = Status::MaxIterations;
    const bool missed = misses_limit(), changed = change_inconsistent_bounces(input);
    if (!missed && !changed) break;
    if (round + 1 == kRounds) {
      solution.status = Status::MaxIterations;
      break;
    }
    reach = reach.cwiseMax(u.cwiseAbs());
    u = wanted;
    if (missed)
      start(input, &reach);
    else
      restart(input);
  }
  Vector moved = q;
  result.v_next = u;
  advance(*world, settings.time_step, moved, result.v_next);
}

/// Numbers that are each allowed may overflow where they meet.
Status InverseDynamics::Impl::move_or_say_why(const Input& input) {
  try {
    return move_to_closest(input);
  } catch (const InvalidInput& error) {
    throw InvalidInput("v, v_next", std::string("are too large to find the closest motion (") + error.what() + ")");
  }
}

/// The same sets, bounces as they are now.
void InverseDynamics::Impl::restart(const Input& input) {
  assembler.set_free_velocity(u);
  set_guess(input);
  set_speed();
}

/// Runs into a limit that is not among the sets.
bool InverseDynamics::Impl::misses_limit() const {
  const auto misses = [this](SetSource side, std::size_t index, double gap, double moves) {
    if (!(gap + settings.time_step * moves < 0.0)) return false;
    return std::none_of(assembler.sets().begin(), assembler.sets().end(), [&](const Assembler::Set& set) {
      return set.source == side && set.index == static_cast<int>(index);
    });
  };
  const auto misses_either = [&](const auto& limited, std::size_t index, double value, double rate) {
    return misses(SetSource::LowerLimit, index, value - limited.lower, rate) ||
           misses(SetSource::UpperLimit, index, limited.upper - value, -rate);
  };
  const std::vector<Joint>& joints = world->joints();
  for (std::size_t j = 0; j < joints.size(); ++j) {
    const Joint& joint = joints[j];
    if (joint.num_v() == 1 && misses_either(joint, j, q[joint.q_index], u[joint.v_index])) return true;
    if (joint.type != JointType::Ball || joint.upper == kInfinity) continue;
    const double angle = 2.0 * std::atan2(q.segment<3>(joint.q_index).norm(), std::abs(q[joint.q_index + 3]));
    // Where the assembler sees no axis there is no limit yet.
    if (angle > 2e-9 && misses(SetSource::UpperLimit, j, joint.upper - angle, -u.segment<3>(joint.v_index).norm()))
      return true;
  }
  for (std::size_t t = 0; t < world->tendons().size(); ++t) {
    const Tendon& tendon = world->tendons()[t];
    double rate = 0.0;
    for (const Tendon::Term& term : tendon.terms)
      rate += term.coefficient * u[joints[static_cast<std::size_t>(term.joint)].v_index];
    if (misses_either(tendon, joints.size() + t, tendon_length(*world, tendon, q), rate)) return true;
  }
  return false;
}

/// u <- the closest motion that needs no force where nothing is actuated; guess <- impulses of what feels it.
Status InverseDynamics::Impl::move_to_closest(const Input& input) {
  const std::vector<std::uint8_t>& actuated = input.actuated.empty() ? default_actuated : input.actuated;
  ClosestProblem p;
  for (Index k = 0; k < u.size(); ++k)
    if (!actuated[static_cast<std::size_t>(k)]) p.unactuated.push_back(k);
  dynamics.update(q, input.v);
  p.mass = dynamics.mass_matrix();
  for (Index k = 0; k < u.size(); ++k) dynamics.add_implicit(implicit, Vector::Unit(u.size(), k), p.mass.col(k));
  p.jacobian.resize(assembler.num_rows(), u.size());
  GrowVector column;
  column.resize(p.jacobian.rows());
  for (Index k = 0; k < u.size(); ++k) {
    assembler.velocities(Vector::Unit(u.size(), k), column);
    p.jacobian.col(k) = column;
  }
  p.velocity = assembler.free_velocity();
  p.compliance = compliance;
  p.guess = guess;
  p.sets = assembler.constraint_sets();
  double fastest = speed;
  for (std::size_t i = 0; i < assembler.sets().size(); ++i) {
    const Assembler::Set& set = assembler.sets()[i];
    const bool moment = is_moment(set);
    p.kinematic.push_back(set.compliance == 0.0 && !moment && set.source != SetSource::JointFriction);
    if (!moment) continue;
    p.ties.push_back({set.index, static_cast<Index>(i), set.load_factor});
    fastest = std::max(fastest, (p.jacobian.middleRows(set.start, 2) * input.v).norm());  // even if asked to stop
  }
  acceleration = (u - input.v) / settings.time_step;
  add_up(false);
  p.missing = settings.time_step * result.force(p.unactuated);
  p.solver = settings.solver;
  p.solver.law = inverse.law;
  p.solver.tolerance = std::min(p.solver.tolerance, inverse.tolerance);
  p.solver.aim = std::min(p.solver.aim, p.solver.tolerance);
  p.allowed = inverse.tolerance * fastest;

  const ClosestMotion found = closest_motion(p);
  u += found.change;
  guess = found.impulse;
  settled = found.settled;
  assembler.set_free_velocity(u);
  const double wanted = speed;
  set_speed();
  speed = std::max(speed, wanted);
  return found.status;
}

std::vector<Contact> InverseDynamics::contacts() const {
  const Impl& s = *impl_;
  return contact_reports(s.assembler, s.points, s.solution.impulse, s.solution.velocity, s.settings.time_step);
}

ConstVectorRef InverseDynamics::impulse() const { return impl_->solution.impulse; }
const Assembler& InverseDynamics::assembler() const { return impl_->assembler; }

std::string InverseDynamics::worst() const {
  const Impl& s = *impl_;
  if (!(s.solution.residual > 0.0) || s.solution.worst < 0) return "";
  const Assembler::Set& set = s.assembler.sets()[static_cast<std::size_t>(s.solution.worst)];
  const auto coordinate = [&](std::size_t joint) {
    const std::vector<Joint>& joints = s.world->joints();
    if (joint >= joints.size()) return "tendon '" + s.world->tendons()[joint - joints.size()].name + "'";
    return "joint '" + joints[joint].name + "'";
  };
  const auto index = static_cast<std::size_t>(set.index);
  const auto moved_by = [&](Index v) {
    std::size_t j = s.world->joints().size() + static_cast<std::size_t>(std::max<Index>(0, v - s.world->num_v()));
    for (std::size_t k = 0; k < s.world->joints().size(); ++k) {
      const Joint& joint = s.world->joints()[k];
      if (v >= joint.v_index && v < joint.v_index + joint.num_v()) j = k;
    }
    return j;
  };
  switch (set.source) {
    case SetSource::Contact:
    case SetSource::Torsion:
    case SetSource::Rolling: {
      const ContactPoint& point = s.points[static_cast<std::size_t>(set.index)];
      const auto geometry = [&](int g) { return "'" + s.world->geometries()[static_cast<std::size_t>(g)].name + "'"; };
      return (set.source == SetSource::Contact ? "contact of " : "torsion or rolling of ") +
             geometry(point.geometry_a) + " and " + geometry(point.geometry_b);
    }
    case SetSource::LowerLimit:
      return "lower limit of " + coordinate(index);
    case SetSource::UpperLimit:
      return "upper limit of " + coordinate(index);
    case SetSource::JointFriction:
      return "friction of " + coordinate(moved_by(set.index));
    case SetSource::Equality:
      return "equality '" + s.world->constraints()[static_cast<std::size_t>(set.index)].name + "'";
  }
  return "";
}

}  // namespace signorini
