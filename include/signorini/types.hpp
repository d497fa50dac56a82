#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <new>
#include <utility>
#include <vector>

namespace signorini {

using Index = Eigen::Index;
using Vector = Eigen::VectorXd;
using Matrix = Eigen::MatrixXd;
using SparseMatrix = Eigen::SparseMatrix<double>;  // column-major, compressed
using ConstVectorRef = Eigen::Ref<const Vector>;
using VectorRef = Eigen::Ref<Vector>;

/// A Vector that keeps its memory when it gets shorter: in a loop whose sizes change, resizing to what has been seen
/// allocates nothing. A resize to another size leaves the values undefined.
class GrowVector : public Eigen::Map<Vector> {
  using Base = Eigen::Map<Vector>;

 public:
  GrowVector() : Base(nullptr, 0) {}
  template <typename Derived>
  GrowVector(const Eigen::MatrixBase<Derived>& other) : GrowVector() {
    *this = other;
  }
  GrowVector(const GrowVector& other) : GrowVector() { *this = other; }
  GrowVector(GrowVector&& other) noexcept : GrowVector() { swap(other); }
  template <typename Derived>
  GrowVector& operator=(const Eigen::MatrixBase<Derived>& other) {
    std::vector<double> old;  // which `other` may read, as in a = G * a
    if (other.size() > static_cast<Index>(memory_.capacity())) {
      old.swap(memory_);
      memory_.reserve(2 * old.size());
    }
    resize(other.size());
    Base::operator=(other);
    return *this;
  }
  GrowVector& operator=(const GrowVector& other) {
    resize(other.size());
    Base::operator=(other);
    return *this;
  }
  GrowVector& operator=(GrowVector&& other) noexcept {
    swap(other);
    return *this;
  }

  void resize(Index size) {
    if (size > static_cast<Index>(memory_.size())) memory_.resize(static_cast<std::size_t>(size));
    point_at(size);
  }
  using Base::setZero;
  void setZero(Index size) {
    resize(size);
    setZero();
  }
  void swap(GrowVector& other) noexcept {
    const Index own = size(), others = other.size();
    memory_.swap(other.memory_);
    point_at(others);
    other.point_at(own);
  }

 private:
  void point_at(Index size) { new (static_cast<Base*>(this)) Base(memory_.data(), size); }

  std::vector<double> memory_;
};

inline void swap(GrowVector& a, GrowVector& b) noexcept { a.swap(b); }

/// The law of contact: Signorini + Coulomb + maximum dissipation (Ncp), or its convex relaxation
/// without the De Saxce term (Ccp), the model of MuJoCo and Drake.
enum class Law { Ncp, Ccp };

}  // namespace signorini
