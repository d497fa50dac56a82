#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "signorini/assembly/dynamics.hpp"
#include "signorini/collision/detector.hpp"
#include "signorini/delassus/block.hpp"
#include "signorini/delassus/coupled.hpp"
#include "signorini/problem/contact_problem.hpp"

namespace signorini {

/// How gaps, overlaps and approach speeds enter the problem (docs/simulation.md, S6 to S9).
struct CorrectionSettings {
  double time_step = 1e-3;  ///< [s]
  /// Share of an overlap that a step of 1 ms or more takes back, less in shorter ones in proportion; rigid contact,
  /// limits.
  double baumgarte = 0.2;
  double max_correction_speed = 1.0;    ///< of that [m/s, rad/s]
  double restitution_threshold = 0.05;  ///< approach speed below which nothing bounces [m/s]
};

/// Columns (t1, t2, n), right-handed, of a contact with this unit normal.
Matrix3 contact_frame(const Vector3& normal);

/// What a set of the assembled problem stands for.
enum class SetSource : std::uint8_t {
  Contact,        ///< index: of the contact point
  LowerLimit,     ///< index: of the joint; of tendon k: number of joints + k
  UpperLimit,     ///< likewise
  JointFriction,  ///< index: of the velocity; of tendon k: number of velocities + k
  Equality,       ///< index: of the constraint; row: of it
  Torsion,        ///< index: of the contact, set and point; rows: about n, nothing, the load (S16)
  Rolling         ///< likewise; rows: about t1, about t2, the load
};

/// Writes the contact problem of one step: rows of J in whitened form Y, G = Y Y^T, g = J u + corrections. Most points
/// within the margin are apart and stay so: the problem has only the sets that act, and is right for all of them once
/// select_violated() has found no other (S10). Allocates nothing for sizes already seen.
class Assembler {
 public:
  struct Set {
    SetSource source = SetSource::Contact;
    int index = 0, row = 0;
    bool spare = false;             ///< Contact: left out until the answer violates it
    bool built = false;             ///< has its rows Y; a set gets them when it joins the problem
    int start = 0, rows = 0;        ///< among the rows of all sets
    int offset = -1;                ///< in the problem; -1: left out
    double correction = 0.0;        ///< added to the last row of g [m/s]
    double compliance = 0.0;        ///< of the last row [1/kg]
    int articulated = -1;           ///< slot of its articulated columns, or -1
    int group = -1, group_row = 0;  ///< of articulated sets that share velocities; first row in its product
    int num_free = 0;               ///< free bodies it acts on
    int free[2] = {0, 0};
    double y[2][18];                         ///< rows x 6 each, column-major, whitened
    Matrix3 frame;                           ///< Contact, Equality of bodies: columns t1, t2, n, or the world's axes
    Vector3 point_a, point_b;                ///< likewise: that are held together, in the world
    int frame_a = 0, frame_b = 0;            ///< likewise: what they move with
    int first_term = 0, num_terms = 0;       ///< others: the velocity is a sum over terms_, factor u[v] each
    Material material;                       ///< Contact: mixed
    int first_moment = 0, num_moments = 0;   ///< Contact: its sets of torsion and rolling
    double load_factor = 0.0;                ///< Torsion, Rolling: the load over the normal impulse [m]
    double load_weight = 1.0;                ///< likewise: what ties them [1/(kg m^2)]
    double gap = 0.0, gap_correction = 0.0;  ///< Contact [m], and its correction without bounce [m/s]
    double bounce = 0.0;  ///< Contact: e v_N [m/s] where the approach is fast enough to bounce (S8), else 0
    bool bounces = false;
  };

  Assembler(std::shared_ptr<const World> world, const CorrectionSettings& settings);

  /// The sets, and g of all their rows. dynamics: updated at (q, v), and factored before select(); free_v: velocity at
  /// the end of the step without constraint impulses. With a wanted velocity instead, g is what inverse dynamics asks.
  /// reach: limits that joints of these speeds could come near are there too, whichever way each moves.
  void assemble(const Dynamics& dynamics, const ConstVectorRef& q, const ConstVectorRef& v,
                const ConstVectorRef& free_v, const std::vector<ContactPoint>& contacts, const Vector* reach = nullptr);
  /// Whether the velocity u leads past a limit that has no set: assemble() again, with `reach`.
  bool passes_limit(const ConstVectorRef& q, const ConstVectorRef& u) const;
  /// No sets, until the next assemble().
  void clear();
  const std::vector<Set>& sets() const { return sets_; }
  Index num_rows() const { return rows_; }  ///< of all sets
  const ConstraintSets& constraint_sets() const { return all_sets_; }
  const GrowVector& free_velocity() const { return g_; }  ///< g, num_rows() values

  /// g of the same sets at another free_v.
  void set_free_velocity(const ConstVectorRef& free_v);
  /// Takes the bounce of a set with one into g, or out of it.
  void set_bounce(std::size_t set, bool bounces);
  bool has_moments() const { return has_moments_; }
  /// impulse <- the loads of torsion and rolling that belong to its normal impulses (S16).
  void set_loads(VectorRef impulse) const;
  /// For the CCP, which relaxes the law of contacts but not that of moments (S17): g of loads <- the speeds of their
  /// own rows in g; and for those in problem(), towards the speeds in sigma, of the solution with those before (unless
  /// `first`). False, and nothing changed, where they are right, to `tolerance` times the largest load.
  void set_load_speeds();
  bool shift_loads(const ConstVectorRef& sigma, const ConstVectorRef& impulse, double tolerance, bool first);

  /// Velocities J u of all sets, num_rows() values; without a Jacobian, from the twists of the bodies.
  void velocities(const ConstVectorRef& u, VectorRef out);
  /// own (num_rows() values) <- the impulses that another assembler of this world found at this configuration: of the
  /// same contacts, limits, joints and equalities. False where one of the contacts that push there is none here.
  bool copy_impulses(const std::vector<Set>& sets, const ConstVectorRef& impulse, VectorRef own) const;
  /// factor J^T impulse without a Jacobian: as wrenches on the frames, and as forces on velocities for sets of joints;
  /// added.
  void add_forces(const ConstVectorRef& impulse, double factor, std::vector<Wrench>& wrenches, VectorRef force) const;

  /// The problem of the sets that free_v violates (but spare contacts), that `guess` (num_rows values) has an impulse
  /// for, or that are no contact or limit; or of all sets.
  void select(const ConstVectorRef& guess, Law law, bool all = false);
  const ContactProblem& problem() const { return problem_; }
  /// Adds the sets which the answer to problem() violates; false if there are none. impulse, sigma: num_rows values,
  /// of the sets in the problem; sigma receives the velocities of the others.
  bool select_violated(const ConstVectorRef& impulse, Law law, VectorRef sigma);
  /// Velocity with the impulse that select_violated() was asked of last: free_v + M^^-1 J^T impulse.
  const Vector& velocity() const { return velocity_; }

  /// The problem of all sets, for those who want to see it; dynamics must be as they were in assemble().
  ContactProblem whole_problem();

 private:
  Set& new_set(SetSource source, int index, int row, int rows);
  double* articulated_columns(Set& set);
  void add_point(const Dynamics& dynamics, Set& set, int frame, const Vector3& point, double sign, std::size_t shared);
  void add_rotation(const Dynamics& dynamics, Set& set, int frame, double sign);
  void add_velocity(Set& set, Index v, double factor);
  void add_term(Set& set, Index v, double factor);
  void add_tendon_terms(Set& set, int tendon, double factor);
  void build_rows(Set& set);
  void build_point_rows(Set& set);
  void build_loop_rows(Set& first);
  void whiten(Set& set);
  /// velocity = J u of a set; twists: those of the frames at u.
  void set_velocity(const Set& set, const ConstVectorRef& u, const std::vector<Twist>& twists, double* velocity) const;
  void add_contacts(const std::vector<ContactPoint>& contacts);
  void add_limits(const ConstVectorRef& q, const ConstVectorRef& v, const ConstVectorRef& free_v, const Vector* reach);
  void add_limit(SetSource source, int index, double gap, double stiffness, double damping);
  void add_moments();
  double tendon_rate(const Tendon& tendon, const ConstVectorRef& u) const;
  void add_joint_friction();
  void add_equalities(const Dynamics& dynamics, const ConstVectorRef& q, const ConstVectorRef& v);
  void correct(const ConstVectorRef& v);
  /// G of the sets of `selection`, whose rows are `sets`, after multiply_articulated().
  void multiply_blocks(const std::vector<int>& selection, const ConstraintSets& sets, BlockDelassus& delassus);
  void add_free_products(const std::vector<int>& selection, int body, BlockDelassus& delassus);
  void multiply_articulated(const std::vector<int>& selection);
  void soften_redundant(const std::vector<int>& selection);
  void write_problem();
  double largest_left_out();
  template <typename Add>
  void add_load(const Set& moment, Index normal, Index first, const Add& add) const;
  void add_loads(const std::vector<int>& selection, BlockDelassus& delassus) const;
  void add_loads(double* matrix, int rows) const;
  double squares(const Set& set) const;
  void set_load_speed(Set& set, double speed);
  bool violated(const Set& set, const double* sigma, Law law) const;
  double rigid_correction(double gap) const;
  /// The spring with damper as correction and compliance of a row (S7); rigid where stiffness is infinite.
  void set_spring(Set& set, double gap, double stiffness, double damping, bool one_sided) const;
  void add_row_products(const Set& set, const ConstVectorRef& impulse);

  std::shared_ptr<const World> world_;
  const Dynamics* dynamics_ = nullptr;  // of the last assemble()
  CorrectionSettings settings_;
  std::vector<int> geometry_frame_;
  std::vector<int> limited_joints_, limited_tendons_;
  struct Term {
    int v = 0;
    double factor = 1.0;
  };
  std::vector<Term> terms_;
  std::vector<std::pair<int, double>> friction_velocities_;  // velocity, largest force

  std::vector<Set> sets_;
  int rows_ = 0;
  bool has_moments_ = false;
  double load_step_ = 1.0;
  GrowVector load_changes_;  // of the last shift, by selected set
  Index nv_articulated_ = 0;
  int words_ = 0;  // of a mask of articulated velocities
  int num_slots_ = 0;
  std::vector<double> columns_;               // by slot: 3 x nv_articulated_, `rows` values a velocity
  std::vector<std::uint64_t> masks_;          // by slot: velocities in use
  std::vector<std::uint64_t> support_masks_;  // by frame
  std::vector<std::uint64_t> chain_masks_;    // by velocity: itself and all before it
  std::vector<int> dofs_;
  struct Group {
    int rows = 0;
    std::ptrdiff_t product = 0;  // start in products_
  };
  std::vector<Group> groups_;
  std::vector<std::uint64_t> group_masks_;  // by group: velocities in use
  std::vector<double> packed_, products_;
  std::vector<int> articulated_sets_;  // below: numbers in the selection
  struct Touch {
    int set = 0, side = 0;        ///< number in the selection, and which of its free bodies this is
    int rows = 0;                 ///< of the set
    std::size_t first_block = 0;  ///< in blocks_of_free_: the blocks with the sets before it on the body
  };
  std::vector<std::vector<Touch>> sets_of_free_;
  std::vector<Index> blocks_of_free_;
  std::vector<int> touched_free_;
  std::vector<int> partners_;
  bool softened_ = false;  // soften_redundant() has been, for these sets
  std::vector<Set*> loop_sets_;
  std::vector<double> loop_scale_, loops_;
  std::vector<BlockDelassus::Pair> pairs_;
  ConstraintSets all_sets_, constraint_sets_;  // of sets_, and of those in the problem
  std::vector<int> selection_;                 // the sets in the problem
  std::shared_ptr<BlockDelassus> delassus_;
  std::shared_ptr<CoupledDelassus> coupled_;  // of one robot, no free bodies
  ContactProblem problem_;
  Vector free_v_, velocity_, whitened_;
  std::vector<Twist> twists_, twists_now_;
  GrowVector g_, problem_g_, problem_compliance_;
};

bool is_moment(const Assembler::Set& set);  ///< Torsion or Rolling
/// The moment of a set of torsion or rolling, in the world, and its rows of a moment or an angular velocity.
Vector3 moment_of(const Assembler::Set& set, const double* impulse);
void set_moment(const Assembler::Set& set, const Vector3& moment, double* rows);

}  // namespace signorini
