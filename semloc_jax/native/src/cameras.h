// Camera models: pixel of a point, and the pull-back of a pixel gradient to the point.
//
// The numbers are those of semloc_jax/cameras (same clamps, same continuation beyond the field of view), which the tests
// hold them to. Straight-line float code without branches: the loops that inline it are vectorised by the compiler.
#pragma once
#include <cmath>

#include "inline.h"

namespace semloc {

constexpr float kMinDepthM = 1e-2f, kTinyM2 = 1e-12f, kPi = 3.14159265358979f;

// First six leaves of every camera.
struct Lens {
  float fx, fy, cx, cy, width, height;
  explicit Lens(const float* const* leaf)
      : fx(*leaf[0]), fy(*leaf[1]), cx(*leaf[2]), cy(*leaf[3]), width(*leaf[4]), height(*leaf[5]) {}
};

// `margin` is positive where the model is valid: in front of the lens, within the field of view.
struct Pixel {
  float u, v, margin;
};

struct Gradient {
  float x, y, z;
};

// atan2(y, x) by a minimax polynomial, error below 1.2e-7 rad.
SEMLOC_INLINE float angle_of(float y, float x) {
  const float ax = std::fabs(x), ay = std::fabs(y);
  const float a = least(ax, ay) / greatest(greatest(ax, ay), 1.17549435e-38f);
  const float s = a * a;
  float h = -0.004054538959f;
  h = h * s + 0.02186284633f;
  h = h * s - 0.05591214829f;
  h = h * s + 0.0964218251f;
  h = h * s - 0.1390862277f;
  h = h * s + 0.1994656399f;
  h = h * s - 0.3332986059f;
  h = h * s + 0.9999993355f;
  const float octant = a * h;
  const float quadrant = ay > ax ? kPi / 2 - octant : octant;
  const float half = x < 0 ? kPi - quadrant : quadrant;
  return y < 0 ? -half : half;
}

struct Pinhole : Lens {
  using Lens::Lens;
  struct Ray {
    float a, b, inverse_depth, depth;
  };
  SEMLOC_INLINE Ray ray(float x, float y, float z) const {
    const float inverse_depth = 1.0f / greatest(z, kMinDepthM);
    return {x * inverse_depth, y * inverse_depth, inverse_depth, z};
  }
  static SEMLOC_INLINE Gradient pull(const Ray& ray, float ga, float gb) {
    const float by_depth = -(ga * ray.a + gb * ray.b) * ray.inverse_depth;
    return {ga * ray.inverse_depth, gb * ray.inverse_depth, ray.depth > kMinDepthM ? by_depth : 0.0f};
  }
  SEMLOC_INLINE Pixel project(float x, float y, float z) const {
    const Ray r = ray(x, y, z);
    return {fx * r.a + cx, fy * r.b + cy, z - kMinDepthM};
  }
  SEMLOC_INLINE Gradient pull_back(float x, float y, float z, float du, float dv) const {
    return pull(ray(x, y, z), fx * du, fy * dv);
  }
};

struct BrownConrady : Pinhole {
  float k1, k2, p1, p2, k3, limit, end_slope;
  explicit BrownConrady(const float* const* leaf)
      : Pinhole(leaf), k1(*leaf[6]), k2(*leaf[7]), p1(*leaf[8]), p2(*leaf[9]), k3(*leaf[10]),
        limit(*leaf[11] * *leaf[11]), end_slope(limit * slope(limit)) {}
  SEMLOC_INLINE float slope(float s) const { return k1 + s * (2 * k2 + s * 3 * k3); }
  SEMLOC_INLINE Pixel project(float x, float y, float z) const {
    const Ray r = ray(x, y, z);
    const float a = r.a, b = r.b, s = a * a + b * b;
    const float inner = least(s, limit), q = limit / greatest(s, limit);
    const float radial = 1 + inner * (k1 + inner * (k2 + inner * k3)) + end_slope * (1 - q);
    const float tangential = q * (2 - q);
    const float xm = a * radial + tangential * (2 * p1 * a * b + p2 * (s + 2 * a * a));
    const float ym = b * radial + tangential * (p1 * (s + 2 * b * b) + 2 * p2 * a * b);
    return {fx * xm + cx, fy * ym + cy, least(limit - s, z - kMinDepthM)};
  }
  SEMLOC_INLINE Gradient pull_back(float x, float y, float z, float du, float dv) const {
    const Ray r = ray(x, y, z);
    const float a = r.a, b = r.b, s = a * a + b * b;
    const float inner = least(s, limit), outer = greatest(s, limit), q = limit / outer;
    const float radial = 1 + inner * (k1 + inner * (k2 + inner * k3)) + end_slope * (1 - q);
    const float tangential = q * (2 - q), falling = s > limit ? -q / outer : 0.0f;  // d q / d s
    const float radial_s = (s < limit ? slope(s) : 0.0f) - end_slope * falling;
    const float tangential_s = (2 - 2 * q) * falling;
    const float tx = 2 * p1 * a * b + p2 * (s + 2 * a * a), ty = p1 * (s + 2 * b * b) + 2 * p2 * a * b;
    const float gx = fx * du, gy = fy * dv;
    const float by_s = 2 * (radial_s * (gx * a + gy * b) + tangential_s * (gx * tx + gy * ty));
    const float cross = 2 * tangential * (p1 * gx + p2 * gy);
    const float ga = gx * (radial + tangential * 6 * p2 * a) + gy * tangential * 2 * p1 * a + by_s * a + cross * b;
    const float gb = gy * (radial + tangential * 6 * p1 * b) + gx * tangential * 2 * p2 * b + by_s * b + cross * a;
    return pull(r, ga, gb);
  }
};

struct KannalaBrandt : Lens {
  float k1, k2, k3, k4, max_theta, end_slope;
  explicit KannalaBrandt(const float* const* leaf)
      : Lens(leaf), k1(*leaf[6]), k2(*leaf[7]), k3(*leaf[8]), k4(*leaf[9]), max_theta(*leaf[10]),
        end_slope(slope(max_theta * max_theta)) {}
  SEMLOC_INLINE float slope(float s) const { return 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4))); }
  SEMLOC_INLINE float distorted(float theta) const {
    const float inner = least(theta, max_theta), s = inner * inner;
    return inner * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) + end_slope * (theta - inner);
  }
  SEMLOC_INLINE Pixel project(float x, float y, float z) const {
    const float r2 = x * x + y * y + kTinyM2, r = std::sqrt(r2);
    const float theta = angle_of(r, z), scale = distorted(theta) / r;
    return {fx * x * scale + cx, fy * y * scale + cy, max_theta - theta};
  }
  SEMLOC_INLINE Gradient pull_back(float x, float y, float z, float du, float dv) const {
    const float r2 = x * x + y * y + kTinyM2, inverse_r = 1.0f / std::sqrt(r2), r = r2 * inverse_r;
    const float theta = angle_of(r, z), d = distorted(theta);
    const float rising = theta < max_theta ? slope(theta * theta) : end_slope;
    const float inverse_rho2 = 1.0f / (r2 + z * z + kTinyM2);
    const float gx = fx * du, gy = fy * dv, scale = d * inverse_r;
    const float by_scale = gx * x + gy * y, by_theta = by_scale * inverse_r * rising;
    const float by_r2 = by_theta * z * inverse_rho2 * inverse_r - by_scale * d * inverse_r * inverse_r * inverse_r;
    return {gx * scale + by_r2 * x, gy * scale + by_r2 * y, -by_theta * r * inverse_rho2};
  }
};

struct Cylindrical : Lens {
  float max_phi;
  static constexpr float kMinRadius2 = 1e-4f;
  explicit Cylindrical(const float* const* leaf) : Lens(leaf), max_phi(*leaf[6]) {}
  SEMLOC_INLINE Pixel project(float x, float y, float z) const {
    const float rho2 = x * x + z * z, phi = angle_of(x, z);
    const float ym = y / std::sqrt(greatest(rho2, kMinRadius2));
    return {fx * phi + cx, fy * ym + cy, least(max_phi - std::fabs(phi), rho2 - kMinRadius2)};
  }
  SEMLOC_INLINE Gradient pull_back(float x, float y, float z, float du, float dv) const {
    const float rho2 = x * x + z * z, inverse_rho = 1.0f / std::sqrt(greatest(rho2, kMinRadius2));
    const float gx = fx * du / (rho2 + kTinyM2), gy = fy * dv * inverse_rho;
    const float by_rho = rho2 > kMinRadius2 ? -gy * y * inverse_rho * inverse_rho : 0.0f;
    return {gx * z + by_rho * x, gy, -gx * x + by_rho * z};
  }
};

struct Bev : Lens {
  float max_height;
  explicit Bev(const float* const* leaf) : Lens(leaf), max_height(*leaf[6]) {}
  SEMLOC_INLINE Pixel project(float x, float y, float z) const {
    return {fx * x + cx, fy * y + cy, max_height - std::fabs(z)};
  }
  SEMLOC_INLINE Gradient pull_back(float, float, float, float du, float dv) const { return {fx * du, fy * dv, 0.0f}; }
};

}  // namespace semloc
