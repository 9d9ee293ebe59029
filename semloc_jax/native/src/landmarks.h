// Landmarks of a window of states, in double precision: what their views say, and what they leave on the states.
// The same as semloc_jax/fusion/inertial_sights.py and the elimination of semloc_jax/solvers/schur.py; only views that
// are there are looked at.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace semloc {

constexpr double kLeastCosine = 0.1;

struct Vec3 {
  double x[3];
  double operator[](int k) const { return x[k]; }
  double& operator[](int k) { return x[k]; }
};

inline double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// R p and R^T p for R with rows `stride` doubles apart.
inline Vec3 turned(const double* R, int stride, const Vec3& p) {
  Vec3 out;
  for (int i = 0; i < 3; ++i) out[i] = R[i * stride] * p[0] + R[i * stride + 1] * p[1] + R[i * stride + 2] * p[2];
  return out;
}
inline Vec3 turned_back(const double* R, int stride, const Vec3& p) {
  Vec3 out;
  for (int i = 0; i < 3; ++i) out[i] = R[i] * p[0] + R[stride + i] * p[1] + R[2 * stride + i] * p[2];
  return out;
}
inline Vec3 place_of(const double* T) { return {T[3], T[7], T[11]}; }

// Where a landmark lies seen from one view, all scaled by its inverse depth.
struct Direction {
  Vec3 q, X, Y;
  double depth;
  bool is_near;
};

struct LandmarkView {
  const double *T_base_cam_anchor, *T_base_cam, *axes;
  Vec3 ray;
  const double* pixels;
};

inline Direction direction_of(const double* T_anchor, const double* T_now, const double* landmark,
                              const LandmarkView& view) {
  Direction d;
  const double rho = landmark[2];
  const Vec3 ray = turned(view.axes, 3, {landmark[0], landmark[1], 1.0});
  const Vec3 then = place_of(view.T_base_cam_anchor), now = place_of(view.T_base_cam);
  const Vec3 p_anchor = place_of(T_anchor), p_now = place_of(T_now);
  d.X = turned(view.T_base_cam_anchor, 4, ray);
  for (int k = 0; k < 3; ++k) d.X[k] += rho * then[k];
  Vec3 in_map = turned(T_anchor, 4, d.X);
  for (int k = 0; k < 3; ++k) in_map[k] += rho * (p_anchor[k] - p_now[k]);
  d.Y = turned_back(T_now, 4, in_map);
  Vec3 rest = d.Y;
  for (int k = 0; k < 3; ++k) rest[k] -= rho * now[k];
  d.q = turned_back(view.T_base_cam, 4, rest);
  const double along = dot(view.ray, d.q), least = kLeastCosine * std::sqrt(dot(d.q, d.q));
  d.is_near = along >= least;
  d.depth = std::max(along, least);
  return d;
}

inline void pixels_off(const Direction& d, const double* pixels, double* r) {
  for (int row = 0; row < 2; ++row) r[row] = dot({pixels[3 * row], pixels[3 * row + 1], pixels[3 * row + 2]}, d.q) / d.depth;
}

// Columns: anchor 0..5, own pose 6..11, landmark 12..14.
constexpr int kColumns = 15;

inline void derivatives(const double* T_anchor, const double* T_now, const double* landmark, const LandmarkView& view,
                        double J[2][kColumns]) {
  const Direction d = direction_of(T_anchor, T_now, landmark, view);
  double r[2];
  pixels_off(d, view.pixels, r);
  const double rho = landmark[2], length = std::sqrt(dot(d.q, d.q));
  const Vec3 then = place_of(view.T_base_cam_anchor), now = place_of(view.T_base_cam);
  Vec3 moved = turned(T_anchor, 4, then);
  for (int k = 0; k < 3; ++k) moved[k] += T_anchor[4 * k + 3] - T_now[4 * k + 3];
  Vec3 origin = turned_back(T_now, 4, moved);
  for (int k = 0; k < 3; ++k) origin[k] -= now[k];
  for (int row = 0; row < 2; ++row) {
    Vec3 by_q;
    for (int k = 0; k < 3; ++k) {
      const double by_depth = d.is_near ? view.ray[k] : kLeastCosine * d.q[k] / length;
      by_q[k] = (view.pixels[3 * row + k] - r[row] * by_depth) / d.depth;
    }
    const Vec3 by_base = turned(view.T_base_cam, 4, by_q);
    const Vec3 by_anchor = turned_back(T_anchor, 4, turned(T_now, 4, by_base));
    double* out = J[row];
    // a' [X]x = (a x X)'.
    const auto cross = [](const Vec3& a, const Vec3& b) {
      return Vec3{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    };
    const Vec3 turn_anchor = cross(by_anchor, d.X), turn_base = cross(by_base, d.Y);
    for (int k = 0; k < 3; ++k) {
      out[k] = rho * by_anchor[k];
      out[3 + k] = -turn_anchor[k];
      out[6 + k] = -rho * by_base[k];
      out[9 + k] = turn_base[k];
    }
    const Vec3 in_camera = turned_back(view.T_base_cam_anchor, 4, by_anchor);
    for (int k = 0; k < 2; ++k)
      out[12 + k] = in_camera[0] * view.axes[k] + in_camera[1] * view.axes[3 + k] + in_camera[2] * view.axes[6 + k];
    out[14] = dot(by_base, origin);
  }
}

// Cauchy cost of a whitened distance; `weight` of its square.
inline double cauchy_cost(double square, double threshold, double* weight) {
  const double share = square / (threshold * threshold);
  *weight = 1.0 / (1.0 + share);
  return 0.5 * threshold * threshold * std::log1p(share);
}

struct LandmarkData {
  int64_t num_landmarks, num_states, num_cameras;
  const double *T_value, *height_value, *bend_value, *landmark, *T_at, *height_at, *bend_at;
  const int32_t *anchor, *camera;
  const double *axes, *ray, *pixels, *sqrt_info, *T_base_cam, *up, *lift, *away, *on_road;
  double threshold;
};

struct LandmarkSums {
  double *cost, *gradient, *information, *landmark_gradient, *landmark, *across;
};

// Unknowns of the states: six of each pose, then one height each, then one bend each.
constexpr int kPerState = 8;

inline void add_landmark(const LandmarkData& in, int64_t l, const LandmarkSums& out) {
  const int64_t F = in.num_states, P = kPerState * F, anchor = in.anchor[l], camera = in.camera[l];
  const double* point = in.landmark + 3 * l;
  double *g_l = out.landmark_gradient + 3 * l, *H_l = out.landmark + 9 * l, *A = out.across + 3 * P * l;
  bool is_used = false, was_seen = false;
  double r_before[2], J_before[2][kColumns];
  for (int64_t f = 0; f < F; ++f) {
    const double sqrt_info = in.sqrt_info[F * l + f];
    if (!(sqrt_info > 0.0)) {
      was_seen = false;
      continue;
    }
    is_used = true;
    const double* ray = in.ray + 3 * (F * l + f);
    const LandmarkView view{in.T_base_cam + 16 * (in.num_cameras * anchor + camera),
                            in.T_base_cam + 16 * (in.num_cameras * f + camera), in.axes + 9 * l,
                            {ray[0], ray[1], ray[2]}, in.pixels + 6 * (F * l + f)};
    double r[2], J[2][kColumns];
    pixels_off(direction_of(in.T_value + 16 * anchor, in.T_value + 16 * f, point, view), view.pixels, r);
    derivatives(in.T_at + 16 * anchor, in.T_at + 16 * f, point, view, J);
    // The step of the track: this error less the one before, by anchor, pose before, own pose and landmark.
    constexpr int kStep = 21;
    double s[2], D[2][kStep];
    int64_t column[kStep];
    for (int k = 0; k < 6; ++k) {
      column[k] = 6 * anchor + k;
      column[6 + k] = was_seen ? 6 * (f - 1) + k : -1;
      column[12 + k] = 6 * f + k;
    }
    for (int row = 0; row < 2; ++row) {
      s[row] = r[row] - (was_seen ? r_before[row] : 0.0);
      for (int k = 0; k < 6; ++k) {
        D[row][k] = J[row][k] - (was_seen ? J_before[row][k] : 0.0);
        D[row][6 + k] = was_seen ? -J_before[row][6 + k] : 0.0;
        D[row][12 + k] = J[row][6 + k];
      }
      for (int k = 0; k < 3; ++k) D[row][18 + k] = J[row][12 + k] - (was_seen ? J_before[row][12 + k] : 0.0);
    }
    const double info = sqrt_info * sqrt_info;
    double weight;
    *out.cost += cauchy_cost(info * (s[0] * s[0] + s[1] * s[1]), in.threshold, &weight);
    weight *= info;
    for (int a = 0; a < 18; ++a) {
      if (column[a] < 0) continue;
      const double d0 = weight * D[0][a], d1 = weight * D[1][a];
      out.gradient[column[a]] += d0 * s[0] + d1 * s[1];
      double* row = out.information + P * column[a];
      for (int b = 0; b < 18; ++b)
        if (column[b] >= 0) row[column[b]] += d0 * D[0][b] + d1 * D[1][b];
      for (int b = 0; b < 3; ++b) A[3 * column[a] + b] += d0 * D[0][18 + b] + d1 * D[1][18 + b];
    }
    for (int a = 0; a < 3; ++a) {
      const double d0 = weight * D[0][18 + a], d1 = weight * D[1][18 + a];
      g_l[a] += d0 * s[0] + d1 * s[1];
      for (int b = 0; b < 3; ++b) H_l[3 * a + b] += d0 * D[0][18 + b] + d1 * D[1][18 + b];
    }
    std::copy(r, r + 2, r_before);
    std::copy(&J[0][0], &J[0][0] + 2 * kColumns, &J_before[0][0]);
    was_seen = true;
  }
  if (!is_used) {
    for (int k = 0; k < 3; ++k) H_l[4 * k] += 1.0;
    return;
  }
  H_l[0] += 1e-4, H_l[4] += 1e-4, H_l[8] += 1e-2;
}

// What the road says of a landmark on it.
inline void add_road(const LandmarkData& in, int64_t l, const LandmarkSums& out) {
  const double w = in.on_road[l];
  if (w == 0.0) return;
  const int64_t F = in.num_states, P = kPerState * F, anchor = in.anchor[l];
  const int64_t at[2] = {6 * F + anchor, 7 * F + anchor};
  const double *point = in.landmark + 3 * l, *up = in.up + 3 * l, fall = 0.5 * in.away[l] * in.away[l];
  const double flat = up[0] * point[0] + up[1] * point[1] + up[2];
  const double r = w * (flat + point[2] * (in.lift[l] + in.height_value[anchor] - fall * in.bend_value[anchor]));
  const double depth = in.lift[l] + in.height_at[anchor] - fall * in.bend_at[anchor];
  const double J_l[3] = {w * up[0], w * up[1], w * depth}, J_road[2] = {w * point[2], -w * point[2] * fall};
  double weight;
  *out.cost += cauchy_cost(r * r, in.threshold, &weight);
  for (int a = 0; a < 2; ++a) {
    out.gradient[at[a]] += weight * J_road[a] * r;
    for (int b = 0; b < 2; ++b) out.information[P * at[a] + at[b]] += weight * J_road[a] * J_road[b];
    for (int b = 0; b < 3; ++b) out.across[3 * (P * l + at[a]) + b] += weight * J_road[a] * J_l[b];
  }
  for (int a = 0; a < 3; ++a) {
    out.landmark_gradient[3 * l + a] += weight * J_l[a] * r;
    for (int b = 0; b < 3; ++b) out.landmark[9 * l + 3 * a + b] += weight * J_l[a] * J_l[b];
  }
}

inline void seen_equations(const LandmarkData& in, const LandmarkSums& out) {
  const int64_t L = in.num_landmarks, P = kPerState * in.num_states;
  *out.cost = 0.0;
  std::fill_n(out.gradient, P, 0.0);
  std::fill_n(out.information, P * P, 0.0);
  std::fill_n(out.landmark_gradient, 3 * L, 0.0);
  std::fill_n(out.landmark, 9 * L, 0.0);
  std::fill_n(out.across, 3 * P * L, 0.0);
  for (int64_t l = 0; l < L; ++l) {
    add_landmark(in, l, out);
    add_road(in, l, out);
  }
}

// across [l p 3], inverse [l 3 3], gradient [l 3] -> sum of A inverse A' [p p], sum of A inverse g [p].
inline void eliminated(int64_t L, int64_t P, const double* across, const double* inverse, const double* gradient,
                       double* S, double* g) {
  std::fill_n(S, P * P, 0.0);
  std::fill_n(g, P, 0.0);
  std::vector<int64_t> at;
  std::vector<double> gain;
  for (int64_t l = 0; l < L; ++l) {
    const double *A = across + 3 * P * l, *C = inverse + 9 * l, *b = gradient + 3 * l;
    at.clear();
    gain.clear();
    for (int64_t p = 0; p < P; ++p) {
      const double* row = A + 3 * p;
      if (row[0] == 0.0 && row[1] == 0.0 && row[2] == 0.0) continue;
      at.push_back(p);
      for (int k = 0; k < 3; ++k) gain.push_back(row[0] * C[k] + row[1] * C[3 + k] + row[2] * C[6 + k]);
    }
    for (size_t i = 0; i < at.size(); ++i) {
      const double *own = gain.data() + 3 * i;
      g[at[i]] += own[0] * b[0] + own[1] * b[1] + own[2] * b[2];
      double* row = S + P * at[i];
      for (size_t j = 0; j < at.size(); ++j) {
        const double* other = A + 3 * at[j];
        row[at[j]] += own[0] * other[0] + own[1] * other[1] + own[2] * other[2];
      }
    }
  }
}

}  // namespace semloc
