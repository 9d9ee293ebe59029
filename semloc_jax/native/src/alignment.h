// The alignment of one camera at one pose: normal equations, visibility and robust cost (Tukey).
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "cameras.h"
#include "chart.h"
#include "texture.h"

namespace semloc {

constexpr int kBlock = 128;  // points side by side; what a block stores stays in the first-level cache
constexpr int kRows = 7;     // linear part, angular part, residual

struct Position {
  float x, y, z;
};

// Rigid motion p -> R p + t.
struct Motion {
  float R[3][3], t[3];

  SEMLOC_INLINE Position apply(float x, float y, float z) const {
    return {R[0][0] * x + R[0][1] * y + R[0][2] * z + t[0], R[1][0] * x + R[1][1] * y + R[1][2] * z + t[1],
            R[2][0] * x + R[2][1] * y + R[2][2] * z + t[2]};
  }

  // From the upper rows of a 4x4 matrix.
  explicit Motion(const float* T) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) R[i][j] = T[4 * i + j];
      t[i] = T[4 * i + 3];
    }
  }

  // T_cam_base inverse(T_local_base).
  static Motion camera_from_map(const float* T_cam_base, const float* T_local_base) {
    const Motion cam(T_cam_base), base(T_local_base);
    Motion out = cam;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        out.R[i][j] = 0;
        for (int k = 0; k < 3; ++k) out.R[i][j] += cam.R[i][k] * base.R[j][k];
      }
      for (int j = 0; j < 3; ++j) out.t[i] -= out.R[i][j] * base.t[j];
    }
    return out;
  }
};

// Sums over points of w a_i a_j for the seven rows a, upper triangle, and of w rho.
struct Sums {
  float products[kRows][kRows];
  float cost;
};

// Adds the products of the rows of a block. Two passes: all 28 sums at once do not fit into the vector registers.
template <int kFirst, int kLast>
SEMLOC_INLINE void add_products(const float (&row)[kRows][kBlock], const float* weight, int count, Sums& sums) {
  float partial[kRows][kRows] = {};
  for (int n = 0; n < count; ++n) {
#pragma GCC unroll 7
    for (int i = kFirst; i < kLast; ++i) {
      const float weighted = weight[n] * row[i][n];
#pragma GCC unroll 7
      for (int j = i; j < kRows; ++j) partial[i][j] += weighted * row[j][n];
    }
  }
  for (int i = kFirst; i < kLast; ++i)
    for (int j = i; j < kRows; ++j) sums.products[i][j] += partial[i][j];
}

SEMLOC_INLINE float tukey(float v) {
  const float s = least(v * v, 1.0f);
  return s * (3 - 3 * s + s * s) * (1.0f / 6);
}

// Cost and products of points given in camera coordinates with residual and its gradient.
// Moving the camera by xi moves the point by -v - omega x p, hence the residual by -a.v + (a x p).omega.
struct Block {
  float row[kRows][kBlock];
  float weight[kBlock];
  float penalty[kBlock];

  SEMLOC_INLINE void set(int n, float x, float y, float z, Gradient a, float value, float point_weight) {
    const float t = greatest(1 - value * value, 0.0f);
    weight[n] = point_weight * t * t;
    penalty[n] = point_weight * tukey(value);
    row[0][n] = -a.x, row[1][n] = -a.y, row[2][n] = -a.z;
    row[3][n] = a.y * z - a.z * y, row[4][n] = a.z * x - a.x * z, row[5][n] = a.x * y - a.y * x;
    row[6][n] = value;
  }
  SEMLOC_INLINE void add_to(Sums& sums, int count) const {
    for (int n = 0; n < count; ++n) sums.cost += penalty[n];
    add_products<0, 2>(row, weight, count, sums);
    add_products<2, kRows>(row, weight, count, sums);
  }
};

struct Points {
  const float *x, *y, *z;
  const int32_t* channel;
  const float* weight;
  int count;

  Points part(int first, int num) const {
    return {x + first, y + first, z + first, channel + first, weight + first, num};
  }
  // Without the padding at the end, whose weight is 0.
  Points filled() const {
    int last = count;
    while (last > 0 && weight[last - 1] == 0) --last;
    return part(0, last);
  }
};

// Points of a block in camera coordinates with their texels.
struct Seen {
  float x[kBlock], y[kBlock], z[kBlock], fu[kBlock], fv[kBlock];
  int32_t index[kBlock];
  uint32_t quad[kBlock];

  template <typename Camera>
  SEMLOC_INLINE void look(const Camera& camera, const Motion& T, const Points& points, const Texture& texture, int first,
                          int count) {
    for (int n = 0; n < count; ++n) {
      const Position p = T.apply(points.x[first + n], points.y[first + n], points.z[first + n]);
      x[n] = p.x, y[n] = p.y, z[n] = p.z;
      const Pixel pixel = camera.project(p.x, p.y, p.z);
      const Texel texel = locate(texture, points.channel[first + n], pixel.u, pixel.v);
      index[n] = texel.index, fu[n] = texel.fu, fv[n] = texel.fv;
    }
    for (int n = 0; n < count; ++n) quad[n] = texture.texels[index[n]];
  }
};

template <typename Camera>
__attribute__((noinline)) Sums normal_equations(const Camera& camera, const Motion& T, const Points& points, const Texture& texture) {
  Sums sums{};
  Seen seen;
  Block block;
  for (int first = 0; first < points.count; first += kBlock) {
    const int count = std::min(kBlock, points.count - first);
    seen.look(camera, T, points, texture, first, count);
    for (int n = 0; n < count; ++n) {
      const Sample s = blend(texture, seen.quad[n], seen.fu[n], seen.fv[n]);
      const Gradient a = camera.pull_back(seen.x[n], seen.y[n], seen.z[n], s.du, s.dv);
      block.set(n, seen.x[n], seen.y[n], seen.z[n], a, s.value, points.weight[first + n]);
    }
    block.add_to(sums, count);
  }
  return sums;
}

// Two numbers side by side: a complex number of XLA.
struct Pair {
  float a, b;
};

// The same for any camera: residual and its derivative by the point in the camera frame come from outside.
inline Sums accumulate(const Motion& T, const Points& points, const Pair* slope_xy, const float* slope_z,
                       const float* value) {
  Sums sums{};
  Block block;
  for (int first = 0; first < points.count; first += kBlock) {
    const int count = std::min(kBlock, points.count - first);
    float ax[kBlock], ay[kBlock];
    for (int n = 0; n < count; ++n) ax[n] = slope_xy[first + n].a, ay[n] = slope_xy[first + n].b;
    for (int n = 0; n < count; ++n) {
      const int k = first + n;
      const Position p = T.apply(points.x[k], points.y[k], points.z[k]);
      block.set(n, p.x, p.y, p.z, {ax[n], ay[n], slope_z[k]}, value[k], points.weight[k]);
    }
    block.add_to(sums, count);
  }
  return sums;
}

// Ramp value and its gradient at pixels.
inline void lookup(const Texture& texture, const Pair* uv, const int32_t* channel, int num_points, float* value,
                   Pair* slope) {
  for (int n = 0; n < num_points; ++n) {
    const Texel texel = locate(texture, channel[n], uv[n].a, uv[n].b);
    const Sample s = blend(texture, texture.texels[texel.index], texel.fu, texel.fv);
    value[n] = s.value;
    slope[n] = {s.du, s.dv};
  }
}

// Hessian [6 6] and gradient [6] by y from the sums in the tangent of the camera, xi_cam = Ad(T_cam_base) J_r sigma dy.
inline void to_chart(const Sums& sums, const float* T_cam_base, const Dual& jacobian, const float* sigma, float* hessian,
                     float* gradient) {
  const Motion T(T_cam_base);
  Dual adjoint;
  Matrix3 lever{};
  skew(T.t, lever);
  add_product(lever, T.R, adjoint.upper);
  std::copy(&T.R[0][0], &T.R[0][0] + 9, &adjoint.diagonal[0][0]);
  const Dual carry = adjoint * jacobian;
  float M[6][6] = {}, full[6][6], half[6][6] = {};
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      M[i][j] = carry.diagonal[i][j] * sigma[j];
      M[i][3 + j] = carry.upper[i][j] * sigma[3 + j];
      M[3 + i][3 + j] = carry.diagonal[i][j] * sigma[3 + j];
    }
  }
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) full[i][j] = sums.products[std::min(i, j)][std::max(i, j)];
  for (int i = 0; i < 6; ++i)
    for (int k = 0; k < 6; ++k)
      for (int j = 0; j < 6; ++j) half[i][j] += full[i][k] * M[k][j];
  for (int i = 0; i < 6; ++i) {
    gradient[i] = 0;
    for (int j = 0; j < 6; ++j) hessian[6 * i + j] = 0;
    for (int k = 0; k < 6; ++k) {
      gradient[i] += M[k][i] * sums.products[k][6];
      for (int j = 0; j < 6; ++j) hessian[6 * i + j] += M[k][i] * half[k][j];
    }
  }
}

// Pixels that may be used (1, else 0), at a stride.
struct Usable {
  const uint8_t* mask;
  int height, width;
  float scale;

  SEMLOC_INLINE int32_t index(float u, float v) const {
    const int32_t column = static_cast<int32_t>(clamp(u * scale, width - 1.0f));
    return static_cast<int32_t>(clamp(v * scale, height - 1.0f)) * width + column;
  }
};

// Weight of each point where it is in front of the camera, in the image and on a usable pixel; else 0.
template <typename Camera>
__attribute__((noinline)) void visible_weight(const Camera& camera, const Motion& T, const Points& points, const Usable& usable, float margin_px,
                    float* weight) {
  const float low = margin_px - 0.5f, high_u = camera.width - 1 - low, high_v = camera.height - 1 - low;
  float inside[kBlock];
  int32_t index[kBlock];
  for (int first = 0; first < points.count; first += kBlock) {
    const int count = std::min(kBlock, points.count - first);
    for (int n = 0; n < count; ++n) {
      const Position p = T.apply(points.x[first + n], points.y[first + n], points.z[first + n]);
      const Pixel pixel = camera.project(p.x, p.y, p.z);
      index[n] = usable.index(pixel.u, pixel.v);
      const float border = least(least(pixel.u - low, high_u - pixel.u), least(pixel.v - low, high_v - pixel.v));
      // Loaded whatever the condition: a load that depends on it would be a branch.
      const float full = points.weight[first + n], in_image = border >= 0 ? full : 0.0f;
      inside[n] = pixel.margin > 0 ? in_image : 0.0f;
    }
    for (int n = 0; n < count; ++n) weight[first + n] = inside[n] * usable.mask[index[n]];
  }
}

// Pixel, margin and derivatives of each point, row by row.
template <typename Camera>
void project(const Camera& camera, const float* p_cam, int64_t num, float* rows) {
  float row[9][kBlock];
  for (int64_t first = 0; first < num; first += kBlock) {
    const int count = static_cast<int>(std::min<int64_t>(kBlock, num - first));
    const float* p = p_cam + first;
    for (int n = 0; n < count; ++n) {
      const float x = p[n], y = p[num + n], z = p[2 * num + n];
      const Pixel pixel = camera.project(x, y, z);
      const Gradient du = camera.pull_back(x, y, z, 1.0f, 0.0f), dv = camera.pull_back(x, y, z, 0.0f, 1.0f);
      row[0][n] = pixel.u, row[1][n] = pixel.v, row[2][n] = pixel.margin;
      row[3][n] = du.x, row[4][n] = du.y, row[5][n] = du.z;
      row[6][n] = dv.x, row[7][n] = dv.y, row[8][n] = dv.z;
    }
    for (int k = 0; k < 9; ++k) std::copy_n(row[k], count, rows + k * num + first);
  }
}

// Ramp value of each point. Never inlined: its two callers share what is compiled for each camera.
template <typename Camera>
__attribute__((noinline)) void ramp_values(const Camera& camera, const Motion& T, const Points& points,
                                           const Texture& texture, float* value) {
  Seen seen;
  for (int first = 0; first < points.count; first += kBlock) {
    const int count = std::min(kBlock, points.count - first);
    seen.look(camera, T, points, texture, first, count);
    for (int n = 0; n < count; ++n) value[first + n] = blend(texture, seen.quad[n], seen.fu[n], seen.fv[n]).value;
  }
}

// Sum of w rho / rho(1) for points with the given weights.
template <typename Camera>
float robust_cost(const Camera& camera, const Motion& T, const Points& points, const Texture& texture) {
  float value[kBlock], cost = 0;
  for (int first = 0; first < points.count; first += kBlock) {
    const Points block = points.part(first, std::min(kBlock, points.count - first));
    ramp_values(camera, T, block, texture, value);
    for (int n = 0; n < block.count; ++n) cost += block.weight[n] * tukey(value[n]);
  }
  return 6 * cost;
}

}  // namespace semloc
