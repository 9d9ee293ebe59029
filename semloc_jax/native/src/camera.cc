// XLA custom calls of one camera model, SEMLOC_CAMERA. Every operand may be batched by jax.vmap; see
// semloc_jax/residuals/native_kernels.py for them.
#include <cstring>

#include "observe.h"
#include "operands.h"
#include "refine.h"
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
    const Sums sums = normal_equations(camera.at<Camera>(batch, item), Motion::camera_from_map(T, place.T_local_base),
                                       points.at(batch, item), texture.at(batch, item));
    to_chart(sums, T, place.jacobian, place.sigma, hessian + 36 * item, gradient + 6 * item);
    cost[item] = sums.cost;
  });
  return nullptr;
}

// Usable pixels of all cameras [cam h w] for one of them.
Usable usable_of(const Buffer& buffer, const uint8_t* mask, int32_t camera, float scale) {
  const auto dims = buffer.dimensions();
  const int width = static_cast<int>(dims.back()), height = static_cast<int>(dims[dims.size() - 2]);
  return {mask + static_cast<int64_t>(camera) * height * width, height, width, scale};
}

// T_local_base, T_cam_base, points, usable [cam h w], its scale, camera's place, margin, camera -> weight [p].
Problem VisibleWeight(const Call& call) {
  const Batch batch(call.result(0), 1);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto T_local_base = operands.take<float>();
  const auto T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const auto usable_buffer = call.operand(5);
  const auto usable = operands.take<uint8_t>();
  const auto scale = operands.take<float>();
  const auto index = operands.take<int32_t>();
  const auto margin_px = operands.take<float>();
  const CameraOperands camera(operands);
  float* weight = call.result_data<float>(0);
  const int64_t num = points.p_map.length;
  for_each_item(call, batch.size, num, [&](int64_t item) {
    const Points filled = points.at(batch, item).filled();
    float* own = weight + num * item;
    visible_weight(camera.at<Camera>(batch, item),
                   Motion::camera_from_map(T_cam_base.at(batch, item), T_local_base.at(batch, item)), filled,
                   usable_of(usable_buffer, usable.at(batch, item), *index.at(batch, item), *scale.at(batch, item)),
                   *margin_px.at(batch, item), own);
    std::fill(own + filled.count, own + num, 0.0f);
  });
  return nullptr;
}

// Calls function(item, camera, motion into it, points, texture) for T_local_base, T_cam_base, points, texture, camera.
template <typename Function>
Problem for_each_texture(const Call& call, int core_rank, const Function& function) {
  const int32_t num_channels = call.attribute<int32_t>("num_channels");
  const Batch batch(call.result(0), core_rank);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto T_local_base = operands.take<float>();
  const auto T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const TextureOperands texture(operands, num_channels);
  const CameraOperands camera(operands);
  for_each_item(call, batch.size, points.p_map.length, [&](int64_t item) {
    function(item, camera.at<Camera>(batch, item),
             Motion::camera_from_map(T_cam_base.at(batch, item), T_local_base.at(batch, item)), points.at(batch, item),
             texture.at(batch, item));
  });
  return nullptr;
}

// Operands of for_each_texture, weights: visible -> sum of w rho / rho(1) [].
Problem RobustCost(const Call& call) {
  float* cost = call.result_data<float>(0);
  return for_each_texture(call, 0, [&](int64_t item, const Camera& camera, const Motion& T_cam_local, const Points& points,
                                       const Texture& texture) {
    cost[item] = robust_cost(camera, T_cam_local, points.filled(), texture);
  });
}

// Operands of for_each_texture -> ramp value [p].
Problem RampValues(const Call& call) {
  float* value = call.result_data<float>(0);
  return for_each_texture(call, 1, [&](int64_t item, const Camera& camera, const Motion& T_cam_local, const Points& points,
                                       const Texture& texture) {
    ramp_values(camera, T_cam_local, points, texture, value + int64_t{points.count} * item);
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

// T_local_base, T_cam_base, points, piece of each [p], usable, its scale, margin, texture, camera -> by piece: weight that
// is seen, and weight times rho [2 p].
Problem PieceSums(const Call& call) {
  const int32_t num_channels = call.attribute<int32_t>("num_channels");
  const Batch batch(call.result(0), 2);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto T_local_base = operands.take<float>(), T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const auto piece = operands.take<int32_t>();
  const auto mask_buffer = call.operand(6);
  const auto mask = operands.take<uint8_t>();
  const auto scale = operands.take<float>(), margin_px = operands.take<float>();
  const TextureOperands texture(operands, num_channels);
  const CameraOperands camera(operands);
  float* sums = call.result_data<float>(0);
  const int num = static_cast<int>(points.p_map.length);
  for_each_item(call, batch.size, num, [&](int64_t item) {
    const Usable usable = usable_of(mask_buffer, mask.at(batch, item), *texture.camera.at(batch, item), *scale.at(batch, item));
    piece_sums(camera.at<Camera>(batch, item),
               Motion::camera_from_map(T_cam_base.at(batch, item), T_local_base.at(batch, item)),
               points.at(batch, item).filled(), usable, texture.at(batch, item), *margin_px.at(batch, item),
               piece.at(batch, item), num,
               sums + 2 * int64_t{num} * item);
  });
  return nullptr;
}

// T_start, T_prior, sigma, levels [l], gains of all levels, SolveNumbers, then of all cameras of this model: T_cam_base
// [cam 4 4], points [cam ...], place in the cost maps [cam]; usable, texels, then of all levels: start, height, width,
// stride; camera [cam] -> pose after each level [l 4 4], evaluations spent there [l], whether it converged [l].
Problem Refine(const Call& call) {
  const int32_t num_channels = call.attribute<int32_t>("num_channels"), max_steps = call.attribute<int32_t>("max_steps");
  const Batch batch(call.result(1), 1);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto T_start = operands.take<float>(), T_prior = operands.take<float>(), sigma = operands.take<float>();
  const auto levels = operands.take<int32_t>();
  const auto gain = operands.take<float>(), numbers = operands.take<float>(), T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const auto place = operands.take<int32_t>();
  const auto mask_buffer = call.operand(11);
  const auto mask = operands.take<uint8_t>();
  const auto texels = operands.take<uint32_t>();
  const auto start = operands.take<int32_t>(), height = operands.take<int32_t>(), width = operands.take<int32_t>();
  const auto stride = operands.take<float>();
  const CameraOperands leaves(operands);
  const int64_t num_cameras = place.length, num_levels = levels.length, num_points = points.p_map.length;
  float* poses = call.result_data<float>(0);
  int32_t *num_steps = call.result_data<int32_t>(1), *converged = call.result_data<int32_t>(2);
  constexpr int64_t kUsualSteps = 4;
  for_each_item(call, batch.size, num_cameras * num_points * num_levels * kUsualSteps, [&](int64_t item) {
    SolveNumbers config;
    static_assert(sizeof(config) == 10 * sizeof(float), "the numbers of native_kernels.refine, in their order");
    std::memcpy(&config, numbers.at(batch, item), sizeof(config));
    const Points all = points.at(batch, item);
    const float* p = points.p_map.at(batch, item);
    std::vector<OneCamera<Camera>> cameras;
    for (int64_t k = 0; k < num_cameras; ++k) {
      std::array<const float*, CameraOperands::kMaxLeaves> leaf{};
      for (int n = 0; n < leaves.count; ++n) leaf[n] = leaves.leaf[n].at(batch, item) + k;
      const float* own = p + 3 * num_points * k;
      const Points part{own, own + num_points, own + 2 * num_points, all.channel + num_points * k,
                        all.weight + num_points * k, static_cast<int>(num_points)};
      cameras.push_back({Camera(leaf.data()), T_cam_base.at(batch, item) + 16 * k, part.filled(),
                         usable_of(mask_buffer, mask.at(batch, item), place.at(batch, item)[k], config.usable_scale), {}});
    }
    float T[12];
    std::copy_n(T_start.at(batch, item), 12, T);
    Row<float> weight;
    std::vector<Texture> textures;
    for (int64_t n = 0; n < num_levels; ++n) {
      const int32_t level = levels.at(batch, item)[n];
      textures.clear();
      for (int64_t k = 0; k < num_cameras; ++k)
        textures.emplace_back(texels.at(batch, item), start.at(batch, item)[level], height.at(batch, item)[level],
                              width.at(batch, item)[level], stride.at(batch, item)[level],
                              place.at(batch, item)[k] * num_channels);
      const Ended ended = solve_level(cameras, textures, T_prior.at(batch, item), sigma.at(batch, item),
                                      gain.at(batch, item)[level], config, max_steps, weight, T);
      const int64_t at = item * num_levels + n;
      std::copy_n(T, 12, poses + 16 * at);
      for (int k = 0; k < 4; ++k) poses[16 * at + 12 + k] = k == 3;
      num_steps[at] = ended.num_steps, converged[at] = ended.converged;
    }
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

// T_local_base, T_base_cam, samples, channel and weight of labels, grain, numbers of the view, camera -> by slot: index of
// the sample, silhouette [3], tangent [3], weight, channel, element, edge.
Problem View(const Call& call) {
  const int32_t num_ground = call.attribute<int32_t>("num_ground");
  const Batch batch(call.result(0), 1);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto T_local_base = operands.take<float>(), T_base_cam = operands.take<float>();
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
    const float low = -config.margin_share * model.width - 0.5f;
    const Limits limits{low, model.width - 1 - low, model.height - 1 - low, config.max_range};
    const MapSamples all = samples.at(batch, item);
    const Labels labels{channel.at(batch, item), class_weight.at(batch, item), num_ground};
    std::vector<int32_t> nearby;
    std::vector<Sighting> seen;
    sightings(model, Stand(T_local_base.at(batch, item), T_base_cam.at(batch, item)), all, labels, limits, config.min_ground,
              nearby, seen);
    view(seen, all, labels, *grain.at(batch, item), config, slots(item));
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
SEMLOC_CALL(semloc_piece_sums, semloc::PieceSums)
SEMLOC_CALL(semloc_refine, semloc::Refine)

// What poses [n 4 4] see of the map, not through XLA: how many rows there are is known only afterwards, and most samples
// are out of view. Rows of samples in the order of MapSamples; numbers of the borders: stride, stride of the usable
// pixels, margin, largest range, least pixels of a metre on the ground, size of a cell.
extern "C" int64_t semloc_observe(const float* const* leaves, const float* T_base_cam, const float* Ts_local_base,
                                  int32_t num_poses, const void* const* sample, int32_t num_samples,
                                  const int32_t* channel_of_label, int32_t num_ground, const float* signed_px,
                                  const uint8_t* usable, const int32_t* sizes, const float* numbers, int32_t cell_columns,
                                  int32_t* const* whole, float* const* real) {
  using namespace semloc;
  const auto floats = [&](int k) { return static_cast<const float*>(sample[k]); };
  const auto ints = [&](int k) { return static_cast<const int32_t*>(sample[k]); };
  const MapSamples samples{floats(0), floats(1), floats(2), floats(3), ints(4),    ints(5),
                           ints(6),   floats(7), floats(8), static_cast<const uint8_t*>(sample[9]), num_samples};
  const SEMLOC_CAMERA camera(leaves);
  const float low = numbers[2] - 0.5f;
  const Limits limits{low, camera.width - 1 - low, camera.height - 1 - low, numbers[3]};
  const Borders borders{signed_px, sizes[0], sizes[1], numbers[0], usable, sizes[2], sizes[3], numbers[1]};
  const SeenRows rows{whole[0], whole[1], whole[2], real[0], real[1], real[2]};
  return observe(camera, Ts_local_base, num_poses, T_base_cam, samples,
                 Labels{channel_of_label, nullptr, num_ground}, borders, limits, numbers[4], numbers[5], cell_columns, rows);
}

// Adds to nats [n] what samples [3 p] gain at poses [n 4 4], not through XLA; sizes of the gain: height, width; numbers:
// its stride, margin, largest range.
extern "C" void semloc_coarse_look(const float* const* leaves, const float* T_base_cam, const float* Ts_local_base,
                                   int32_t num_poses, const float* p, const int32_t* channel, const float* weight,
                                   int32_t num_samples, const float* gain, const int32_t* sizes, const float* numbers,
                                   float* nats) {
  using namespace semloc;
  const SEMLOC_CAMERA camera(leaves);
  const float low = numbers[1] - 0.5f;
  const Limits limits{low, camera.width - 1 - low, camera.height - 1 - low, numbers[2]};
  const Points points{p, p + num_samples, p + 2 * num_samples, channel, weight, num_samples};
  coarse_look(camera, Ts_local_base, num_poses, T_base_cam, points, gain, sizes[0], sizes[1], numbers[0], limits, nats);
}
