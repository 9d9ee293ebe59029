// Map samples as one camera sees them; semloc_jax/residuals/view.py has the definition, which the tests hold this to.
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

// The numbers of a ViewConfig, in this order.
struct ViewNumbers {
  float margin_share, max_range, min_ground, min_spacing, metric_exponent, shared_error, noise_px, correlation_px, most_alone,
      px_per_m;
};

// One bucket of a view, slot by slot.
struct Bucket {
  int32_t* index;
  float *offset, *tangent, *weight;
  int32_t *channel, *element, *edge;
  int capacity;
};

// What the camera makes of each sample that can count.
struct Sighting {
  int32_t index;
  float offset[3], length_px, height_px;
};

constexpr int32_t kRound = 1, kCorner = 2;  // SampleKind
constexpr float kLongestPx = 50;

SEMLOC_INLINE float length_of(float a, float b) { return std::sqrt(a * a + b * b); }

// A camera behind a pointer: one view is compiled for all models.
struct AnyCamera {
  struct Slope {
    Gradient by_u, by_v;  // rows of the derivative of the pixel
  };
  const void* model;
  Pixel (*project)(const void* model, const Position& p);
  Slope (*slope)(const void* model, const Position& p);
  float width, height;

  template <typename Camera>
  explicit AnyCamera(const Camera& camera)
      : model(&camera), project([](const void* model, const Position& p) {
          return static_cast<const Camera*>(model)->project(p.x, p.y, p.z);
        }),
        slope([](const void* model, const Position& p) {
          const Camera& own = *static_cast<const Camera*>(model);
          return Slope{own.pull_back(p.x, p.y, p.z, 1.0f, 0.0f), own.pull_back(p.x, p.y, p.z, 0.0f, 1.0f)};
        }),
        width(camera.width), height(camera.height) {}
};

// Whether a round thing or a corner has a silhouette at a sample, and where it lies. `position`: of the camera in the map.
inline bool silhouette(const MapSamples& samples, Sighting& seen, const float* position, float* contour) {
  const int64_t at = 3 * static_cast<int64_t>(seen.index);
  const float *p = samples.p + at, *along = samples.tangent + at, *center = samples.center + at;
  const float to[3] = {p[0] - position[0], p[1] - position[1], p[2] - position[2]};
  float side[3] = {along[1] * to[2] - along[2] * to[1], along[2] * to[0] - along[0] * to[2],
                   along[0] * to[1] - along[1] * to[0]};
  const float distance = greatest(std::sqrt(side[0] * side[0] + side[1] * side[1] + side[2] * side[2]), 1e-6f);
  for (float& s : side) s /= distance;
  if (samples.kind[seen.index] == kCorner) {
    const float reach = (p[0] - center[0]) * side[0] + (p[1] - center[1]) * side[1] + (p[2] - center[2]) * side[2];
    return std::fabs(reach) >= samples.offset[seen.index];
  }
  const float radius = samples.offset[seen.index];
  const float share = least(greatest(radius / distance, -0.9f), 0.9f), rest = std::sqrt(1 - share * share);
  const float back[3] = {along[1] * side[2] - along[2] * side[1], along[2] * side[0] - along[0] * side[2],
                         along[0] * side[1] - along[1] * side[0]};
  for (int k = 0; k < 3; ++k) {
    seen.offset[k] = radius * (rest * side[k] + share * back[k]);
    contour[k] = p[k] + seen.offset[k];
  }
  return true;
}

// Whether a sample is seen, and how. `position`: of the camera in the map.
inline bool sight(const AnyCamera& camera, const Motion& T, const float* position, float ground_z, const MapSamples& samples,
           bool on_ground, const ViewNumbers& config, Sighting& seen) {
  const int64_t at = 3 * static_cast<int64_t>(seen.index);
  const float *p = samples.p + at, *along = samples.tangent + at;
  const int32_t kind = samples.kind[seen.index];
  float contour[3] = {p[0], p[1], p[2]};
  seen.offset[0] = seen.offset[1] = seen.offset[2] = 0;
  // Most samples lie out of the image: what has no silhouette of its own is settled before its sides are looked at.
  if (kind == kRound && !silhouette(samples, seen, position, contour)) return false;
  const Position q = T.apply(contour[0], contour[1], contour[2]);
  if (!(q.x * q.x + q.y * q.y + q.z * q.z < config.max_range * config.max_range)) return false;
  const Pixel pixel = camera.project(camera.model, q);
  const float low = -config.margin_share * camera.width - 0.5f;
  const float high_u = camera.width - 1 - low, high_v = camera.height - 1 - low;
  if (!(pixel.margin > 0 && pixel.u >= low && pixel.v >= low && pixel.u <= high_u && pixel.v <= high_v)) return false;
  if (kind == kCorner && !silhouette(samples, seen, position, contour)) return false;
  const auto [by_u, by_v] = camera.slope(camera.model, q);

  struct Moved {
    float u, v;
  };
  const auto moved = [&, by_u = by_u, by_v = by_v](float x, float y, float z) {
    const float a = T.R[0][0] * x + T.R[0][1] * y + T.R[0][2] * z, b = T.R[1][0] * x + T.R[1][1] * y + T.R[1][2] * z;
    const float c = T.R[2][0] * x + T.R[2][1] * y + T.R[2][2] * z;
    return Moved{by_u.x * a + by_u.y * b + by_u.z * c, by_v.x * a + by_v.y * b + by_v.z * c};
  };
  float away[2] = {contour[0] - position[0], contour[1] - position[1]};
  const float away_m = length_of(away[0], away[1]), unit = 1 / greatest(away_m, 1e-3f);
  away[0] *= unit, away[1] *= unit;
  const Moved line = moved(along[0], along[1], along[2]), far = moved(away[0], away[1], 0);
  if (on_ground && length_of(far.u, far.v) < config.min_ground) return false;

  const float along_px = length_of(line.u, line.v);
  seen.length_px = least(along_px * samples.length[seen.index], kLongestPx);
  const float nu = line.v / greatest(along_px, 1e-3f), nv = -line.u / greatest(along_px, 1e-3f);
  const Moved across = moved(-away[1], away[0], 0), up = moved(0, 0, 1);
  const float* sigma = samples.height_sigma + at;
  const float rise = length_of(sigma[0], 0.5f * sigma[1] * away_m * away_m), lean = sigma[2] * (contour[2] - ground_z);
  const float a = rise * (up.u * nu + up.v * nv), b = lean * (far.u * nu + far.v * nv);
  const float c = lean * (across.u * nu + across.v * nv);
  seen.height_px = std::sqrt(a * a + b * b + c * c);
  return true;
}

// Number of the straight edge of each sample.
inline std::vector<int32_t> edges_of(const MapSamples& samples) {
  std::vector<int32_t> edge(samples.count);
  for (int n = 1; n < samples.count; ++n) {
    const float *a = samples.tangent + 3 * (n - 1), *b = a + 3;
    const bool turned = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] < 0.7f;
    edge[n] = edge[n - 1] + (turned || samples.element[n] != samples.element[n - 1]);
  }
  return edge;
}

// What labels mean: the channel of each (negative: no mask shows it), the factor on its weight; the first `num_ground`
// are painted on the ground.
struct Labels {
  const int32_t* channel;
  const float* weight;
  int num_ground;
};

// The samples that a camera sees from T_map_base, thinned to uniform density along contours in the image.
inline void view(const AnyCamera& camera, const float* T_map_base, const float* T_base_cam, const MapSamples& samples,
          const Labels& labels, float grain, const ViewNumbers& config, const Bucket& bucket) {
  const Motion base(T_map_base), mount(T_base_cam);
  const Position at = base.apply(mount.t[0], mount.t[1], mount.t[2]);
  const float position[3] = {at.x, at.y, at.z}, ground_z = base.t[2];
  Motion T = base;  // from the map to the camera
  for (int i = 0; i < 3; ++i) {
    T.t[i] = 0;
    for (int j = 0; j < 3; ++j) {
      T.R[i][j] = 0;
      for (int k = 0; k < 3; ++k) T.R[i][j] += mount.R[k][i] * base.R[j][k];
      T.t[i] -= T.R[i][j] * position[j];
    }
  }
  std::vector<Sighting> seen;
  seen.reserve(samples.count);
  double total_px = 0;
  for (int n = 0; n < samples.count; ++n) {
    if (!samples.valid[n] || labels.channel[samples.label[n]] < 0) continue;
    Sighting one{n};
    if (!sight(camera, T, position, ground_z, samples, samples.label[n] < labels.num_ground, config, one)) continue;
    total_px += one.length_px;
    seen.push_back(one);
  }
  const std::vector<int32_t> edge = edges_of(samples);
  std::vector<float> edge_px(edge.empty() ? 1 : edge.back() + 1, 0.0f);
  for (const Sighting& one : seen) edge_px[edge[one.index]] += one.length_px;

  const float spacing = greatest(static_cast<float>(total_px) / (0.9f * bucket.capacity), config.min_spacing);
  const float unit_px = config.correlation_px * grain, unit_height = config.noise_px * grain;
  std::vector<float> of_element;
  double running = 0;
  int filled = 0;
  for (const Sighting& one : seen) {
    const double before = std::floor(running);
    running += static_cast<double>(least(one.length_px, spacing)) / spacing;
    if (std::floor(running) == before || filled == bucket.capacity) continue;
    const float shown_px = greatest(one.length_px, spacing);
    const float shown_m = samples.length[one.index] * shown_px / greatest(one.length_px, 1e-3f);
    float weight = shown_px;
    if (config.metric_exponent != 0)
      weight = std::pow(shown_px, 1 - config.metric_exponent) * std::pow(shown_m * config.px_per_m, config.metric_exponent);
    const float alone = unit_px / greatest(edge_px[edge[one.index]], 1.0f);
    weight *= least(greatest(alone, 1.0f), config.most_alone);
    const float off = one.height_px / unit_height;
    weight /= 1 + off * off;
    const int32_t element = samples.element[one.index];
    if (element >= static_cast<int32_t>(of_element.size())) of_element.resize(element + 1, 0.0f);
    if (element >= 0) of_element[element] += weight;
    bucket.index[filled] = one.index;
    bucket.weight[filled] = weight;
    for (int k = 0; k < 3; ++k) bucket.offset[k * bucket.capacity + filled] = one.offset[k];
    ++filled;
  }
  for (int slot = 0; slot < bucket.capacity; ++slot) {
    const bool used = slot < filled;
    const int32_t index = used ? bucket.index[slot] : 0, element = used ? samples.element[index] : -1;
    if (used) {
      const float observations = (element >= 0 ? of_element[element] : 0.0f) / unit_px;
      bucket.weight[slot] *= labels.weight[samples.label[index]] / (1 + config.shared_error * observations);
    } else {
      bucket.index[slot] = 0;
      bucket.weight[slot] = 0;
      for (int k = 0; k < 3; ++k) bucket.offset[k * bucket.capacity + slot] = 0;
    }
    for (int k = 0; k < 3; ++k) bucket.tangent[k * bucket.capacity + slot] = samples.tangent[3 * index + k];
    bucket.channel[slot] = used ? labels.channel[samples.label[index]] : 0;
    bucket.element[slot] = element;
    bucket.edge[slot] = edge[index];
  }
}

}  // namespace semloc
