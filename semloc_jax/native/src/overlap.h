// How much of a plan falls on itself when it is shifted along either axis; see semloc_jax/alignment/aliases.py.
#pragma once
#include <algorithm>
#include <cstdint>
#include <vector>

#include "inline.h"

namespace semloc {

// A plan of cells that is searched along one axis, whose cells lie side by side, and a few cells across it. Its memory
// holds zeros before and, once all that was added is cleared, again: the next plan of the thread uses it as it is.
class PlanRows {
 public:
  PlanRows(int num_along, int num_across, int reach, int band, std::vector<float>& zeros)
      : reach_(reach), band_(band), pitch_(num_along + 2 * reach), cells_(zeros) {
    const size_t size = static_cast<size_t>(pitch_) * (num_across + 2 * band);
    if (cells_.size() < size) cells_.resize(size);
  }

  void add(int along, int across, float length) { *at(along, across) += length; }
  void clear(int along, int across) { *at(along, across) = 0.0f; }
  // Adds what lies at each shift from a cell to sums [2 band + 1, 2 reach + 1].
  SEMLOC_INLINE void add_shifted(int along, int across, float length, float* __restrict sums) const {
    const int count = 2 * reach_ + 1;
    for (int beside = -band_; beside <= band_; ++beside, sums += count) {
      const float* __restrict from = at(along, across + beside) - reach_;
      for (int shift = 0; shift < count; ++shift) sums[shift] += length * from[shift];
    }
  }

 private:
  float* at(int along, int across) { return cells_.data() + int64_t{pitch_} * (across + band_) + along + reach_; }
  const float* at(int along, int across) const { return const_cast<PlanRows*>(this)->at(along, across); }

  int reach_, band_, pitch_;
  std::vector<float>& cells_;
};

}  // namespace semloc
