#pragma once

#include <Eigen/Core>

namespace signorini {

/// While one lives, an allocation by Eigen fails an assertion, if built with SIGNORINI_NO_MALLOC (and with it
/// EIGEN_RUNTIME_NO_MALLOC, without NDEBUG); else nothing. Solvers hold one around their iterations.
class NoMalloc {
 public:
#ifdef SIGNORINI_NO_MALLOC
  NoMalloc() : before_(Eigen::internal::is_malloc_allowed()) { Eigen::internal::set_is_malloc_allowed(false); }
  ~NoMalloc() { Eigen::internal::set_is_malloc_allowed(before_); }

 private:
  bool before_;

 public:
#else
  NoMalloc() {}
#endif
  NoMalloc(const NoMalloc&) = delete;
  NoMalloc& operator=(const NoMalloc&) = delete;
};

/// While one lives, allocations are allowed again: what records a history needs them.
class AllowMalloc {
 public:
#ifdef SIGNORINI_NO_MALLOC
  AllowMalloc() : before_(Eigen::internal::is_malloc_allowed()) { Eigen::internal::set_is_malloc_allowed(true); }
  ~AllowMalloc() { Eigen::internal::set_is_malloc_allowed(before_); }

 private:
  bool before_;

 public:
#else
  AllowMalloc() {}
#endif
  AllowMalloc(const AllowMalloc&) = delete;
  AllowMalloc& operator=(const AllowMalloc&) = delete;
};

}  // namespace signorini
