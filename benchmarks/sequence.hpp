// Sequences of contact problems on disk: what a simulator asked of the solver, step after step, to be asked again.
// A file is the magic word, then for each step, in the byte order of the machine that wrote it:
//     int32   num_sets, num_blocks
//     num_sets x   { int32 type; double friction, lower, upper; }
//     num_blocks x { int32 i, j; }                     pairs of sets, as BlockDelassus::reset takes them
//     double  diagonal blocks, then blocks, column-major; free velocity; compliance; guess, n values each
#pragma once

#include <cstdint>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "signorini/delassus/block.hpp"

namespace signorini::benchmarks {

constexpr char kMagic[] = "signorini steps 1\n";

/// One step: all that a solver is given.
struct Step {
  ConstraintSets sets;
  std::vector<BlockDelassus::Pair> blocks;
  BlockDelassus delassus;
  GrowVector free_velocity, compliance, guess;
};

class SequenceWriter {
 public:
  explicit SequenceWriter(const std::string& path) : out_(path, std::ios::binary) {
    out_.write(kMagic, sizeof kMagic - 1);
    if (!out_) throw std::runtime_error("cannot write " + path);
  }

  void write(const ConstraintSets& sets, const BlockDelassus& delassus, const ConstVectorRef& free_velocity,
             const ConstVectorRef& compliance, const ConstVectorRef& guess) {
    put(static_cast<std::int32_t>(sets.num_sets())), put(static_cast<std::int32_t>(delassus.num_blocks()));
    for (const ConstraintSet& set : sets)
      put(static_cast<std::int32_t>(set.type)), put(set.friction), put(set.lower), put(set.upper);
    for (Index k = 0; k < delassus.num_blocks(); ++k)
      put(static_cast<std::int32_t>(delassus.pair(k).first)), put(static_cast<std::int32_t>(delassus.pair(k).second));
    for (Index i = 0; i < sets.num_sets(); ++i) put(delassus.diagonal_block(i), sets[i].size() * sets[i].size());
    for (Index k = 0; k < delassus.num_blocks(); ++k)
      put(delassus.block(k), sets[delassus.pair(k).first].size() * sets[delassus.pair(k).second].size());
    for (const ConstVectorRef* v : {&free_velocity, &compliance, &guess}) put(v->data(), v->size());
  }

 private:
  template <typename T>
  void put(T value) {
    out_.write(reinterpret_cast<const char*>(&value), sizeof value);
  }
  void put(const double* values, Index count) {
    out_.write(reinterpret_cast<const char*>(values), count * static_cast<Index>(sizeof(double)));
  }

  std::ofstream out_;
};

class SequenceReader {
 public:
  explicit SequenceReader(const std::string& path) : path_(path), in_(path, std::ios::binary) {
    char magic[sizeof kMagic - 1];
    in_.read(magic, sizeof magic);
    if (!in_ || std::memcmp(magic, kMagic, sizeof magic) != 0) throw std::runtime_error(path + ": not a sequence");
  }

  /// False at the end of the file.
  bool read(Step& step) {
    if (in_.peek() == std::ifstream::traits_type::eof()) return false;
    const auto num_sets = get<std::int32_t>(), num_blocks = get<std::int32_t>();
    if (num_sets < 0 || num_blocks < 0) throw std::runtime_error(path_ + ": damaged");
    step.sets.clear();
    for (std::int32_t i = 0; i < num_sets; ++i) {
      ConstraintSet set;
      const auto type = get<std::int32_t>();
      if (type < 0 || type > static_cast<std::int32_t>(SetType::Equality))
        throw std::runtime_error(path_ + ": unknown set");
      set.type = static_cast<SetType>(type);
      set.friction = get<double>(), set.lower = get<double>(), set.upper = get<double>();
      step.sets.add(set);
    }
    step.blocks.clear();
    for (std::int32_t k = 0; k < num_blocks; ++k) {
      const auto i = get<std::int32_t>(), j = get<std::int32_t>();
      step.blocks.emplace_back(i, j);
    }
    step.delassus.reset(step.sets, step.blocks);
    for (Index i = 0; i < num_sets; ++i)
      get(step.delassus.diagonal_block(i), step.sets[i].size() * step.sets[i].size());
    for (Index k = 0; k < num_blocks; ++k)
      get(step.delassus.block(k), step.sets[step.blocks[k].first].size() * step.sets[step.blocks[k].second].size());
    for (GrowVector* v : {&step.free_velocity, &step.compliance, &step.guess}) {
      v->resize(step.sets.size());
      get(v->data(), v->size());
    }
    return true;
  }

 private:
  template <typename T>
  T get() {
    T value;
    in_.read(reinterpret_cast<char*>(&value), sizeof value);
    if (!in_) throw std::runtime_error(path_ + ": ends within a step");
    return value;
  }
  void get(double* values, Index count) {
    in_.read(reinterpret_cast<char*>(values), count * static_cast<Index>(sizeof(double)));
    if (!in_) throw std::runtime_error(path_ + ": ends within a step");
  }

  std::string path_;
  std::ifstream in_;
};

}  // namespace signorini::benchmarks
