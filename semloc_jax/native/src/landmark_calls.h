// XLA custom calls of the landmarks of a window; see semloc_jax/solvers/landmark_kernels.py for their operands.
#pragma once
#include "landmarks.h"
#include "xla/ffi/api/ffi.h"

namespace semloc {

namespace ffi = xla::ffi;

inline ffi::Error Seen(ffi::RemainingArgs args, ffi::RemainingRets rets, double threshold) {
  constexpr size_t kOperands = 18, kResults = 6;
  if (args.size() != kOperands || rets.size() != kResults) return ffi::Error::InvalidArgument("landmarks: operands");
  const auto operand = [&](size_t k) { return args.get<ffi::AnyBuffer>(k).value(); };
  const auto number = [&](size_t k) { return static_cast<const double*>(operand(k).untyped_data()); };
  const auto index = [&](size_t k) { return static_cast<const int32_t*>(operand(k).untyped_data()); };
  const auto result = [&](size_t k) {
    return static_cast<double*>(rets.get<ffi::AnyBuffer>(k).value()->untyped_data());
  };
  LandmarkData in{};
  in.num_states = operand(0).dimensions()[0];
  in.num_landmarks = operand(3).dimensions()[0];
  in.num_cameras = operand(13).dimensions()[1];
  in.T_value = number(0), in.height_value = number(1), in.bend_value = number(2), in.landmark = number(3);
  in.T_at = number(4), in.height_at = number(5), in.bend_at = number(6), in.anchor = index(7), in.camera = index(8);
  in.axes = number(9), in.ray = number(10), in.pixels = number(11), in.sqrt_info = number(12);
  in.T_base_cam = number(13), in.up = number(14), in.lift = number(15), in.away = number(16), in.on_road = number(17);
  in.threshold = threshold;
  seen_equations(in, {result(0), result(1), result(2), result(3), result(4), result(5)});
  return ffi::Error::Success();
}

inline ffi::Error Eliminated(ffi::RemainingArgs args, ffi::RemainingRets rets) {
  const auto across = args.get<ffi::AnyBuffer>(0).value();
  const auto number = [&](size_t k) {
    return static_cast<const double*>(args.get<ffi::AnyBuffer>(k).value().untyped_data());
  };
  const auto result = [&](size_t k) {
    return static_cast<double*>(rets.get<ffi::AnyBuffer>(k).value()->untyped_data());
  };
  const auto shape = across.dimensions();
  if (shape.size() != 3 || shape[2] != 3) return ffi::Error::InvalidArgument("landmarks: three unknowns of each");
  eliminated(shape[0], shape[1], number(0), number(1), number(2), result(0), result(1));
  return ffi::Error::Success();
}

}  // namespace semloc
