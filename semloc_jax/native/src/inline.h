// What the vectoriser needs: everything inlined into the loop, and minima without references or branches.
#pragma once

#define SEMLOC_INLINE inline __attribute__((always_inline))

namespace semloc {

SEMLOC_INLINE float least(float a, float b) { return a < b ? a : b; }
SEMLOC_INLINE float greatest(float a, float b) { return a > b ? a : b; }

}  // namespace semloc
