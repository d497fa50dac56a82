#pragma once

#include <memory>

#include "difference.hpp"

namespace signorini {

/// What a pair remembers of the last step to start the next search from; changes the effort, and the last bits.
struct PairMemory {
  Vector3 guess = Vector3::UnitX();  ///< closest point of the difference a - b, in the frame of a
  int hint_a = 0, hint_b = 0;        ///< support vertices
};

/// GJK, and EPA where the cores overlap: Coal's, with our support functions. Holds work space: one a thread.
class ClosestSearch {
 public:
  enum Outcome { Apart, Found, Failed };

  Vector3 normal = Vector3::Zero(), middle = Vector3::Zero();  ///< if Found: roughly, in the frame of a
  double farthest = 0.0;  ///< if Found: the cores are no farther apart than this; infinity where they overlap

  ClosestSearch();
  ~ClosestSearch();

  /// Apart if a plane holds the cores more than `reach` apart. `scale` [m]: size of the smaller shape.
  Outcome run(const Difference& difference, double reach, double scale, PairMemory& memory);

 private:
  struct Methods;
  std::unique_ptr<Methods> methods_;
};

}  // namespace signorini
