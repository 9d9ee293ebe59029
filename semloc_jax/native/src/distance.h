// Signed distance to the border of a binary image within a band; see semloc_jax/perception/distance.py.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "inline.h"

namespace semloc {

constexpr int kPiecePx = 64;  // pixels side by side

// Memory that the next one of this thread uses again: the system clears every page of new memory at its first touch.
template <typename T>
class Reused {
 public:
  explicit Reused(size_t size) {
    if (!spare().empty()) values_ = std::move(spare().back()), spare().pop_back();
    values_.assign(size, 0);
  }
  Reused(Reused&& other) = default;
  Reused(const Reused&) = delete;
  ~Reused() {
    if (values_.capacity() > 0 && spare().size() < 8) spare().push_back(std::move(values_));
  }
  T* data() { return values_.data(); }
  const T* data() const { return values_.data(); }

 private:
  static std::vector<std::vector<T>>& spare() {
    thread_local std::vector<std::vector<T>> kept;
    return kept;
  }
  std::vector<T> values_;
};

// A grey image in one piece of memory whose rows are a whole number of pieces.
struct Image {
  int height, width, pitch;
  Reused<uint8_t> values;

  Image(int height_, int width_)
      : height(height_), width(width_), pitch((width_ + kPiecePx - 1) / kPiecePx * kPiecePx),
        values(static_cast<size_t>(height_) * pitch) {}
  uint8_t* row(int y) { return values.data() + static_cast<int64_t>(y) * pitch; }
  const uint8_t* row(int y) const { return values.data() + static_cast<int64_t>(y) * pitch; }
  const uint8_t* near_row(int y) const { return row(std::clamp(y, 0, height - 1)); }
};

// Minimum of an entry and one more than its neighbour in the row before.
SEMLOC_INLINE void pass_on(const uint8_t* __restrict before, uint8_t* __restrict row, int count) {
  for (int x = 0; x < count; ++x) {
    const uint8_t next = static_cast<uint8_t>(before[x] + 1);
    row[x] = next < row[x] ? next : row[x];
  }
}

// Rows to the nearest pixel of the given value in the same column, at most `cap`.
inline Image rows_to(const Image& inside, uint8_t value, uint8_t cap) {
  Image out(inside.height, inside.width);
  const int pitch = inside.pitch;
  for (int y = 0; y < inside.height; ++y) {
    const uint8_t* __restrict from = inside.row(y);
    uint8_t* __restrict to = out.row(y);
    for (int x = 0; x < pitch; ++x) to[x] = from[x] == value ? 0 : cap;
    // What pads a row is no part of the image.
    std::fill(to + out.width, to + out.pitch, cap);
    if (y) pass_on(out.row(y - 1), to, pitch);
  }
  for (int y = inside.height - 2; y >= 0; --y) pass_on(out.row(y + 1), out.row(y), pitch);
  return out;
}

// Squared distances along one row from the distances along the columns; both ends padded by `cap` pixels.
class RowDistance {
 public:
  RowDistance(int pitch, int cap) : cap_(cap), squared_(pitch + 2 * cap + kPiecePx), least_(pitch / kPiecePx + 2) {}

  void set(const uint8_t* rows, int pitch) {
    const uint16_t far = static_cast<uint16_t>(cap_ * cap_);
    std::fill(squared_.begin(), squared_.end(), far);
    std::fill(least_.begin(), least_.end(), static_cast<uint8_t>(cap_));
    for (int x = 0; x < pitch; ++x) squared_[cap_ + x] = static_cast<uint16_t>(rows[x] * rows[x]);
    for (int piece = 0; piece < pitch / kPiecePx; ++piece) {
      uint8_t least = 255;
      for (int x = 0; x < kPiecePx; ++x) least = rows[piece * kPiecePx + x] < least ? rows[piece * kPiecePx + x] : least;
      least_[piece + 1] = least;
    }
  }
  // Whether every pixel of the piece is at least `cap` away (the cap is no longer than three pieces).
  bool is_far(int piece) const {
    const int reach = (cap_ + kPiecePx - 1) / kPiecePx;
    const int first = std::max(piece + 1 - reach, 0), last = std::min<int>(piece + 1 + reach, least_.size() - 1);
    return *std::min_element(least_.begin() + first, least_.begin() + last + 1) >= cap_;
  }
  // Distances of one piece [px].
  SEMLOC_INLINE void distances(int piece, float* out) const {
    uint16_t nearest[kPiecePx];
    const uint16_t* centre = squared_.data() + cap_ + piece * kPiecePx;
    for (int x = 0; x < kPiecePx; ++x) nearest[x] = centre[x];
    for (int d = 1; d < cap_; ++d) {
      const uint16_t step = static_cast<uint16_t>(d * d);
      for (int x = 0; x < kPiecePx; ++x) {
        const uint16_t left = centre[x - d], right = centre[x + d];
        const uint16_t other = static_cast<uint16_t>((left < right ? left : right) + step);
        nearest[x] = other < nearest[x] ? other : nearest[x];
      }
    }
    for (int x = 0; x < kPiecePx; ++x) out[x] = std::sqrt(static_cast<float>(nearest[x]));
  }

 private:
  int cap_;
  std::vector<uint16_t> squared_;
  std::vector<uint8_t> least_;
};

// Squares of 2 x 2 pixels between two rows, the square of columns x - 1 and x at x: 1 full, 2 empty. The border repeats.
SEMLOC_INLINE void squares(const uint8_t* __restrict above, const uint8_t* __restrict below, int width,
                           uint8_t* __restrict all, uint8_t* __restrict any, uint8_t* __restrict square) {
  for (int x = 0; x < width; ++x) all[x] = above[x] & below[x], any[x] = above[x] | below[x];
  square[0] = all[0] | static_cast<uint8_t>((any[0] ^ 1) << 1);
  for (int x = 1; x < width; ++x) {
    const uint8_t full = all[x - 1] & all[x], some = any[x - 1] | any[x];
    square[x] = full | static_cast<uint8_t>((some ^ 1) << 1);
  }
  square[width] = all[width - 1] | static_cast<uint8_t>((any[width - 1] ^ 1) << 1);
}

SEMLOC_INLINE void join(const uint8_t* __restrict a, const uint8_t* __restrict b, uint8_t* __restrict out, int count) {
  for (int x = 0; x < count; ++x) out[x] = a[x] | b[x];
}

// Where the image, or a gap in it, holds no 2 x 2 pixels, and the pixels about; 0 or 1.
inline Image thin_parts(const Image& inside) {
  const int width = inside.width;
  Image lost(inside.height, width), thin(inside.height, width);
  std::vector<uint8_t> all(width), any(width), square(width + 2), above(width), below(width), near(width + 2);
  for (int y = 0; y <= inside.height; ++y) {
    squares(inside.near_row(y - 1), inside.near_row(y), width, all.data(), any.data(), square.data());
    std::swap(above, below);
    join(square.data(), square.data() + 1, below.data(), width);
    if (y == 0) continue;
    const uint8_t *__restrict from = inside.row(y - 1), *__restrict over = above.data(), *__restrict under = below.data();
    uint8_t* __restrict to = lost.row(y - 1);
    for (int x = 0; x < width; ++x) {
      const uint8_t held = over[x] | under[x], own = from[x] ? held : static_cast<uint8_t>(held >> 1);
      to[x] = (own & 1) ^ 1;
    }
  }
  for (int y = 0; y < inside.height; ++y) {
    join(lost.near_row(y - 1), lost.near_row(y + 1), near.data() + 1, width);
    join(near.data() + 1, lost.row(y), square.data() + 1, width);
    square[0] = 0, square[width + 1] = 0;
    join(square.data(), square.data() + 1, near.data(), width);
    join(near.data(), square.data() + 2, thin.row(y), width);
  }
  return thin;
}

// How a covered share becomes a distance near the border: blur, then the level of a smoothed straight edge.
struct Edge {
  float blur_px;
  const float *keep, *add;  // for each level of 256: weight of the plain distance, weighted edge distance [px]
  float half, outset;       // from the nearest centre of the other side to the border; how far that lies outside
};

// Gaussian smoothing of a grey image, one row after another.
class Smoothing {
 public:
  Smoothing(const Image& share, float sigma)
      : reach_(std::max(1, static_cast<int>(std::lround(3 * sigma)))), share_(share),
        across_(static_cast<size_t>(share.height) * share.pitch) {
    float sum = 0;
    for (int k = -reach_; k <= reach_; ++k) sum += std::exp(-0.5f * k * k / (sigma * sigma));
    int rest = 256;
    for (int k = 1; k <= reach_; ++k) {
      tap_[k] = static_cast<uint16_t>(std::lround(256 * std::exp(-0.5f * k * k / (sigma * sigma)) / sum));
      rest -= 2 * tap_[k];
    }
    tap_[0] = static_cast<uint16_t>(rest);
    std::vector<uint8_t> padded(share.pitch + 2 * reach_);
    for (int y = 0; y < share.height; ++y) {
      const uint8_t* from = share.row(y);
      std::fill(padded.begin(), padded.begin() + reach_, from[0]);
      std::copy(from, from + share.width, padded.begin() + reach_);
      std::fill(padded.begin() + reach_ + share.width, padded.end(), from[share.width - 1]);
      uint16_t* to = across_.data() + static_cast<int64_t>(y) * share.pitch;
      const uint8_t* centre = padded.data() + reach_;
      for (int x = 0; x < share.pitch; ++x) to[x] = static_cast<uint16_t>(tap_[0] * centre[x]);
      for (int k = 1; k <= reach_; ++k)
        for (int x = 0; x < share.pitch; ++x) to[x] += static_cast<uint16_t>(tap_[k] * (centre[x - k] + centre[x + k]));
    }
  }
  static bool fits(float sigma) { return sigma > 0 && std::lround(3 * sigma) <= kMostReach; }

  SEMLOC_INLINE void levels(int y, int first, uint8_t* out) const {
    uint32_t sum[kPiecePx];
    for (int x = 0; x < kPiecePx; ++x) sum[x] = 32768u + tap_[0] * static_cast<uint32_t>(at(y)[first + x]);
    for (int k = 1; k <= reach_; ++k) {
      const uint16_t *above = at(y - k) + first, *below = at(y + k) + first;
      for (int x = 0; x < kPiecePx; ++x) sum[x] += tap_[k] * (static_cast<uint32_t>(above[x]) + below[x]);
    }
    for (int x = 0; x < kPiecePx; ++x) out[x] = static_cast<uint8_t>(sum[x] >> 16);
  }

 private:
  static constexpr int kMostReach = 7;
  const uint16_t* at(int y) const {
    return across_.data() + static_cast<int64_t>(std::clamp(y, 0, share_.height - 1)) * share_.pitch;
  }
  int reach_;
  const Image& share_;
  uint16_t tap_[kMostReach + 1];
  Reused<uint16_t> across_;
};

// Whether any of the pixels of a piece is set, and whether all are.
SEMLOC_INLINE void look_at(const uint8_t* __restrict set, bool* any, bool* all) {
  uint8_t some = 0, every = 1;
  for (int x = 0; x < kPiecePx; ++x) some |= set[x], every &= set[x];
  *any = some, *all = every;
}

// Calls `take(y, first_x, float distance[kPiecePx], is_flat)` for every piece of the signed distance [px of this
// image], negative inside and clipped to +-cap, of an image given as binary and as covered share; flat: +cap or -cap.
template <typename Take>
void signed_distance(const Image& inside, const Image& share, const Edge& edge, int cap, Take take) {
  const Image outward = rows_to(inside, 1, static_cast<uint8_t>(cap)), inward = rows_to(inside, 0, static_cast<uint8_t>(cap));
  const Image thin = thin_parts(inside);
  const Smoothing smoothing(share, edge.blur_px);
  RowDistance out_row(inside.pitch, cap), in_row(inside.pitch, cap);
  float out[kPiecePx], in[kPiecePx];
  uint8_t level[kPiecePx];
  for (int y = 0; y < inside.height; ++y) {
    out_row.set(outward.row(y), inside.pitch);
    in_row.set(inward.row(y), inside.pitch);
    for (int piece = 0; piece < inside.pitch / kPiecePx; ++piece) {
      const int first = piece * kPiecePx;
      const bool is_out = out_row.is_far(piece), is_flat = is_out || in_row.is_far(piece);
      if (is_flat) {
        std::fill(out, out + kPiecePx, is_out ? cap : -cap);
      } else {
        const uint8_t *set = inside.row(y) + first, *is_thin = thin.row(y) + first;
        bool any, all;
        look_at(set, &any, &all);
        // Nothing is as near to a pixel as itself.
        if (all) std::fill(out, out + kPiecePx, 0.0f);
        else out_row.distances(piece, out);
        if (any) in_row.distances(piece, in);
        else std::fill(in, in + kPiecePx, 0.0f);
        smoothing.levels(y, first, level);
        for (int x = 0; x < kPiecePx; ++x) {
          const float plain = out[x] - in[x] + (set[x] ? edge.half + edge.outset : edge.outset - edge.half);
          const float near = plain * edge.keep[level[x]] + edge.add[level[x]];
          out[x] = is_thin[x] ? plain : near;
        }
      }
      take(y, first, out, is_flat);
    }
  }
}

}  // namespace semloc
