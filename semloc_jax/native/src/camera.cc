// XLA custom calls of one camera model, SEMLOC_CAMERA. Every operand may be batched by jax.vmap; see
// semloc_jax/residuals/native_kernels.py for them.
#include "operands.h"
#include "view.h"

namespace semloc {
namespace {

using Camera = SEMLOC_CAMERA;

// T_start, sigma, y, skip, T_cam_base, points, texture, camera -> by y: Hessian [6 6], gradient [6]; cost [].
Problem NormalEquations(const Call& call) {
  const int32_t num_channels = call.attribute<int32_t>("num_channels");
  const Batch batch(call.result(2), 0);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const ChartOperands chart(operands);
  const auto skip = operands.take<bool>();
  const auto T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const TextureOperands texture(operands, num_channels);
  const CameraOperands camera(operands);
  float *hessian = call.result_data<float>(0), *gradient = call.result_data<float>(1), *cost = call.result_data<float>(2);
  for_each_item(call, batch.size, points.p_map.length, [&](int64_t item) {
    cost[item] = 0;
    std::fill_n(hessian + 36 * item, 36, 0.0f);
    std::fill_n(gradient + 6 * item, 6, 0.0f);
    if (*skip.at(batch, item)) return;
    const auto place = chart.at(batch, item);
    const float* T = T_cam_base.at(batch, item);
    const Sums sums = normal_equations(camera.at<Camera>(batch, item), Motion::camera_from_map(T, place.T_map_base),
                                       points.at(batch, item), texture.at(batch, item));
    to_chart(sums, T, place.jacobian, place.sigma, hessian + 36 * item, gradient + 6 * item);
    cost[item] = sums.cost;
  });
  return nullptr;
}

// T_map_base, T_cam_base, points, usable [cam h w], its scale, camera's place, margin, camera -> weight [p].
Problem VisibleWeight(const Call& call) {
  const Batch batch(call.result(0), 1);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto T_map_base = operands.take<float>();
  const auto T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const auto usable_dims = call.operand(5).dimensions();
  const auto usable = operands.take<uint8_t>();
  const auto scale = operands.take<float>();
  const auto index = operands.take<int32_t>();
  const auto margin_px = operands.take<float>();
  const CameraOperands camera(operands);
  const int width = static_cast<int>(usable_dims.back()), height = static_cast<int>(usable_dims[usable_dims.size() - 2]);
  float* weight = call.result_data<float>(0);
  for_each_item(call, batch.size, points.p_map.length, [&](int64_t item) {
    visible_weight(camera.at<Camera>(batch, item),
                   Motion::camera_from_map(T_cam_base.at(batch, item), T_map_base.at(batch, item)),
                   points.at(batch, item),
                   Usable{usable.at(batch, item) + static_cast<int64_t>(*index.at(batch, item)) * height * width, height,
                          width, *scale.at(batch, item)},
                   *margin_px.at(batch, item), weight + points.p_map.length * item);
  });
  return nullptr;
}

// Calls function(item, camera, motion into it, points, texture) for T_map_base, T_cam_base, points, texture, camera.
template <typename Function>
Problem for_each_texture(const Call& call, int core_rank, const Function& function) {
  const int32_t num_channels = call.attribute<int32_t>("num_channels");
  const Batch batch(call.result(0), core_rank);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto T_map_base = operands.take<float>();
  const auto T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const TextureOperands texture(operands, num_channels);
  const CameraOperands camera(operands);
  for_each_item(call, batch.size, points.p_map.length, [&](int64_t item) {
    function(item, camera.at<Camera>(batch, item),
             Motion::camera_from_map(T_cam_base.at(batch, item), T_map_base.at(batch, item)), points.at(batch, item),
             texture.at(batch, item));
  });
  return nullptr;
}

// Operands of for_each_texture, weights: visible -> sum of w rho / rho(1) [].
Problem RobustCost(const Call& call) {
  float* cost = call.result_data<float>(0);
  return for_each_texture(call, 0, [&](int64_t item, const Camera& camera, const Motion& T_cam_map, const Points& points,
                                       const Texture& texture) {
    cost[item] = robust_cost(camera, T_cam_map, points, texture);
  });
}

// Operands of for_each_texture -> ramp value [p].
Problem RampValues(const Call& call) {
  float* value = call.result_data<float>(0);
  return for_each_texture(call, 1, [&](int64_t item, const Camera& camera, const Motion& T_cam_map, const Points& points,
                                       const Texture& texture) {
    ramp_values(camera, T_cam_map, points, texture, value + int64_t{points.count} * item);
  });
}

// Points in the camera frame [3 p], camera -> rows [9 p]: pixel u, v, margin of validity, their derivatives by x y z.
Problem Project(const Call& call) {
  const Batch batch(call.result(0), 2);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto p_cam = operands.take<float>();
  const CameraOperands camera(operands);
  float* rows = call.result_data<float>(0);
  for_each_item(call, batch.size, p_cam.length, [&](int64_t item) {
    project(camera.at<Camera>(batch, item), p_cam.at(batch, item), p_cam.length, rows + 9 * p_cam.length * item);
  });
  return nullptr;
}

struct SampleOperands {
  Operand<float> p, tangent, offset, length;
  Operand<int32_t> label, kind, element;
  Operand<float> center, height_sigma;
  Operand<uint8_t> valid;
  explicit SampleOperands(Operands& operands)
      : p(operands.take<float>()), tangent(operands.take<float>()), offset(operands.take<float>()),
        length(operands.take<float>()), label(operands.take<int32_t>()), kind(operands.take<int32_t>()),
        element(operands.take<int32_t>()), center(operands.take<float>()), height_sigma(operands.take<float>()),
        valid(operands.take<uint8_t>()) {}
  MapSamples at(const Batch& batch, int64_t item) const {
    return {p.at(batch, item),      tangent.at(batch, item), offset.at(batch, item), length.at(batch, item),
            label.at(batch, item),  kind.at(batch, item),    element.at(batch, item), center.at(batch, item),
            height_sigma.at(batch, item), valid.at(batch, item), static_cast<int>(offset.length)};
  }
};

// T_map_base, T_base_cam, samples, channel and weight of labels, grain, numbers of the view, camera -> by slot: index of
// the sample, silhouette [3], tangent [3], weight, channel, element, edge.
Problem View(const Call& call) {
  const int32_t num_ground = call.attribute<int32_t>("num_ground");
  const Batch batch(call.result(0), 1);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto T_map_base = operands.take<float>(), T_base_cam = operands.take<float>();
  const SampleOperands samples(operands);
  const auto channel = operands.take<int32_t>();
  const auto class_weight = operands.take<float>(), grain = operands.take<float>(), numbers = operands.take<float>();
  const CameraOperands camera(operands);
  const int64_t capacity = call.result(0).dimensions().back();
  const auto slots = [&](int64_t item) {
    const int64_t first = item * capacity;
    return Bucket{call.result_data<int32_t>(0) + first,   call.result_data<float>(1) + 3 * first,
                  call.result_data<float>(2) + 3 * first, call.result_data<float>(3) + first,
                  call.result_data<int32_t>(4) + first,   call.result_data<int32_t>(5) + first,
                  call.result_data<int32_t>(6) + first,   static_cast<int>(capacity)};
  };
  for_each_item(call, batch.size, samples.offset.length, [&](int64_t item) {
    const float* number = numbers.at(batch, item);
    const ViewNumbers config{number[0], number[1], number[2], number[3], number[4],
                             number[5], number[6], number[7], number[8], number[9]};
    const Camera model = camera.at<Camera>(batch, item);
    view(AnyCamera(model), T_map_base.at(batch, item), T_base_cam.at(batch, item),
         samples.at(batch, item), Labels{channel.at(batch, item), class_weight.at(batch, item), num_ground},
         *grain.at(batch, item), config, slots(item));
  });
  return nullptr;
}

}  // namespace
}  // namespace semloc

SEMLOC_CALL(semloc_normal_equations, semloc::NormalEquations)
SEMLOC_CALL(semloc_visible_weight, semloc::VisibleWeight)
SEMLOC_CALL(semloc_robust_cost, semloc::RobustCost)
SEMLOC_CALL(semloc_project, semloc::Project)
SEMLOC_CALL(semloc_view, semloc::View)
SEMLOC_CALL(semloc_ramp_values, semloc::RampValues)
