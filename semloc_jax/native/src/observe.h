// What poses see of the map, sample by sample; semloc_jax/alignment/observed.py has the definition, which the tests hold
// this to.
#pragma once
#include "sight.h"

namespace semloc {

// Distances to the borders of the masks of one camera [channel h w], and pixels that may be used [h w].
struct Borders {
  const float* signed_px;
  int height, width;
  float stride;
  const uint8_t* usable;
  int usable_height, usable_width;
  float usable_stride;

  float at(int32_t channel, float u, float v) const {
    const float x = clamp((u + 0.5f) / stride - 0.5f, width - 1.001f), y = clamp((v + 0.5f) / stride - 0.5f, height - 1.001f);
    const int column = static_cast<int>(x), row = static_cast<int>(y);
    const float fu = x - column, fv = y - row;
    const float* p = signed_px + (static_cast<int64_t>(channel) * height + row) * width + column;
    const int right = width > 1, down = height > 1 ? width : 0;  // a field of one row or column has no neighbours there
    const float top = p[0] + fu * (p[right] - p[0]), bottom = p[down] + fu * (p[down + right] - p[down]);
    return top + fv * (bottom - top);
  }
  bool may_use(float u, float v) const {
    const int column = static_cast<int>(clamp(u / usable_stride, usable_width - 1.0f));
    const int row = static_cast<int>(clamp(v / usable_stride, usable_height - 1.0f));
    return usable[static_cast<int64_t>(row) * usable_width + column] != 0;
  }
};

// One row for each pose and sample that it sees.
struct SeenRows {
  int32_t *pose, *sample, *cell;
  float *signed_px, *length_px, *range_m;
};

// Fills the rows, pose by pose; returns how many there are.
template <typename Camera>
int64_t observe(const Camera& camera, const float* Ts_local_base, int num_poses, const float* T_base_cam,
                const MapSamples& samples, const Labels& labels, const Borders& borders, const Limits& limits,
                float min_ground, float cell_px, int32_t cell_columns, const SeenRows& rows) {
  std::vector<int32_t> nearby;
  std::vector<Sighting> seen;
  const float per_cell = 1.0f / cell_px;
  int64_t filled = 0;
  for (int pose = 0; pose < num_poses; ++pose) {
    const Stand stand(Ts_local_base + 16 * static_cast<int64_t>(pose), T_base_cam);
    sightings(camera, stand, samples, labels, limits, min_ground, nearby, seen);
    for (const Sighting& one : seen) {
      if (!borders.may_use(one.u, one.v) || !(one.length_px > 0)) continue;
      const int down = static_cast<int>(std::floor(one.v * per_cell)), across = static_cast<int>(std::floor(one.u * per_cell));
      rows.pose[filled] = pose, rows.sample[filled] = one.index, rows.cell[filled] = down * cell_columns + across;
      rows.signed_px[filled] = borders.at(labels.channel[samples.label[one.index]], one.u, one.v);
      rows.length_px[filled] = one.length_px, rows.range_m[filled] = one.range;
      ++filled;
    }
  }
  return filled;
}

// Adds to each pose what the samples under its camera gain, by the pixel of `gain` [channel h w] that each falls on.
template <typename Camera>
void coarse_look(const Camera& camera, const float* Ts_local_base, int num_poses, const float* T_base_cam, const Points& points,
                 const float* gain, int height, int width, float stride, const Limits& limits, float* nats) {
  const float per_pixel = 1.0f / stride;
  float inside[kBlock];
  int32_t index[kBlock];
  for (int pose = 0; pose < num_poses; ++pose) {
    const Motion T = Stand(Ts_local_base + 16 * static_cast<int64_t>(pose), T_base_cam).T;
    float total = 0;
    for (int first = 0; first < points.count; first += kBlock) {
      const int count = std::min(kBlock, points.count - first);
      for (int n = 0; n < count; ++n) {
        const Position q = T.apply(points.x[first + n], points.y[first + n], points.z[first + n]);
        const Pixel pixel = camera.project(q.x, q.y, q.z);
        const float border = least(least(pixel.u - limits.low, limits.high_u - pixel.u),
                                   least(pixel.v - limits.low, limits.high_v - pixel.v));
        const float full = points.weight[first + n], in_image = border >= 0 ? full : 0.0f;
        const float near = q.x * q.x + q.y * q.y + q.z * q.z < limits.max_range * limits.max_range ? in_image : 0.0f;
        inside[n] = pixel.margin > 0 ? near : 0.0f;
        const int32_t column = static_cast<int32_t>(clamp(pixel.u * per_pixel, width - 1.0f));
        const int32_t row = static_cast<int32_t>(clamp(pixel.v * per_pixel, height - 1.0f));
        index[n] = (points.channel[first + n] * height + row) * width + column;
      }
      for (int n = 0; n < count; ++n) total += inside[n] * gain[index[n]];
    }
    nats[pose] += total;
  }
}

}  // namespace semloc
