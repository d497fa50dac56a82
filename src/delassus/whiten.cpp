#include "whiten.hpp"

#include <cmath>
#include <vector>

namespace signorini {
namespace {

/// high + low, |low| at most half a unit in the last place of high (Dekker 1971).
struct Twofold {
  double high, low;
};

Twofold sum(double a, double b) {  // exact (Knuth)
  const double s = a + b, t = s - a;
  return {s, (a - (s - t)) + (b - t)};
}

Twofold renormalized(double high, double low) {  // |low| small
  const double s = high + low;
  return {s, low - (s - high)};
}

/// a - b c
Twofold minus_product(Twofold a, Twofold b, Twofold c) {
  const double p = b.high * c.high;
  const double rest = std::fma(b.high, c.high, -p) + (b.high * c.low + b.low * c.high);
  const Twofold s = sum(a.high, -p);
  return renormalized(s.high, s.low + (a.low - rest));
}

Twofold quotient(Twofold a, Twofold b) {
  const double q = a.high / b.high;
  const Twofold rest = minus_product(a, {q, 0.0}, b);
  return renormalized(q, (rest.high + rest.low) / b.high);
}

Twofold square_root(Twofold a) {
  const double r = std::sqrt(a.high);
  const Twofold rest = minus_product(a, {r, 0.0}, {r, 0.0});
  return renormalized(r, (rest.high + rest.low) / (2.0 * r));
}

}  // namespace

bool whiten(const Matrix& mass, Matrix& jacobian_transpose) {
  const Index n = mass.rows();
  std::vector<Twofold> l(static_cast<std::size_t>(n * n)), x(static_cast<std::size_t>(n));  // l by rows
  for (Index i = 0; i < n; ++i) {
    for (Index j = 0; j <= i; ++j) {
      const Twofold *a = &l[i * n], *b = &l[j * n];
      Twofold rest{mass(i, j), 0.0};
      for (Index k = 0; k < j; ++k) rest = minus_product(rest, a[k], b[k]);
      if (i == j && !(rest.high > 0.0)) return false;
      l[i * n + j] = i == j ? square_root(rest) : quotient(rest, b[j]);
    }
  }
  for (Index c = 0; c < jacobian_transpose.cols(); ++c) {
    for (Index i = 0; i < n; ++i) {
      x[i] = {jacobian_transpose(i, c), 0.0};
      for (Index k = 0; k < i; ++k) x[i] = minus_product(x[i], l[i * n + k], x[k]);
      x[i] = quotient(x[i], l[i * n + i]);
      jacobian_transpose(i, c) = x[i].high;
    }
  }
  return true;
}

}  // namespace signorini
