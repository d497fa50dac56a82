#include "twofold_cholesky.hpp"

#include <cmath>
#include <vector>

namespace signorini {
namespace {

Twofold sum(double a, double b) {  // exact (Knuth)
  const double s = a + b, t = s - a;
  return {s, (a - (s - t)) + (b - t)};
}

/// a - b c
Twofold minus_product(Twofold a, Twofold b, Twofold c) {
  const double p = b.high * c.high;
  const double rest = std::fma(b.high, c.high, -p) + (b.high * c.low + b.low * c.high);
  const Twofold s = sum(a.high, -p);
  return sum(s.high, s.low + (a.low - rest));
}

Twofold quotient(Twofold a, Twofold b) {
  const double q = a.high / b.high;
  const Twofold rest = minus_product(a, {q, 0.0}, b);
  return sum(q, (rest.high + rest.low) / b.high);
}

Twofold square_root(Twofold a) {
  const double r = std::sqrt(a.high);
  const Twofold rest = minus_product(a, {r, 0.0}, {r, 0.0});
  return sum(r, (rest.high + rest.low) / (2.0 * r));
}

}  // namespace

bool TwofoldCholesky::factor(const Matrix& mass) {
  size_ = mass.rows();
  const Index n = size_;
  l_.assign(static_cast<std::size_t>(n * n), {});
  for (Index i = 0; i < n; ++i) {
    for (Index j = 0; j <= i; ++j) {
      const Twofold *a = &l_[i * n], *b = &l_[j * n];
      Twofold rest{mass(i, j), 0.0};
      for (Index k = 0; k < j; ++k) rest = minus_product(rest, a[k], b[k]);
      if (i == j && !(rest.high > 0.0)) return false;
      l_[i * n + j] = i == j ? square_root(rest) : quotient(rest, b[j]);
    }
  }
  return true;
}

void TwofoldCholesky::solve(Vector& rhs) {
  const Index n = size_;
  std::vector<Twofold>& x = x_;
  x.resize(static_cast<std::size_t>(n));
  Index first = 0;  // of what is not 0
  while (first < n && rhs[first] == 0.0) x[first++] = {};
  for (Index i = first; i < n; ++i) {
    x[i] = {rhs[i], 0.0};
    for (Index k = first; k < i; ++k) x[i] = minus_product(x[i], l_[i * n + k], x[k]);
    x[i] = quotient(x[i], l_[i * n + i]);
  }
  for (Index i = n - 1; i >= 0; --i) {
    for (Index k = i + 1; k < n; ++k) x[i] = minus_product(x[i], l_[k * n + i], x[k]);
    x[i] = quotient(x[i], l_[i * n + i]);
    rhs[i] = x[i].high;
  }
}

}  // namespace signorini
