#include "signorini/model/world.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "require.hpp"
#include "world_impl.hpp"

namespace signorini {

World::World(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
World::~World() = default;

Index World::num_q() const { return impl_->num_q; }
Index World::num_v() const { return impl_->num_v; }
Index World::num_controls() const { return static_cast<Index>(impl_->actuators.size()); }
int World::num_frames() const { return static_cast<int>(impl_->moving_parent.size()); }
const std::vector<Body>& World::bodies() const { return impl_->bodies; }
const std::vector<Joint>& World::joints() const { return impl_->joints; }
const std::vector<Geometry>& World::geometries() const { return impl_->geometries; }
const std::vector<EqualityConstraint>& World::constraints() const { return impl_->constraints; }
const std::vector<Tendon>& World::tendons() const { return impl_->tendons; }
const std::vector<Actuator>& World::actuators() const { return impl_->actuators; }
const std::vector<ContactPair>& World::contact_pairs() const { return impl_->contact_pairs; }

Material World::material(int a, int b) const {
  if (const ContactPair* pair = impl_->find_pair(a, b)) return pair->material;
  return mix(impl_->geometries[static_cast<std::size_t>(a)].material,
             impl_->geometries[static_cast<std::size_t>(b)].material);
}

const ContactPair* World::Impl::find_pair(int a, int b) const {
  if (contact_pairs.empty()) return nullptr;
  if (a > b) std::swap(a, b);
  const auto found = std::lower_bound(contact_pairs.begin(), contact_pairs.end(), std::make_pair(a, b),
                                      [](const ContactPair& pair, const std::pair<int, int>& wanted) {
                                        return std::make_pair(pair.geometry_a, pair.geometry_b) < wanted;
                                      });
  if (found == contact_pairs.end() || found->geometry_a != a || found->geometry_b != b) return nullptr;
  return &*found;
}
const std::vector<std::pair<int, int>>& World::excluded_pairs() const { return impl_->excluded; }
const Vector3& World::gravity() const { return impl_->gravity; }
const Vector& World::initial_q() const { return impl_->initial_q; }

bool World::may_touch(int a, int b) const {
  if (a > b) std::swap(a, b);
  const Geometry& ga = impl_->geometries[a];
  const Geometry& gb = impl_->geometries[b];
  const int fa = impl_->bodies[ga.body].frame, fb = impl_->bodies[gb.body].frame;
  if (fa == fb) return false;
  if (impl_->find_pair(a, b)) return true;
  if (!((ga.group & gb.mask) | (gb.group & ga.mask))) return false;
  // Parent and child; the world itself is nobody's parent, but a robot's own base, fixed to the world, is.
  const auto adjoins = [this](int child, int parent, int parent_body) {
    return impl_->moving_parent[child] == parent && (parent != 0 || parent_body != 0);
  };
  const auto articulated = [this](int frame) { return frame != 0 && frame < impl_->num_articulated_frames; };
  if ((articulated(fa) && adjoins(fa, fb, gb.body)) || (articulated(fb) && adjoins(fb, fa, ga.body))) return false;
  if (impl_->excluded_bodies.count(Impl::pair_key(ga.body, gb.body))) return false;
  return !std::binary_search(impl_->excluded.begin(), impl_->excluded.end(), std::make_pair(a, b));
}

void World::normalize(VectorRef q, const char* field) const {
  require_finite(field, q);
  const auto quaternion = [&q](const Joint& joint) {
    return q.segment<4>(joint.q_index + (joint.type == JointType::Free ? 3 : 0));
  };
  for (const Joint& joint : impl_->joints)
    if (joint.num_q() > 1 && !(quaternion(joint).norm() > 1e-6))
      throw InvalidInput(field, "has a quaternion of length 0 (joint '" + joint.name + "')");
  for (const Joint& joint : impl_->joints)
    if (joint.num_q() > 1) quaternion(joint).normalize();
}

void World::integrate(const ConstVectorRef& q, const ConstVectorRef& v, double time_step, VectorRef q_next) const {
  for (const Joint& joint : impl_->joints) {
    const Index iq = joint.q_index, iv = joint.v_index;
    if (joint.num_q() == 1) {
      q_next[iq] = q[iq] + time_step * v[iv];
      continue;
    }
    const bool free = joint.type == JointType::Free;
    const Eigen::Quaterniond rotation(Eigen::Vector4d(q.segment<4>(iq + (free ? 3 : 0))));
    if (free) q_next.segment<3>(iq) = q.segment<3>(iq) + time_step * (rotation * Vector3(v.segment<3>(iv)));
    const Vector3 half = 0.5 * time_step * v.segment<3>(iv + (free ? 3 : 0));
    const double angle = half.norm();
    const double s = angle < 1e-4 ? 1.0 - angle * angle / 6.0 : std::sin(angle) / angle;
    Eigen::Quaterniond turned = rotation * Eigen::Quaterniond(std::cos(angle), s * half[0], s * half[1], s * half[2]);
    turned.normalize();
    q_next.segment<4>(iq + (free ? 3 : 0)) = turned.coeffs();
  }
}

}  // namespace signorini
