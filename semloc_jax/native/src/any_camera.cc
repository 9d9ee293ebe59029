// XLA custom calls around JAX's derivative of any camera. Every operand may be batched by jax.vmap; see
// semloc_jax/residuals/native_kernels.py for them.
#include "operands.h"

namespace semloc {
namespace {

// u + i v, channel, texture -> value [p], its gradient by u + i v [p].
Problem Lookup(const Call& call) {
  const int32_t num_channels = call.attribute<int32_t>("num_channels");
  const Batch batch(call.result(0), 1);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto uv = operands.take<Pair>();
  const auto channel = operands.take<int32_t>();
  const TextureOperands texture(operands, num_channels);
  float* value = call.result_data<float>(0);
  Pair* slope = call.result_data<Pair>(1);
  for_each_item(call, batch.size, uv.length, [&](int64_t item) {
    lookup(texture.at(batch, item), uv.at(batch, item), channel.at(batch, item), static_cast<int>(uv.length),
           value + item * uv.length, slope + item * uv.length);
  });
  return nullptr;
}

// T_start, sigma, y, T_cam_base, points, d r / d (x + i y), d r / d z, r -> as NormalEquations.
Problem Accumulate(const Call& call) {
  const Batch batch(call.result(2), 0);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const ChartOperands chart(operands);
  const auto T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const auto slope_xy = operands.take<Pair>();
  const auto slope_z = operands.take<float>(), value = operands.take<float>();
  float *hessian = call.result_data<float>(0), *gradient = call.result_data<float>(1), *cost = call.result_data<float>(2);
  for_each_item(call, batch.size, value.length, [&](int64_t item) {
    const auto place = chart.at(batch, item);
    const float* T = T_cam_base.at(batch, item);
    const Sums sums = accumulate(Motion::camera_from_map(T, place.T_local_base), points.at(batch, item),
                                 slope_xy.at(batch, item), slope_z.at(batch, item), value.at(batch, item));
    to_chart(sums, T, place.jacobian, place.sigma, hessian + 36 * item, gradient + 6 * item);
    cost[item] = sums.cost;
  });
  return nullptr;
}

}  // namespace
}  // namespace semloc

SEMLOC_CALL(semloc_lookup, semloc::Lookup)
SEMLOC_CALL(semloc_accumulate, semloc::Accumulate)
