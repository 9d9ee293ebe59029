// Bilinear lookup in the packed cost maps; see semloc_jax/residuals/texture.py for the layout.
#pragma once
#include <cstdint>

#include "inline.h"

namespace semloc {

// One level of the cost maps of one camera.
struct Texture {
  const uint32_t* texels;  // of the camera's first channel
  int32_t size;            // texels of a channel
  int32_t width;
  float scale, last_x, last_y, unit, per_px;

  Texture(const uint32_t* all, int32_t start, int32_t height, int32_t width_, float stride, int32_t image)
      : texels(all + start + static_cast<int64_t>(image) * height * width_), size(height * width_), width(width_),
        scale(1.0f / stride), last_x(width_ - 1.001f), last_y(height - 1.001f), unit(1.0f / 127.0f),
        per_px(1.0f / (127.0f * stride)) {}
};

struct Sample {
  float value, du, dv;
};

// max(a, 0) that sends NaN to 0.
SEMLOC_INLINE float clamp(float a, float high) { return least(a > 0.0f ? a : 0.0f, high); }

// Where a pixel falls: the texel and the two fractions.
struct Texel {
  int32_t index;
  float fu, fv;
};

SEMLOC_INLINE Texel locate(const Texture& texture, int32_t channel, float u, float v) {
  const float x = clamp((u + 0.5f) * texture.scale - 0.5f, texture.last_x);
  const float y = clamp((v + 0.5f) * texture.scale - 0.5f, texture.last_y);
  const int32_t column = static_cast<int32_t>(x), row = static_cast<int32_t>(y);
  return {channel * texture.size + row * texture.width + column, x - column, y - row};
}

SEMLOC_INLINE Sample blend(const Texture& texture, uint32_t quad, float fu, float fv) {
  const float a = static_cast<float>(static_cast<int32_t>(quad & 255));
  const float b = static_cast<float>(static_cast<int32_t>(quad >> 8 & 255));
  const float c = static_cast<float>(static_cast<int32_t>(quad >> 16 & 255));
  const float d = static_cast<float>(static_cast<int32_t>(quad >> 24));
  const float top = a + fu * (b - a), bottom = c + fu * (d - c);
  const float across = (b - a) + fv * ((d - c) - (b - a));
  return {(top + fv * (bottom - top) - 127.0f) * texture.unit, across * texture.per_px,
          (bottom - top) * texture.per_px};
}

// Ramp values as bytes, 127 for 0; values beyond +-1 are clipped, NaN becomes the lowest.
inline void quantise(const float* ramp, int64_t count, uint8_t* byte) {
  for (int64_t n = 0; n < count; ++n)
    byte[n] = static_cast<uint8_t>(static_cast<int32_t>(__builtin_rintf(clamp(ramp[n] + 1.0f, 2.0f) * 127.0f)));
}

// The four taps of each pixel side by side; neighbours come from the flat array.
inline void interleave(const uint8_t* byte, int64_t width, int64_t count, uint32_t* texel) {
  const uint8_t* below = byte + width;
  for (int64_t n = 0; n < count; ++n) {
    const uint32_t a = byte[n], b = byte[n + 1], c = below[n], d = below[n + 1];
    texel[n] = a | b << 8 | c << 16 | d << 24;
  }
}

}  // namespace semloc
