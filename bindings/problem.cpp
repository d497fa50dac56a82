#include <nanobind/eigen/dense.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <memory>

#include "bindings.hpp"
#include "signorini/delassus/dense.hpp"
#include "signorini/delassus/mass_space.hpp"
#include "signorini/delassus/sparse.hpp"
#include "signorini/errors.hpp"
#include "signorini/problem/contact_problem.hpp"
#include "signorini/problem/residual.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using namespace signorini;

using Values = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Indices = nb::ndarray<const int, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

/// A scipy CSC matrix (sorted, without duplicates), copied.
struct CscArrays {
  Index rows, cols;
  Values data;
  Indices indices, indptr;
};

SparseMatrix sparse(const CscArrays& a) {
  return Eigen::Map<const SparseMatrix>(a.rows, a.cols, static_cast<Index>(a.data.size()), a.indptr.data(),
                                        a.indices.data(), a.data.data());
}

template <class T>
nb::object numpy_copy(const T* data, std::size_t size) {
  return nb::cast(nb::ndarray<nb::numpy, const T, nb::ndim<1>>(data, {size}), nb::rv_policy::copy);
}

ConstraintSets constraint_sets(const std::vector<int>& types, const std::vector<double>& first,
                               const std::vector<double>& second) {
  ConstraintSets sets;
  for (std::size_t i = 0; i < types.size(); ++i) {
    switch (static_cast<SetType>(types[i])) {
      case SetType::FrictionCone:
        sets.add_friction_cone(first.at(i));
        break;
      case SetType::HalfLine:
        sets.add_half_line();
        break;
      case SetType::Interval:
        sets.add_interval(first.at(i), second.at(i));
        break;
      case SetType::Equality:
        sets.add_equality();
        break;
    }
  }
  return sets;
}

}  // namespace

void bind_problem(nb::module_& m) {
  nb::class_<CscArrays>(m, "CscArrays")
      .def(
          "__init__",
          [](CscArrays* self, Index rows, Index cols, Values data, Indices indices, Indices indptr) {
            const auto same = [&](std::size_t size, std::size_t wanted, const char* field) {
              if (size != wanted) throw InvalidInput(field, "is damaged: array lengths of the sparse matrix disagree");
            };
            same(indptr.size(), static_cast<std::size_t>(cols) + 1, "indptr");
            same(indices.size(), data.size(), "indices");
            new (self) CscArrays{rows, cols, data, indices, indptr};
          },
          "rows"_a, "cols"_a, "data"_a, "indices"_a, "indptr"_a);

  nb::class_<ConstraintSets>(m, "ConstraintSets")
      .def(nb::new_([](const std::vector<int>& types, const std::vector<double>& first,
                       const std::vector<double>& second) { return constraint_sets(types, first, second); }),
           "types"_a, "first"_a, "second"_a)
      .def_static("friction_cones", &ConstraintSets::friction_cones, "friction"_a)
      .def(
          "project",
          [](const ConstraintSets& self, const ConstVectorRef& x) {
            if (x.size() != self.size()) throw InvalidInput("x", "has the wrong size");
            Vector out(x.size());
            self.project(x, out);
            return out;
          },
          "x"_a)
      .def_prop_ro("size", &ConstraintSets::size);

  nb::class_<DelassusOperator>(m, "Delassus")
      .def_prop_ro("size", &DelassusOperator::size)
      .def_prop_ro("asymmetry", &DelassusOperator::asymmetry)
      .def(
          "column",
          [](const DelassusOperator& self, Index column) {
            if (column < 0 || column >= self.size()) throw InvalidInput("column", "is out of range");
            Vector out(self.size());
            self.apply(Vector::Unit(self.size(), column), out);
            return out;
          },
          "column"_a)
      .def("csc", [](const DelassusOperator& self) {
        SparseMatrix g = self.matrix();
        g.makeCompressed();
        const auto nnz = static_cast<std::size_t>(g.nonZeros());
        return nb::make_tuple(numpy_copy(g.valuePtr(), nnz), numpy_copy(g.innerIndexPtr(), nnz),
                              numpy_copy(g.outerIndexPtr(), static_cast<std::size_t>(g.cols()) + 1));
      });
  m.def(
      "dense_delassus",
      [](const Eigen::Ref<const Matrix>& matrix) -> std::shared_ptr<DelassusOperator> {
        return std::make_shared<DenseDelassus>(matrix);
      },
      "matrix"_a, nb::call_guard<nb::gil_scoped_release>());
  m.def(
      "sparse_delassus",
      [](const CscArrays& matrix) -> std::shared_ptr<DelassusOperator> {
        return std::make_shared<SparseDelassus>(sparse(matrix));
      },
      "matrix"_a, nb::call_guard<nb::gil_scoped_release>());
  m.def(
      "mass_space_delassus",
      [](const CscArrays& mass, const CscArrays& jacobian) -> std::shared_ptr<DelassusOperator> {
        return std::make_shared<MassSpaceDelassus>(sparse(mass), sparse(jacobian));
      },
      "mass"_a, "jacobian"_a, nb::call_guard<nb::gil_scoped_release>());

  nb::class_<ContactProblem>(m, "ContactProblem")
      .def(
          "__init__",
          [](ContactProblem* self, std::shared_ptr<DelassusOperator> delassus, const Vector& free_velocity,
             const ConstraintSets& sets, const Vector& compliance) {
            new (self) ContactProblem(std::move(delassus), free_velocity, sets, compliance);
          },
          "delassus"_a, "free_velocity"_a, "sets"_a, "compliance"_a)
      .def_prop_ro(
          "delassus",
          [](const ContactProblem& self) { return std::const_pointer_cast<DelassusOperator>(self.delassus_ptr()); })
      .def_prop_ro("size", &ContactProblem::size)
      .def_prop_ro("num_contacts", &ContactProblem::num_contacts)
      .def_prop_ro("scale", [](const ContactProblem& self) { return Vector(self.scale()); })
      .def_prop_ro("compliance", [](const ContactProblem& self) { return Vector(self.compliance()); })
      .def(
          "velocity",
          [](const ContactProblem& self, const ConstVectorRef& impulse) {
            Vector velocity(self.size());
            self.velocity(impulse, velocity);
            return velocity;
          },
          "impulse"_a)
      .def("check_definite", &ContactProblem::check_definite, nb::call_guard<nb::gil_scoped_release>());

  auto residual_class = nb::class_<Residual>(m, "Residual");
  residual_class.def_ro("primal", &Residual::primal)
      .def_ro("dual", &Residual::dual)
      .def_ro("complementarity", &Residual::complementarity)
      .def_ro("relative", &Residual::relative)
      .def_ro("against_free_velocity", &Residual::against_free_velocity)
      .def_ro("signorini", &Residual::signorini)
      .def_ro("dissipation", &Residual::dissipation)
      .def("solves", &Residual::solves, "tolerance"_a)
      .def_static("largest_share", &Residual::largest_share, "tolerance"_a);
  nb::enum_<Law>(m, "Law").value("ncp", Law::Ncp).value("ccp", Law::Ccp);
  m.def(
      "residual",
      [](const ContactProblem& problem, const Vector& impulse, Law law) {
        if (impulse.size() != problem.size()) throw InvalidInput("impulse", "has the wrong size");
        return residual(problem, impulse, law);
      },
      "problem"_a, "impulse"_a, "law"_a);
}
