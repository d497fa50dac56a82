#pragma once

namespace signorini {

/// Eight cones of the interior point side by side: entry k of each array belongs to the k-th. Letters as in
/// interior_point.cpp. A line is a cone without tangents; what is not there has weight 0, x = z = (1, 0, 0), dx = 0.
struct ConeBlock {
  static constexpr int kWidth = 8;
  using Row = double[kWidth];

  Row x[3], z[3], dx[3], dz[3], centre[3];
  Row w[3], lambda[3];
  Row eta, over_eta;  ///< NT scaling, det(x) / det(z) to the quarter; 1 / eta
  Row share;          ///< 1 / (1 + w_0)
  Row det_x, det_z;   ///< x_0^2 - |x_T|^2 and that of z
  Row u[2];           ///< z_T / |z_T|
  Row h[6];           ///< H = W^-2: its entries 00, 01, 02, 11, 12, 22
  Row weight;         ///< 1, or 0 of what is not there
};

}  // namespace signorini
