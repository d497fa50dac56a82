// Counts what the whole process takes from the heap: `new`, Eigen and Coal all end in malloc. A file that includes this
// is a test program of its own (CMakeLists.txt). Under a sanitizer SIGNORINI_COUNTS_ALLOCATIONS is 0.
#pragma once

#include <cstdlib>

#if defined(__SANITIZE_ADDRESS__) || !defined(__GLIBC__)
#define SIGNORINI_COUNTS_ALLOCATIONS 0
#else
#define SIGNORINI_COUNTS_ALLOCATIONS 1
namespace {
long allocations = 0;
}
extern "C" {
void* __libc_malloc(std::size_t);
void* __libc_realloc(void*, std::size_t);
void* __libc_calloc(std::size_t, std::size_t);
void* __libc_memalign(std::size_t, std::size_t);
void* malloc(std::size_t size) { return ++allocations, __libc_malloc(size); }
void* realloc(void* p, std::size_t size) { return ++allocations, __libc_realloc(p, size); }
void* calloc(std::size_t n, std::size_t size) { return ++allocations, __libc_calloc(n, size); }
void* aligned_alloc(std::size_t a, std::size_t size) { return ++allocations, __libc_memalign(a, size); }
}
#endif
