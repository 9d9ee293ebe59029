// The chart of a solve, T_local_base = T_start exp(sigma y), and the damped step in it.
#pragma once
#include <cmath>

namespace semloc {

using Matrix3 = float[3][3];

inline void add_product(const Matrix3& a, const Matrix3& b, Matrix3& out) {
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k)
      for (int j = 0; j < 3; ++j) out[i][j] += a[i][k] * b[k][j];
}

// [diagonal, upper; 0, diagonal] with 3x3 blocks: adjoints of SE(3), their generators, products and power series.
struct Dual {
  Matrix3 diagonal{}, upper{};

  // x identity + y ad
  static Dual combine(float x, float y, const Dual& ad) {
    Dual out;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) out.diagonal[i][j] = y * ad.diagonal[i][j], out.upper[i][j] = y * ad.upper[i][j];
      out.diagonal[i][i] += x;
    }
    return out;
  }
  Dual operator*(const Dual& other) const {
    Dual out;
    add_product(diagonal, other.diagonal, out.diagonal);
    add_product(diagonal, other.upper, out.upper);
    add_product(upper, other.diagonal, out.upper);
    return out;
  }
};

inline void skew(const float* w, Matrix3& out) {
  out[0][1] = -w[2], out[0][2] = w[1], out[1][2] = -w[0];
  out[1][0] = w[2], out[2][0] = -w[1], out[2][1] = w[0];
}

// Right Jacobian of SE(3) as the series of semloc_jax/solvers/levenberg_marquardt.py, exact to float32 up to 0.3 rad.
inline Dual right_jacobian(const float* xi) {
  Dual ad;
  skew(xi + 3, ad.diagonal);
  skew(xi, ad.upper);
  const float s = xi[3] * xi[3] + xi[4] * xi[4] + xi[5] * xi[5];
  const Dual ad2 = ad * ad;
  const Dual even = ad2 * Dual::combine(1.0f / 6 - s * s / 5040, 1.0f / 120 - s / 2520, ad2);
  const Dual odd = ad * Dual::combine(1.0f / 2 - s * s / 720, 1.0f / 24 - s / 360, ad2);
  Dual out = Dual::combine(1, 1, even);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out.diagonal[i][j] -= odd.diagonal[i][j], out.upper[i][j] -= odd.upper[i][j];
  return out;
}

// T exp(xi) as rows of a 4x4 matrix, from T likewise.
inline void retract(const float* T, const float* xi, float* out) {
  const float s = xi[3] * xi[3] + xi[4] * xi[4] + xi[5] * xi[5];
  float a, b, c;  // sin t / t, (1 - cos t) / t^2, (t - sin t) / t^3
  if (s < 0.25f) {
    a = 1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72)));
    b = 0.5f * (1 - s / 12 * (1 - s / 30 * (1 - s / 56 * (1 - s / 90))));
    c = (1 - s / 20 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110)))) / 6;
  } else {
    const float t = std::sqrt(s);
    a = std::sin(t) / t, b = (1 - std::cos(t)) / s, c = (1 - a) / s;
  }
  Matrix3 w{}, w2{};
  skew(xi + 3, w);
  add_product(w, w, w2);
  float R[3][3], t[3];
  for (int i = 0; i < 3; ++i) {
    t[i] = xi[i];
    for (int j = 0; j < 3; ++j) {
      R[i][j] = (i == j) + a * w[i][j] + b * w2[i][j];
      t[i] += (b * w[i][j] + c * w2[i][j]) * xi[j];
    }
  }
  for (int i = 0; i < 3; ++i) {
    const float* row = T + 4 * i;
    for (int j = 0; j < 3; ++j) out[4 * i + j] = row[0] * R[0][j] + row[1] * R[1][j] + row[2] * R[2][j];
    out[4 * i + 3] = row[0] * t[0] + row[1] * t[1] + row[2] * t[2] + row[3];
  }
}

// Solution d of (H + damping I) d = -g by Cholesky; H is positive semidefinite, so no pivoting is needed.
inline void damped_step(const float* hessian, const float* gradient, float damping, float* step) {
  float lower[6][6], inverse[6];
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j <= i; ++j) {
      float sum = hessian[6 * i + j] + (i == j ? damping : 0);
      for (int k = 0; k < j; ++k) sum -= lower[i][k] * lower[j][k];
      if (i == j)
        inverse[i] = 1 / std::sqrt(sum);
      else
        lower[i][j] = sum * inverse[j];
    }
  }
  for (int i = 0; i < 6; ++i) {
    float sum = -gradient[i];
    for (int k = 0; k < i; ++k) sum -= lower[i][k] * step[k];
    step[i] = sum * inverse[i];
  }
  for (int i = 5; i >= 0; --i) {
    float sum = step[i];
    for (int k = i + 1; k < 6; ++k) sum -= lower[k][i] * step[k];
    step[i] = sum * inverse[i];
  }
}

}  // namespace semloc
