// The benchmark's problem as semloc_jax.bench.problem.to_binary writes it, and one level of it in plain C++.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

using Pose = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
using Vector6 = Eigen::Matrix<double, 6, 1>;

struct Image {
  int stride, height, width;
  double gain;
  std::vector<float> pixels;  // class, row, column
};

struct Problem {
  int num_points, num_classes, max_steps, width, height;
  double fx, fy, cx, cy, tolerance, border;
  Vector6 sigma;
  Pose T_cam_base, T_true, T_prior;
  std::vector<float> p_map, weight;
  std::vector<int32_t> channel;
  std::vector<Image> levels;

  explicit Problem(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    const auto ints = read<int32_t>(file, 8);
    if (ints[0] != 0x534C4231) throw std::runtime_error(path + ": not a benchmark problem");
    num_points = ints[1], num_classes = ints[2], max_steps = ints[4], width = ints[5], height = ints[6];
    levels.resize(ints[3]);
    for (Image& level : levels) {
      const auto shape = read<int32_t>(file, 4);
      level.stride = shape[0], level.height = shape[1], level.width = shape[2];
    }
    const auto numbers = read<double>(file, 12);
    fx = numbers[0], fy = numbers[1], cx = numbers[2], cy = numbers[3], tolerance = numbers[4], border = numbers[5];
    sigma = Eigen::Map<const Vector6>(&numbers[6]);
    for (Pose* T : {&T_cam_base, &T_true, &T_prior}) *T = Eigen::Map<const Pose>(read<double>(file, 16).data());
    for (Image& level : levels) level.gain = read<double>(file, 1)[0];
    p_map = read<float>(file, 3 * num_points);
    weight = read<float>(file, num_points);
    channel = read<int32_t>(file, num_points);
    for (Image& level : levels) level.pixels = read<float>(file, num_classes * level.height * level.width);
  }

 private:
  template <typename T>
  static std::vector<T> read(std::ifstream& file, size_t count) {
    std::vector<T> values(count);
    file.read(reinterpret_cast<char*>(values.data()), count * sizeof(T));
    if (!file) throw std::runtime_error("the benchmark problem ends early");
    return values;
  }
};

// Value of a cost map and its gradient by the pixel of the full mask.
struct Sample {
  double value, du, dv;
};

inline Sample lookup(const Image& image, int channel, double u, double v) {
  const double x = (u + 0.5) / image.stride - 0.5, y = (v + 0.5) / image.stride - 0.5;
  const double held_x = std::clamp(x, 0.0, image.width - 1.001), held_y = std::clamp(y, 0.0, image.height - 1.001);
  const int j = static_cast<int>(held_x), i = static_cast<int>(held_y);
  const double fu = held_x - j, fv = held_y - i;
  const float* at = &image.pixels[(static_cast<size_t>(channel) * image.height + i) * image.width + j];
  const double a = at[0], b = at[1], c = at[image.width], d = at[image.width + 1];
  const double top = a + fu * (b - a), bottom = c + fu * (d - c);
  const double du = ((b - a) + fv * ((d - c) - (b - a))) / image.stride, dv = (bottom - top) / image.stride;
  return {top + fv * (bottom - top), held_x == x ? du : 0.0, held_y == y ? dv : 0.0};
}

inline Pose inverse(const Pose& T) {
  Pose out = Pose::Identity();
  out.topLeftCorner<3, 3>() = T.topLeftCorner<3, 3>().transpose();
  out.topRightCorner<3, 1>() = -T.topLeftCorner<3, 3>().transpose() * T.topRightCorner<3, 1>();
  return out;
}

inline Eigen::Matrix3d rotation(const Eigen::Vector3d& omega) {
  const double angle = std::max(omega.norm(), 1e-12);
  return Eigen::AngleAxisd(angle, omega / angle).toRotationMatrix();
}

// One level: T_map_base = T_start [Exp(omega) | v] with (v, omega) = sigma y, visibility frozen at T_start.
struct Level {
  const Problem& problem;
  const Image& image;
  Pose T_start;
  Vector6 y_prior;
  std::vector<Eigen::Vector3d> points;  // visible ones, in the vehicle frame of T_start
  std::vector<int> channel;
  std::vector<double> gain;

  Level(const Problem& problem, int index, const Pose& T_start)
      : problem(problem), image(problem.levels[index]), T_start(T_start) {
    const Pose T = inverse(T_start);
    const double low = problem.border - 0.5;
    for (int k = 0; k < problem.num_points; ++k) {
      const Eigen::Vector3d p_map(problem.p_map[k], problem.p_map[problem.num_points + k],
                                  problem.p_map[2 * problem.num_points + k]);
      const Eigen::Vector3d p = T.topLeftCorner<3, 3>() * p_map + T.topRightCorner<3, 1>();
      const Eigen::Vector3d q = in_camera(p);
      const double u = problem.fx * q.x() / q.z() + problem.cx, v = problem.fy * q.y() / q.z() + problem.cy;
      if (q.z() <= 1e-2 || u < low || v < low || u > problem.width - 1 - low || v > problem.height - 1 - low) continue;
      points.push_back(p);
      channel.push_back(problem.channel[k]);
      gain.push_back(image.gain * problem.weight[k]);
    }
    const Pose off = T * problem.T_prior;
    const Eigen::AngleAxisd turn(Eigen::Matrix3d(off.topLeftCorner<3, 3>()));
    y_prior << off.topRightCorner<3, 1>(), turn.angle() * turn.axis();
    y_prior = y_prior.cwiseQuotient(problem.sigma);
  }

  int num_residuals() const { return static_cast<int>(points.size()) + 6; }

  Eigen::Vector3d in_camera(const Eigen::Vector3d& p_base) const {
    return problem.T_cam_base.topLeftCorner<3, 3>() * p_base + problem.T_cam_base.topRightCorner<3, 1>();
  }

  Pose pose(const Vector6& y) const {
    const Vector6 xi = y.cwiseProduct(problem.sigma);
    Pose move = Pose::Identity();
    move.topLeftCorner<3, 3>() = rotation(xi.tail<3>());
    move.topRightCorner<3, 1>() = xi.head<3>();
    return T_start * move;
  }

  // Robust residuals and, where `jacobian` is not null, their derivative by y; stride between rows and columns as given.
  void evaluate(const double* y_data, double* r, double* jacobian, int row_step, int column_step) const {
    const Eigen::Map<const Vector6> y(y_data);
    const Vector6 xi = y.cwiseProduct(problem.sigma);
    const Eigen::Vector3d v = xi.head<3>(), omega = xi.tail<3>();
    const Eigen::Matrix3d R = rotation(omega), R_cam = problem.T_cam_base.topLeftCorner<3, 3>() * R.transpose();
    const Eigen::Vector3d t_cam = problem.T_cam_base.topRightCorner<3, 1>();
    const Eigen::Matrix3d turn = right_jacobian(omega).transpose() * R.transpose();
    const int num = static_cast<int>(points.size());
    for (int k = 0; k < num; ++k) {
      const Eigen::Vector3d lever = points[k] - v, q = R_cam * lever + t_cam;
      const double inverse_depth = 1 / std::max(q.z(), 1e-2);
      const double x = q.x() * inverse_depth, y_image = q.y() * inverse_depth;
      const Sample s = lookup(image, channel[k], problem.fx * x + problem.cx, problem.fy * y_image + problem.cy);
      const double square = std::min(s.value * s.value, 1.0);
      const double root = std::sqrt((3 - 3 * square + square * square) / 3), scale = std::sqrt(gain[k]);
      r[k] = scale * s.value * root;
      if (!jacobian) continue;
      const double slope = scale * (1 - square) * (1 - square) / root * inverse_depth;
      const double a = slope * s.du * problem.fx, b = slope * s.dv * problem.fy;
      // By the point in the vehicle frame of T_start; a turn of the vehicle moves the point by -omega x lever.
      const Eigen::Vector3d g = R_cam.transpose() * Eigen::Vector3d(a, b, -(a * x + b * y_image));
      const Eigen::Vector3d h = turn * g.cross(lever);
      for (int c = 0; c < 3; ++c) {
        jacobian[k * row_step + c * column_step] = -g[c] * problem.sigma[c];
        jacobian[k * row_step + (c + 3) * column_step] = h[c] * problem.sigma[c + 3];
      }
    }
    for (int i = 0; i < 6; ++i) {
      r[num + i] = y[i] - y_prior[i];
      for (int c = 0; jacobian && c < 6; ++c) jacobian[(num + i) * row_step + c * column_step] = i == c;
    }
  }

 private:
  static Eigen::Matrix3d right_jacobian(const Eigen::Vector3d& omega) {
    const double angle = std::max(omega.norm(), 1e-6);
    Eigen::Matrix3d W;
    W << 0, -omega.z(), omega.y(), omega.z(), 0, -omega.x(), -omega.y(), omega.x(), 0;
    W /= angle;
    return Eigen::Matrix3d::Identity() - (1 - std::cos(angle)) / angle * W + (1 - std::sin(angle) / angle) * W * W;
  }
};
