// A pose refined from one start, coarse to fine: what semloc_jax/alignment/pose.py has as `refine`, with the loop of
// semloc_jax/solvers/levenberg_marquardt.py, for cameras of one model. The tests hold it to them.
#pragma once
#include <cstdlib>
#include <memory>
#include <vector>

#include "alignment.h"

namespace semloc {

// The numbers of a solve, in this order.
struct SolveNumbers {
  float usable_scale, margin_px, tolerance, first_damping, good_fall, ease, press, least_fall, least_damping, most_damping;
};

// Memory that begins where those of XLA do: loops round alike wherever a row lies, and a solve is always the same.
template <typename T>
class Row {
 public:
  T* sized(size_t count) {
    constexpr size_t kAlign = 64;
    if (count > count_) {
      data_.reset(static_cast<T*>(std::aligned_alloc(kAlign, (count * sizeof(T) + kAlign - 1) / kAlign * kAlign)));
      count_ = count;
    }
    return data_.get();
  }
  T* data() const { return data_.get(); }

 private:
  struct Free {
    void operator()(T* data) const { std::free(data); }
  };
  std::unique_ptr<T, Free> data_;
  size_t count_ = 0;
};

// The points that count, packed: what is hidden or empty costs nothing in any evaluation.
class VisiblePoints {
 public:
  void take(const Points& points, const float* weight) {
    const size_t size = std::max(points.count, 1);
    float *x = x_.sized(size), *y = y_.sized(size), *z = z_.sized(size), *kept = weight_.sized(size);
    int32_t* channel = channel_.sized(size);
    int count = 0;
    for (int n = 0; n < points.count; ++n) {
      if (weight[n] == 0) continue;
      x[count] = points.x[n], y[count] = points.y[n], z[count] = points.z[n];
      channel[count] = points.channel[n], kept[count] = weight[n];
      ++count;
    }
    count_ = count;
  }
  Points points() const { return {x_.data(), y_.data(), z_.data(), channel_.data(), weight_.data(), count_}; }

 private:
  Row<float> x_, y_, z_, weight_;
  Row<int32_t> channel_;
  int count_ = 0;
};

// Rotation vector and translation of T_a' T_b, the tangent of b in a; see semloc_jax/geometry/lie.py.
inline void relative_log(const float* T_a, const float* T_b, float* xi) {
  float R[3][3], t[3], off[3];
  for (int k = 0; k < 3; ++k) off[k] = T_b[4 * k + 3] - T_a[4 * k + 3];
  for (int i = 0; i < 3; ++i) {
    t[i] = T_a[i] * off[0] + T_a[4 + i] * off[1] + T_a[8 + i] * off[2];
    for (int j = 0; j < 3; ++j) R[i][j] = T_a[i] * T_b[j] + T_a[4 + i] * T_b[4 + j] + T_a[8 + i] * T_b[8 + j];
  }
  // Rows of 4 q q'; the longest is the exact one.
  const float xy = R[0][1] + R[1][0], yz = R[1][2] + R[2][1], zx = R[2][0] + R[0][2];
  const float wx = R[2][1] - R[1][2], wy = R[0][2] - R[2][0], wz = R[1][0] - R[0][1];
  const float rows[4][4] = {{1 + R[0][0] + R[1][1] + R[2][2], wx, wy, wz},
                            {wx, 1 + R[0][0] - R[1][1] - R[2][2], xy, zx},
                            {wy, xy, 1 - R[0][0] + R[1][1] - R[2][2], yz},
                            {wz, zx, yz, 1 - R[0][0] - R[1][1] + R[2][2]}};
  int longest = 0;
  for (int k = 1; k < 4; ++k)
    if (rows[k][k] > rows[longest][longest]) longest = k;
  const float* q = rows[longest];
  const float norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  const float w = q[0] / norm, v[3] = {q[1] / norm, q[2] / norm, q[3] / norm};
  const float squared = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], sine = std::sqrt(squared);
  const float half_over_sine = squared < 1e-4f ? 1 + squared * (1.0f / 6 + squared * (3.0f / 40 + squared * (5.0f / 112)))
                                               : std::atan2(sine, std::fabs(w)) / sine;
  float* omega = xi + 3;
  for (int k = 0; k < 3; ++k) omega[k] = 2 * (w < 0 ? -v[k] : v[k]) * half_over_sine;
  const float s = omega[0] * omega[0] + omega[1] * omega[1] + omega[2] * omega[2];
  float share;  // (1 - half cot half) / angle^2
  if (s < 0.25f) {
    share = 1.0f / 12 + s * (1.0f / 720 + s * (1.0f / 30240 + s * (1.0f / 1209600 + s / 47900160)));
  } else {
    const float half = 0.5f * std::sqrt(s);
    share = (1 - half / std::tan(half)) / s;
  }
  const auto turn = [omega](const float* a, float* out) {
    out[0] = omega[1] * a[2] - omega[2] * a[1], out[1] = omega[2] * a[0] - omega[0] * a[2];
    out[2] = omega[0] * a[1] - omega[1] * a[0];
  };
  float once[3], twice[3];
  turn(t, once), turn(once, twice);
  for (int k = 0; k < 3; ++k) xi[k] = t[k] - 0.5f * once[k] + share * twice[k];
}

// One camera of the rig.
template <typename Camera>
struct OneCamera {
  Camera camera;
  const float* T_cam_base;
  Points points;
  Usable usable;
  VisiblePoints visible;
};

// Cost [nats], gradient and Hessian by y.
struct Quadratic {
  float cost, gradient[6], hessian[36];
};

template <typename Camera>
void linearise(const std::vector<OneCamera<Camera>>& cameras, const std::vector<Texture>& textures, const float* T_start,
               const float* sigma, const float* y, const float* offset, float gain, Quadratic& out) {
  float xi[6], T[12], hessian[36], gradient[6];
  for (int k = 0; k < 6; ++k) xi[k] = sigma[k] * y[k];
  retract(T_start, xi, T);
  const Dual jacobian = right_jacobian(xi);
  out = {};
  for (size_t k = 0; k < cameras.size(); ++k) {
    const auto& own = cameras[k];
    const Points points = own.visible.points();
    if (points.count == 0) continue;
    const Sums sums =
        normal_equations(own.camera, Motion::camera_from_map(own.T_cam_base, T), points, textures[k]);
    to_chart(sums, own.T_cam_base, jacobian, sigma, hessian, gradient);
    out.cost += sums.cost;
    for (int i = 0; i < 6; ++i) out.gradient[i] += gradient[i];
    for (int i = 0; i < 36; ++i) out.hessian[i] += hessian[i];
  }
  float known = 0;
  for (int i = 0; i < 36; ++i) out.hessian[i] *= gain;
  for (int i = 0; i < 6; ++i) {
    const float deviation = y[i] - offset[i];
    known += deviation * deviation;
    out.gradient[i] = gain * out.gradient[i] + deviation;
    out.hessian[7 * i] += 1;
  }
  out.cost = gain * out.cost + 0.5f * known;
}

struct Ended {
  int num_steps;
  bool converged;
};

// One level: T becomes the pose at its end.
template <typename Camera>
Ended solve_level(std::vector<OneCamera<Camera>>& cameras, const std::vector<Texture>& textures, const float* T_prior,
                  const float* sigma, float gain, const SolveNumbers& config, int max_steps, Row<float>& weight,
                  float* T) {
  for (auto& own : cameras) {
    float* seen = weight.sized(own.points.count);
    visible_weight(own.camera, Motion::camera_from_map(own.T_cam_base, T), own.points, own.usable, config.margin_px, seen);
    own.visible.take(own.points, seen);
  }
  float offset[6], value[6] = {}, candidate[6] = {}, change = 0, length = 0, damping = config.first_damping;
  relative_log(T, T_prior, offset);
  for (int k = 0; k < 6; ++k) offset[k] = sigma[k] > 0 ? offset[k] / sigma[k] : 0.0f;
  Quadratic best{}, model;
  Ended ended{0, false};
  bool is_finite = true;
  while (ended.num_steps < max_steps && !ended.converged && is_finite) {
    linearise(cameras, textures, T, sigma, candidate, offset, gain, model);
    const bool is_first = ended.num_steps++ == 0;
    const float fall = model.cost - best.cost;
    const bool accept = is_first || fall <= config.least_fall * change;
    const bool is_good = accept && !is_first && fall < config.good_fall * change;
    if (accept) std::copy_n(candidate, 6, value), best = model;
    for (float v : value) is_finite = is_finite && std::isfinite(v);
    ended.converged = is_finite && !is_first && length < config.tolerance;
    damping = clamp(damping * (accept ? (is_good ? config.ease : 1.0f) : config.press), config.most_damping);
    damping = greatest(damping, config.least_damping);
    float step[6];
    damped_step(best.hessian, best.gradient, damping, step);
    change = length = 0;
    for (int i = 0; i < 6; ++i) {
      float curved = 0;
      for (int j = 0; j < 6; ++j) curved += best.hessian[6 * i + j] * step[j];
      change += step[i] * (best.gradient[i] + 0.5f * curved);
      length = greatest(length, std::fabs(step[i]));
      candidate[i] = value[i] + step[i];
    }
  }
  float xi[6], found[12];
  for (int k = 0; k < 6; ++k) xi[k] = sigma[k] * value[k];
  retract(T, xi, found);
  std::copy_n(found, 12, T);
  return ended;
}

// What each piece of contour shows at a pose: weight of the samples that are seen, and of it times rho. sums: [2 num].
template <typename Camera>
void piece_sums(const Camera& camera, const Motion& T, const Points& points, const Usable& usable, const Texture& texture,
                float margin_px, const int32_t* piece, int num, float* sums) {
  thread_local Row<float> weights, values;
  float *weight = weights.sized(points.count), *value = values.sized(points.count);
  visible_weight(camera, T, points, usable, margin_px, weight);
  ramp_values(camera, T, points, texture, value);
  std::fill_n(sums, 2 * num, 0.0f);
  // Samples of a piece follow each other: its sums stay in registers until the next one begins.
  int32_t open = -1;
  float shown = 0, penalty = 0;
  const auto close = [&] {
    if (open >= 0 && open < num) sums[open] += shown, sums[num + open] += penalty;
  };
  for (int n = 0; n < points.count; ++n) {
    if (piece[n] != open) close(), open = piece[n], shown = penalty = 0;
    shown += weight[n], penalty += weight[n] * tukey(value[n]);
  }
  close();
}

}  // namespace semloc
