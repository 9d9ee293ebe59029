// Batched operands of an XLA custom call, and the loop over a batch on the threads of XLA.
#pragma once
#include <algorithm>
#include <array>
#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <vector>

#include "frame.h"

namespace semloc {

constexpr int kMaxBatchRank = 4;

// Axes that jax.vmap put in front of every operand; an operand that is the same for all has length 1 there.
struct Batch {
  int rank = 0;
  std::array<int64_t, kMaxBatchRank> shape{};
  int64_t size = 1;

  Batch(const Buffer& result, int core_rank) {
    const auto dims = result.dimensions();
    rank = static_cast<int>(dims.size()) - core_rank;
    for (int k = 0; k < rank && k < kMaxBatchRank; ++k) size *= shape[k] = dims[k];
  }
};

// One operand: where each item of the batch has its data.
template <typename T>
struct Operand {
  const T* data = nullptr;
  std::array<int64_t, kMaxBatchRank> stride{};
  int64_t length = 1;    // of the last core axis
  bool is_shared = true;  // one value for the whole batch

  Operand() = default;
  Operand(const Buffer& buffer, const Batch& batch) : data(static_cast<const T*>(buffer.data())) {
    const auto dims = buffer.dimensions();
    if (dims.size() > 0) length = dims.back();
    int64_t step = 1;
    for (int k = static_cast<int>(dims.size()) - 1; k >= 0; --k) {
      if (k < batch.rank && dims[k] > 1) stride[k] = step, is_shared = false;
      step *= dims[k];
    }
  }

  const T* at(const Batch& batch, int64_t item) const {
    if (is_shared) return data;
    int64_t offset = 0;
    for (int k = batch.rank - 1; k >= 0; --k) {
      offset += (item % batch.shape[k]) * stride[k];
      item /= batch.shape[k];
    }
    return data + offset;
  }
};

// One piece of work for each item, as a pointer: the loops over a batch are compiled once, not for every kernel.
struct Work {
  const void* of;
  void (*call)(const void* of, int64_t item);
  void operator()(int64_t item) const { call(of, item); }
};

// Calls work(item) for every item. The caller works too and waits only for pieces in progress, so that a pool whose
// threads all wait here cannot lock up; pieces that find nothing left return at once.
inline void share_items(const Call& pool, int64_t num_items, int64_t points_per_item, const Work work) {
  constexpr int64_t kPointsPerPiece = 16384;
  const int64_t piece = std::max<int64_t>(1, kPointsPerPiece / std::max<int64_t>(points_per_item, 1));
  const int64_t helpers = std::min<int64_t>(pool.num_threads() - 1, (num_items - 1) / piece);
  if (helpers <= 0) {
    for (int64_t item = 0; item < num_items; ++item) work(item);
    return;
  }
  struct Shared {
    std::atomic<int64_t> next{0};
    int64_t busy = 0;
    bool closed = false;
    std::mutex mutex;
    std::condition_variable idle;
  };
  auto shared = std::make_shared<Shared>();
  const auto drain = [work, num_items, piece](Shared& state) {
    for (int64_t first; (first = state.next.fetch_add(piece)) < num_items;)
      for (int64_t item = first; item < std::min(first + piece, num_items); ++item) work(item);
  };
  using Drain = decltype(drain);
  struct Piece {
    std::shared_ptr<Shared> shared;
    const Drain* drain;
  };
  for (int64_t k = 0; k < helpers; ++k) {
    // `drain` refers to the caller's frame: it is touched only between joining and leaving, while the caller waits.
    auto own = std::make_unique<Piece>(Piece{shared, &drain});
    const auto run = [](void* data) {
      const std::unique_ptr<Piece> piece(static_cast<Piece*>(data));
      Shared& state = *piece->shared;
      {
        std::lock_guard<std::mutex> lock(state.mutex);
        if (state.closed) return;
        ++state.busy;
      }
      (*piece->drain)(state);
      std::lock_guard<std::mutex> lock(state.mutex);
      if (--state.busy == 0) state.idle.notify_all();
    };
    if (pool.schedule(run, own.get())) own.release();
  }
  drain(*shared);
  std::unique_lock<std::mutex> lock(shared->mutex);
  shared->closed = true;
  shared->idle.wait(lock, [&] { return shared->busy == 0; });
}

template <typename Function>
void for_each_item(const Call& pool, int64_t num_items, int64_t points_per_item, const Function& function) {
  const auto call = [](const void* of, int64_t item) { (*static_cast<const Function*>(of))(item); };
  share_items(pool, num_items, points_per_item, {&function, call});
}

}  // namespace semloc
