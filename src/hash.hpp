#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

namespace signorini {

constexpr std::uint64_t kHashStart = 14695981039346656037u;

/// FNV-1a of 64 bits, going on from a hash. A change within one byte always changes it.
inline std::uint64_t fnv1a(const void* data, std::size_t size, std::uint64_t hash = kHashStart) {
  const auto* bytes = static_cast<const unsigned char*>(data);
  for (std::size_t i = 0; i < size; ++i) hash = (hash ^ bytes[i]) * 1099511628211u;
  return hash;
}

/// The same of words of eight bytes, then of the bytes that are left: eight times as fast.
inline std::uint64_t fnv1a_of_words(const void* data, std::size_t size) {
  const auto* bytes = static_cast<const unsigned char*>(data);
  std::uint64_t hash = kHashStart;
  std::size_t i = 0;
  for (; i + 8 <= size; i += 8) {
    std::uint64_t word;
    std::memcpy(&word, bytes + i, 8);
    hash = (hash ^ word) * 1099511628211u;
  }
  return fnv1a(bytes + i, size - i, hash);
}

}  // namespace signorini
