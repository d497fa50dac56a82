#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCore>

namespace signorini {

using Index = Eigen::Index;
using Vector = Eigen::VectorXd;
using Matrix = Eigen::MatrixXd;
using SparseMatrix = Eigen::SparseMatrix<double>;  // column-major, compressed
using ConstVectorRef = Eigen::Ref<const Vector>;
using VectorRef = Eigen::Ref<Vector>;

/// The law of contact: Signorini + Coulomb + maximum dissipation (Ncp), or its convex relaxation
/// without the De Saxce term (Ccp), the model of MuJoCo and Drake.
enum class Law { Ncp, Ccp };

}  // namespace signorini
