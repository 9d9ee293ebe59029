// Map samples as one camera sees them; semloc_jax/residuals/view.py has the definition, which the tests hold this to.
#pragma once
#include "sight.h"

namespace semloc {

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

// The samples that a camera sees, thinned to uniform density along contours in the image.
inline void view(const std::vector<Sighting>& seen, const MapSamples& samples, const Labels& labels, float grain,
                 const ViewNumbers& config, const Bucket& bucket) {
  double total_px = 0;
  for (const Sighting& one : seen) total_px += one.length_px;
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
