// Masks to the ramps of all levels, as bytes; see semloc_jax/perception/cost_maps.py.
#pragma once
#include <cstring>

#include "distance.h"

namespace semloc {

// One level of one channel: bytes 0 .. 254 span [-1, 1].
struct Level {
  uint8_t* bytes;
  int height, width, pitch, stride;
  float ramp_px;

  // Writes `count` pixels that all are as far outside (which they are already) or inside as distances go.
  SEMLOC_INLINE void write_flat(int y, int first, bool is_outside, int count) const {
    if (is_outside || y >= height || first >= width) return;
    std::memset(bytes + static_cast<int64_t>(y) * pitch + first, 0, std::min(count, width - first));
  }
  // Writes `count` pixels from distances in pixels of the full mask; what lies beyond the level is left out.
  SEMLOC_INLINE void write(int y, int first, const float* distance_px, int count) const {
    if (y >= height || first >= width) return;
    const float scale = 127.0f / ramp_px;
    uint8_t piece[kPiecePx];
    for (int x = 0; x < count; ++x) {
      const float value = least(greatest(distance_px[x] * scale, -127.0f), 127.0f);
      piece[x] = static_cast<uint8_t>(static_cast<int32_t>(value + 127.5f));
    }
    std::memcpy(bytes + static_cast<int64_t>(y) * pitch + first, piece, std::min(count, width - first));
  }
};

struct Box {
  int top, left, bottom, right;  // half open
};

// The smallest box with all pixels of a value; empty (bottom 0) where there is none.
inline Box box_of(const uint8_t* layers, int height, int width, uint8_t value) {
  Box box{height, width, 0, 0};
  std::vector<uint8_t> columns(width, 0);
  for (int y = 0; y < height; ++y) {
    const uint8_t* row = layers + static_cast<int64_t>(y) * width;
    uint8_t any = 0;
    for (int x = 0; x < width; ++x) {
      const uint8_t hit = row[x] == value;
      any |= hit, columns[x] |= hit;
    }
    if (any) box.top = std::min(box.top, y), box.bottom = y + 1;
  }
  for (int x = 0; x < width; ++x)
    if (columns[x]) box.left = std::min(box.left, x), box.right = x + 1;
  return box;
}

inline Box grown(Box box, int by, int step, int height, int width) {
  const auto down = [&](int value) { return std::max(value - by, 0) / step * step; };
  const auto up = [&](int value, int most) { return std::min((value + by + step - 1) / step * step, most); };
  return {down(box.top), down(box.left), up(box.bottom, height), up(box.right, width)};
}

// Pixels of a value in each block of stride x stride pixels of a row of blocks.
template <int kStride>
SEMLOC_INLINE void count_blocks(const uint8_t* rows, int pitch, uint8_t value, int stride, int width,
                                uint16_t* __restrict count) {
  const int size = kStride ? kStride : stride;
  for (int x = 0; x < width; ++x) {
    uint16_t sum = 0;
    for (int k = 0; k < size; ++k)
      for (int j = 0; j < size; ++j) sum += rows[static_cast<int64_t>(k) * pitch + x * size + j] == value;
    count[x] = sum;
  }
}

// Pixels of a value in a box, as binary and as covered share of blocks of stride x stride pixels.
inline void reduce(const uint8_t* layers, int width, Box box, uint8_t value, int stride, Image& inside, Image& share) {
  // Bytes may alias anything: what bounds a loop must be a local.
  const int area = stride * stride, count_x = inside.width;
  uint8_t shares[257];
  for (int n = 0; n <= area; ++n) shares[n] = static_cast<uint8_t>((510 * n + area) / (2 * area));
  std::vector<uint16_t> count(count_x);
  for (int y = 0; y < inside.height; ++y) {
    const uint8_t* __restrict from = layers + static_cast<int64_t>(box.top + y * stride) * width + box.left;
    uint8_t *__restrict set = inside.row(y), *__restrict covered = share.row(y);
    if (stride == 1) {
      for (int x = 0; x < count_x; ++x) set[x] = from[x] == value, covered[x] = from[x] == value ? 255 : 0;
      continue;
    }
    if (stride == 2) count_blocks<2>(from, width, value, stride, count_x, count.data());
    else count_blocks<0>(from, width, value, stride, count_x, count.data());
    // A quarter of the area is enough to be inside, so that thin lines survive.
    const uint16_t* __restrict counted = count.data();
    for (int x = 0; x < count_x; ++x) set[x] = 4 * counted[x] >= area;
    for (int x = 0; x < count_x; ++x) covered[x] = shares[counted[x]];
  }
}

// Writes the levels whose stride is a multiple of `stride` from the signed distance at that stride.
inline void write_levels(const uint8_t* layers, int height, int width, Box content, uint8_t value, int stride,
                         const Edge& edge, const std::vector<Level>& levels) {
  float reach_px = 0;
  int step = stride;
  for (const Level& level : levels) {
    reach_px = std::max(reach_px, level.ramp_px + level.stride);
    step = std::max(step, level.stride);
  }
  const int cap = static_cast<int>(std::ceil(reach_px / stride)) + 2;
  const Box box = grown(content, (cap + 1) * stride, step, height, width);
  Image inside((box.bottom - box.top) / stride, (box.right - box.left) / stride), share(inside.height, inside.width);
  reduce(layers, width, box, value, stride, inside, share);
  std::vector<std::vector<float>> sums;
  for (const Level& level : levels) sums.emplace_back(level.stride > stride ? inside.pitch * stride / level.stride : 0);
  signed_distance(inside, share, edge, cap, [&](int y, int first, float* distance, bool is_flat) {
    const int count = std::min(kPiecePx, inside.width - first);
    for (int x = 0; x < kPiecePx; ++x) distance[x] *= stride;
    for (size_t n = 0; n < levels.size(); ++n) {
      const Level& level = levels[n];
      const int factor = level.stride / stride;
      const int top = box.top / level.stride, left = box.left / level.stride;
      if (factor == 1) {
        if (is_flat) level.write_flat(top + y, left + first, distance[0] > 0.0f, count);
        else level.write(top + y, left + first, distance, count);
        continue;
      }
      float* sum = sums[n].data() + first / factor;
      if (y % factor == 0) std::fill(sum, sum + kPiecePx / factor, 0.0f);
      for (int x = 0; x < kPiecePx / factor; ++x)
        for (int k = 0; k < factor; ++k) sum[x] += distance[x * factor + k];
      if (y % factor == factor - 1) {
        for (int x = 0; x < kPiecePx / factor; ++x) sum[x] /= factor * factor;
        level.write(top + y / factor, left + first / factor, sum, count / factor);
      }
    }
  });
}

}  // namespace semloc
