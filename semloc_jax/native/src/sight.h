// Which samples of the map a camera sees, and how: what `view` and `observe` begin with.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "alignment.h"

namespace semloc {

// Samples of the local map, each row in the order of MapSamples.
struct MapSamples {
  const float *p, *tangent, *offset, *length;
  const int32_t *label, *kind, *element;
  const float *center, *height_sigma;
  const uint8_t* valid;
  int count;
};

// What labels mean: the channel of each (negative: no mask shows it), the factor on its weight; the first `num_ground`
// are painted on the ground.
struct Labels {
  const int32_t* channel;
  const float* weight;
  int num_ground;
};

constexpr int32_t kRound = 1, kCorner = 2;  // SampleKind
constexpr float kLongestPx = 50;

SEMLOC_INLINE float length_of(float a, float b) { return std::sqrt(a * a + b * b); }

// What the camera makes of each sample that can count.
struct Sighting {
  int32_t index;
  float offset[3], length_px, height_px, u, v, range;
};

// Where samples may lie in the image and how far away.
struct Limits {
  float low, high_u, high_v, max_range;
};

// A camera at a pose: where it is in the map, and the motion from there into it.
struct Stand {
  float position[3], ground_z;
  Motion T;

  Stand(const float* T_local_base, const float* T_base_cam) : T(T_local_base) {
    const Motion base(T_local_base), mount(T_base_cam);
    const Position at = base.apply(mount.t[0], mount.t[1], mount.t[2]);
    position[0] = at.x, position[1] = at.y, position[2] = at.z, ground_z = base.t[2];
    for (int i = 0; i < 3; ++i) {
      T.t[i] = 0;
      for (int j = 0; j < 3; ++j) {
        T.R[i][j] = 0;
        for (int k = 0; k < 3; ++k) T.R[i][j] += mount.R[k][i] * base.R[j][k];
        T.t[i] -= T.R[i][j] * position[j];
      }
    }
  }
};

// Samples that may be seen, in their order. All are looked at side by side and doubt speaks for them, so that
// `look_closely`, which decides, is asked about few: most samples of a map lie out of the image.
template <typename Camera>
__attribute__((noinline)) void may_be_seen(const Camera& camera, const Motion& T, const MapSamples& samples,
                                           const Labels& labels, const Limits& limits, std::vector<int32_t>& found) {
  constexpr float kSlackPx = 1.0f, kSlackM = 0.01f;  // above all rounding
  const float low = limits.low - kSlackPx, high_u = limits.high_u + kSlackPx, high_v = limits.high_v + kSlackPx;
  const float reach = limits.max_range + kSlackM;
  float inside[kBlock], square[kBlock];
  for (int first = 0; first < samples.count; first += kBlock) {
    const int count = std::min(kBlock, samples.count - first);
    const float* p = samples.p + 3 * static_cast<int64_t>(first);
    for (int n = 0; n < count; ++n) {
      const Position q = T.apply(p[3 * n], p[3 * n + 1], p[3 * n + 2]);
      const Pixel pixel = camera.project(q.x, q.y, q.z);
      const float border = least(least(pixel.u - low, high_u - pixel.u), least(pixel.v - low, high_v - pixel.v));
      inside[n] = least(border, pixel.margin + kSlackM);
      square[n] = q.x * q.x + q.y * q.y + q.z * q.z;
    }
    for (int n = 0; n < count; ++n) {
      const int32_t index = first + n;
      if (!samples.valid[index] || labels.channel[samples.label[index]] < 0) continue;
      // The silhouette of a round thing lies beside its axis.
      const bool is_round = samples.kind[index] == kRound;
      const float beside = is_round ? reach + std::fabs(samples.offset[index]) : reach;
      if ((is_round || inside[n] >= 0) && square[n] <= beside * beside) found.push_back(index);
    }
  }
}

// Whether a round thing or a corner has a silhouette at a sample, and where it lies. `position`: of the camera in the map.
inline bool silhouette(const MapSamples& samples, int32_t index, const float* position, float* offset, float* contour) {
  const int64_t at = 3 * static_cast<int64_t>(index);
  const float *p = samples.p + at, *along = samples.tangent + at, *center = samples.center + at;
  const float to[3] = {p[0] - position[0], p[1] - position[1], p[2] - position[2]};
  float side[3] = {along[1] * to[2] - along[2] * to[1], along[2] * to[0] - along[0] * to[2],
                   along[0] * to[1] - along[1] * to[0]};
  const float distance = greatest(std::sqrt(side[0] * side[0] + side[1] * side[1] + side[2] * side[2]), 1e-6f);
  for (float& s : side) s /= distance;
  if (samples.kind[index] == kCorner) {
    const float reach = (p[0] - center[0]) * side[0] + (p[1] - center[1]) * side[1] + (p[2] - center[2]) * side[2];
    return std::fabs(reach) >= samples.offset[index];
  }
  const float radius = samples.offset[index];
  const float share = least(greatest(radius / distance, -0.9f), 0.9f), rest = std::sqrt(1 - share * share);
  const float back[3] = {along[1] * side[2] - along[2] * side[1], along[2] * side[0] - along[0] * side[2],
                         along[0] * side[1] - along[1] * side[0]};
  for (int k = 0; k < 3; ++k) {
    offset[k] = radius * (rest * side[k] + share * back[k]);
    contour[k] = p[k] + offset[k];
  }
  return true;
}

// Samples side by side, each as `sightings` looks at it.
struct Close {
  float x[kBlock], y[kBlock], z[kBlock], ax[kBlock], ay[kBlock], az[kBlock], s0[kBlock], s1[kBlock], s2[kBlock];
  float length[kBlock], least_px[kBlock], offset[3][kBlock];
  float u[kBlock], v[kBlock], inside[kBlock], length_px[kBlock], height_px[kBlock], range[kBlock];
  int32_t index[kBlock];

  // Where the contour of a sample lies; false where it has none.
  bool gather(int n, const MapSamples& samples, int32_t sample, const float* position, float least) {
    const int64_t at = 3 * static_cast<int64_t>(sample);
    const float *p = samples.p + at, *along = samples.tangent + at, *sigma = samples.height_sigma + at;
    float contour[3] = {p[0], p[1], p[2]}, off[3] = {0, 0, 0};
    if (samples.kind[sample] == kRound && !silhouette(samples, sample, position, off, contour)) return false;
    x[n] = contour[0], y[n] = contour[1], z[n] = contour[2], ax[n] = along[0], ay[n] = along[1], az[n] = along[2];
    s0[n] = sigma[0], s1[n] = sigma[1], s2[n] = sigma[2], length[n] = samples.length[sample], least_px[n] = least;
    for (int k = 0; k < 3; ++k) offset[k][n] = off[k];
    index[n] = sample;
    return true;
  }

  template <typename Camera>
  __attribute__((noinline)) void look(const Camera& camera, const Stand& stand, const Limits& limits, int count) {
    const Motion& T = stand.T;
    const float px = stand.position[0], py = stand.position[1], ground_z = stand.ground_z;
    struct Moved {
      float u, v;
    };
    for (int n = 0; n < count; ++n) {
      const Position q = T.apply(x[n], y[n], z[n]);
      const Pixel pixel = camera.project(q.x, q.y, q.z);
      const Gradient by_u = camera.pull_back(q.x, q.y, q.z, 1.0f, 0.0f), by_v = camera.pull_back(q.x, q.y, q.z, 0.0f, 1.0f);
      const auto moved = [&](float a, float b, float c) {
        const float i = T.R[0][0] * a + T.R[0][1] * b + T.R[0][2] * c, j = T.R[1][0] * a + T.R[1][1] * b + T.R[1][2] * c;
        const float k = T.R[2][0] * a + T.R[2][1] * b + T.R[2][2] * c;
        return Moved{by_u.x * i + by_u.y * j + by_u.z * k, by_v.x * i + by_v.y * j + by_v.z * k};
      };
      const float dx = x[n] - px, dy = y[n] - py, away_m = length_of(dx, dy), unit = 1 / greatest(away_m, 1e-3f);
      const float away_x = dx * unit, away_y = dy * unit;
      const Moved line = moved(ax[n], ay[n], az[n]), far = moved(away_x, away_y, 0);
      const Moved across = moved(-away_y, away_x, 0), up = moved(0, 0, 1);
      const float along_px = length_of(line.u, line.v), square = q.x * q.x + q.y * q.y + q.z * q.z;
      const float nu = line.v / greatest(along_px, 1e-3f), nv = -line.u / greatest(along_px, 1e-3f);
      const float rise = length_of(s0[n], 0.5f * s1[n] * away_m * away_m), lean = s2[n] * (z[n] - ground_z);
      const float a = rise * (up.u * nu + up.v * nv), b = lean * (far.u * nu + far.v * nv);
      const float c = lean * (across.u * nu + across.v * nv);
      const float border = least(least(pixel.u - limits.low, limits.high_u - pixel.u),
                                 least(pixel.v - limits.low, limits.high_v - pixel.v));
      // 1 where all of it holds; NaN holds nothing.
      const float near = square < limits.max_range * limits.max_range ? 1.0f : 0.0f;
      const float valid = pixel.margin > 0 ? near : 0.0f, in_image = border >= 0 ? valid : 0.0f;
      inside[n] = length_of(far.u, far.v) < least_px[n] ? 0.0f : in_image;
      u[n] = pixel.u, v[n] = pixel.v, range[n] = std::sqrt(square);
      length_px[n] = least(along_px * length[n], kLongestPx), height_px[n] = std::sqrt(a * a + b * b + c * c);
    }
  }
};

// All samples that a camera sees, in their order; paint of which a metre away is fewer than `min_ground` pixels is not.
template <typename Camera>
void sightings(const Camera& camera, const Stand& stand, const MapSamples& samples, const Labels& labels,
               const Limits& limits, float min_ground, std::vector<int32_t>& nearby, std::vector<Sighting>& seen) {
  nearby.clear(), seen.clear();
  may_be_seen(camera, stand.T, samples, labels, limits, nearby);
  Close close;
  for (size_t next = 0; next < nearby.size();) {
    int count = 0;
    for (; next < nearby.size() && count < kBlock; ++next) {
      const int32_t index = nearby[next];
      const float least = samples.label[index] < labels.num_ground ? min_ground : 0.0f;
      count += close.gather(count, samples, index, stand.position, least);
    }
    close.look(camera, stand, limits, count);
    for (int n = 0; n < count; ++n) {
      const int32_t index = close.index[n];
      float none[3];
      if (close.inside[n] == 0) continue;
      if (samples.kind[index] == kCorner && !silhouette(samples, index, stand.position, none, none)) continue;
      seen.push_back({index, {close.offset[0][n], close.offset[1][n], close.offset[2][n]}, close.length_px[n],
                      close.height_px[n], close.u[n], close.v[n], close.range[n]});
    }
  }
}

}  // namespace semloc
