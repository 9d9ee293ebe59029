// XLA custom calls of the landmarks of a window; see semloc_jax/solvers/landmark_kernels.py for their operands.
#include "frame.h"
#include "landmarks.h"

namespace semloc {

namespace {

Problem Seen(const Call& call) {
  constexpr size_t kOperands = 18, kResults = 6;
  if (call.num_operands() != kOperands || call.num_results() != kResults) return "landmarks: operands";
  const auto number = [&](size_t k) { return static_cast<const double*>(call.operand(k).data()); };
  const auto index = [&](size_t k) { return static_cast<const int32_t*>(call.operand(k).data()); };
  const auto result = [&](size_t k) { return call.result_data<double>(k); };
  LandmarkData in{};
  in.num_states = call.operand(0).dimensions()[0];
  in.num_landmarks = call.operand(3).dimensions()[0];
  in.num_cameras = call.operand(13).dimensions()[1];
  in.T_value = number(0), in.height_value = number(1), in.bend_value = number(2), in.landmark = number(3);
  in.T_at = number(4), in.height_at = number(5), in.bend_at = number(6), in.anchor = index(7), in.camera = index(8);
  in.axes = number(9), in.ray = number(10), in.pixels = number(11), in.sqrt_info = number(12);
  in.T_base_cam = number(13), in.up = number(14), in.lift = number(15), in.away = number(16), in.on_road = number(17);
  in.threshold = call.attribute<double>("threshold");
  seen_equations(in, {result(0), result(1), result(2), result(3), result(4), result(5)});
  return nullptr;
}

Problem Eliminated(const Call& call) {
  const auto across = call.operand(0);
  const auto number = [&](size_t k) { return static_cast<const double*>(call.operand(k).data()); };
  const auto result = [&](size_t k) { return call.result_data<double>(k); };
  const auto shape = across.dimensions();
  if (shape.size() != 3 || shape[2] != 3) return "landmarks: three unknowns of each";
  eliminated(shape[0], shape[1], number(0), number(1), number(2), result(0), result(1));
  return nullptr;
}

}  // namespace
}  // namespace semloc

SEMLOC_CALL(semloc_seen, semloc::Seen)
SEMLOC_CALL(semloc_eliminated, semloc::Eliminated)
