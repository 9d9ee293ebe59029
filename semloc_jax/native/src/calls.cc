// XLA custom calls of the alignment. Every operand may be batched by jax.vmap; see semloc_jax/residuals/native_kernels.py for them.
#include "alignment.h"
#include "batch.h"
#include "landmark_calls.h"
#include "ramps.h"
#include "view.h"

namespace semloc {
namespace {

enum class Model : int32_t { kPinhole, kBrownConrady, kKannalaBrandt, kCylindrical, kBev };

// The operands of a call in their order.
class Operands {
 public:
  Operands(ffi::RemainingArgs args, const Batch& batch) : args_(args), batch_(batch) {}
  template <typename T>
  Operand<T> take() {
    return Operand<T>(args_.get<ffi::AnyBuffer>(next_++).value(), batch_);
  }
  size_t left() const { return args_.size() - next_; }

 private:
  ffi::RemainingArgs args_;
  const Batch& batch_;
  size_t next_ = 0;
};

struct PointOperands {
  Operand<float> p_map;
  Operand<int32_t> channel;
  Operand<float> weight;
  explicit PointOperands(Operands& operands)
      : p_map(operands.take<float>()), channel(operands.take<int32_t>()), weight(operands.take<float>()) {}
  Points at(const Batch& batch, int64_t item) const {
    const float* p = p_map.at(batch, item);
    const int64_t n = p_map.length;
    return {p, p + n, p + 2 * n, channel.at(batch, item), weight.at(batch, item), static_cast<int>(n)};
  }
};

struct TextureOperands {
  Operand<uint32_t> texels;
  Operand<int32_t> start, height, width;
  Operand<float> stride;
  Operand<int32_t> camera;
  int32_t num_channels;
  TextureOperands(Operands& operands, int32_t num_channels)
      : texels(operands.take<uint32_t>()), start(operands.take<int32_t>()), height(operands.take<int32_t>()),
        width(operands.take<int32_t>()), stride(operands.take<float>()), camera(operands.take<int32_t>()),
        num_channels(num_channels) {}
  Texture at(const Batch& batch, int64_t item) const {
    return Texture(texels.at(batch, item), *start.at(batch, item), *height.at(batch, item), *width.at(batch, item),
                   *stride.at(batch, item), *camera.at(batch, item) * num_channels);
  }
};

struct CameraOperands {
  static constexpr int kMaxLeaves = 16;
  std::array<Operand<float>, kMaxLeaves> leaf;
  int count = 0;
  explicit CameraOperands(Operands& operands) {
    while (operands.left() && count < kMaxLeaves) leaf[count++] = operands.take<float>();
  }
  template <typename Camera>
  Camera at(const Batch& batch, int64_t item) const {
    std::array<const float*, kMaxLeaves> pointers{};
    for (int k = 0; k < count; ++k) pointers[k] = leaf[k].at(batch, item);
    return Camera(pointers.data());
  }
};

// Calls function(camera type tag) for the model.
template <typename Function>
void with_model(int32_t model, const Function& function) {
  switch (static_cast<Model>(model)) {
    case Model::kPinhole: return function(static_cast<Pinhole*>(nullptr));
    case Model::kBrownConrady: return function(static_cast<BrownConrady*>(nullptr));
    case Model::kKannalaBrandt: return function(static_cast<KannalaBrandt*>(nullptr));
    case Model::kCylindrical: return function(static_cast<Cylindrical*>(nullptr));
    case Model::kBev: return function(static_cast<Bev*>(nullptr));
  }
}

template <typename T>
T* result(ffi::RemainingRets& rets, size_t index) {
  return static_cast<T*>(rets.get<ffi::AnyBuffer>(index).value()->untyped_data());
}

// The chart of a solve and where in it: T_start, sigma, y.
struct ChartOperands {
  Operand<float> T_start, sigma, y;
  explicit ChartOperands(Operands& operands)
      : T_start(operands.take<float>()), sigma(operands.take<float>()), y(operands.take<float>()) {}
  struct Place {
    float T_map_base[12];
    Dual jacobian;
    const float* sigma;
  };
  Place at(const Batch& batch, int64_t item) const {
    Place place;
    place.sigma = sigma.at(batch, item);
    const float* scaled = y.at(batch, item);
    float xi[6];
    for (int k = 0; k < 6; ++k) xi[k] = place.sigma[k] * scaled[k];
    retract(T_start.at(batch, item), xi, place.T_map_base);
    place.jacobian = right_jacobian(xi);
    return place;
  }
};

// T_start, sigma, y, skip, T_cam_base, points, texture, camera -> by y: Hessian [6 6], gradient [6]; cost [].
ffi::Error NormalEquations(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets, int32_t model,
                           int32_t num_channels) {
  const Batch batch(*rets.get<ffi::AnyBuffer>(2).value(), 0);
  if (batch.rank > kMaxBatchRank) return ffi::Error::InvalidArgument("more than four axes of vmap");
  Operands operands(args, batch);
  const ChartOperands chart(operands);
  const auto skip = operands.take<bool>();
  const auto T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const TextureOperands texture(operands, num_channels);
  const CameraOperands camera(operands);
  float *hessian = result<float>(rets, 0), *gradient = result<float>(rets, 1), *cost = result<float>(rets, 2);
  with_model(model, [&](auto* tag) {
    using Camera = std::remove_pointer_t<decltype(tag)>;
    for_each_item(pool, batch.size, points.p_map.length, [&](int64_t item) {
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
  });
  return ffi::Error::Success();
}

// Hessian [6 6], gradient [6], step size -> solution of (H + I / step size) d = -g [6].
ffi::Error DampedStep(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets) {
  const Batch batch(*rets.get<ffi::AnyBuffer>(0).value(), 1);
  if (batch.rank > kMaxBatchRank) return ffi::Error::InvalidArgument("more than four axes of vmap");
  Operands operands(args, batch);
  const auto hessian = operands.take<float>(), gradient = operands.take<float>(), step_size = operands.take<float>();
  float* step = result<float>(rets, 0);
  for_each_item(pool, batch.size, 1, [&](int64_t item) {
    damped_step(hessian.at(batch, item), gradient.at(batch, item), 1.0f / *step_size.at(batch, item), step + 6 * item);
  });
  return ffi::Error::Success();
}

// u + i v, channel, texture -> value [p], its gradient by u + i v [p].
ffi::Error Lookup(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets, int32_t num_channels) {
  const Batch batch(*rets.get<ffi::AnyBuffer>(0).value(), 1);
  if (batch.rank > kMaxBatchRank) return ffi::Error::InvalidArgument("more than four axes of vmap");
  Operands operands(args, batch);
  const auto uv = operands.take<Pair>();
  const auto channel = operands.take<int32_t>();
  const TextureOperands texture(operands, num_channels);
  float* value = result<float>(rets, 0);
  Pair* slope = result<Pair>(rets, 1);
  for_each_item(pool, batch.size, uv.length, [&](int64_t item) {
    lookup(texture.at(batch, item), uv.at(batch, item), channel.at(batch, item), static_cast<int>(uv.length),
           value + item * uv.length, slope + item * uv.length);
  });
  return ffi::Error::Success();
}

// T_start, sigma, y, T_cam_base, points, d r / d (x + i y), d r / d z, r -> as NormalEquations.
ffi::Error Accumulate(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets) {
  const Batch batch(*rets.get<ffi::AnyBuffer>(2).value(), 0);
  if (batch.rank > kMaxBatchRank) return ffi::Error::InvalidArgument("more than four axes of vmap");
  Operands operands(args, batch);
  const ChartOperands chart(operands);
  const auto T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const auto slope_xy = operands.take<Pair>();
  const auto slope_z = operands.take<float>(), value = operands.take<float>();
  float *hessian = result<float>(rets, 0), *gradient = result<float>(rets, 1), *cost = result<float>(rets, 2);
  for_each_item(pool, batch.size, value.length, [&](int64_t item) {
    const auto place = chart.at(batch, item);
    const float* T = T_cam_base.at(batch, item);
    const Sums sums = accumulate(Motion::camera_from_map(T, place.T_map_base), points.at(batch, item),
                                 slope_xy.at(batch, item), slope_z.at(batch, item), value.at(batch, item));
    to_chart(sums, T, place.jacobian, place.sigma, hessian + 36 * item, gradient + 6 * item);
    cost[item] = sums.cost;
  });
  return ffi::Error::Success();
}

// T_map_base, T_cam_base, points, usable [cam h w], its scale, camera's place, margin, camera -> weight [p].
ffi::Error VisibleWeight(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets, int32_t model) {
  const Batch batch(*rets.get<ffi::AnyBuffer>(0).value(), 1);
  if (batch.rank > kMaxBatchRank) return ffi::Error::InvalidArgument("more than four axes of vmap");
  Operands operands(args, batch);
  const auto T_map_base = operands.take<float>();
  const auto T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const auto usable_dims = args.get<ffi::AnyBuffer>(5).value().dimensions();
  const auto usable = operands.take<uint8_t>();
  const auto scale = operands.take<float>();
  const auto index = operands.take<int32_t>();
  const auto margin_px = operands.take<float>();
  const CameraOperands camera(operands);
  const int width = static_cast<int>(usable_dims.back()), height = static_cast<int>(usable_dims[usable_dims.size() - 2]);
  float* weight = result<float>(rets, 0);
  with_model(model, [&](auto* tag) {
    using Camera = std::remove_pointer_t<decltype(tag)>;
    for_each_item(pool, batch.size, points.p_map.length, [&](int64_t item) {
      visible_weight(camera.at<Camera>(batch, item),
                     Motion::camera_from_map(T_cam_base.at(batch, item), T_map_base.at(batch, item)),
                     points.at(batch, item),
                     Usable{usable.at(batch, item) + static_cast<int64_t>(*index.at(batch, item)) * height * width, height,
                            width, *scale.at(batch, item)},
                     *margin_px.at(batch, item), weight + points.p_map.length * item);
    });
  });
  return ffi::Error::Success();
}

// T_map_base, T_cam_base, points (weight: visible), texture, camera -> sum of w rho / rho(1) [].
ffi::Error RobustCost(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets, int32_t model,
                      int32_t num_channels) {
  const Batch batch(*rets.get<ffi::AnyBuffer>(0).value(), 0);
  if (batch.rank > kMaxBatchRank) return ffi::Error::InvalidArgument("more than four axes of vmap");
  Operands operands(args, batch);
  const auto T_map_base = operands.take<float>();
  const auto T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const TextureOperands texture(operands, num_channels);
  const CameraOperands camera(operands);
  float* cost = result<float>(rets, 0);
  with_model(model, [&](auto* tag) {
    using Camera = std::remove_pointer_t<decltype(tag)>;
    for_each_item(pool, batch.size, points.p_map.length, [&](int64_t item) {
      cost[item] = robust_cost(camera.at<Camera>(batch, item),
                               Motion::camera_from_map(T_cam_base.at(batch, item), T_map_base.at(batch, item)),
                               points.at(batch, item), texture.at(batch, item));
    });
  });
  return ffi::Error::Success();
}

// Points in the camera frame [3 p], camera -> rows [9 p]: pixel u, v, margin of validity, their derivatives by x y z.
ffi::Error Project(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets, int32_t model) {
  const Batch batch(*rets.get<ffi::AnyBuffer>(0).value(), 2);
  if (batch.rank > kMaxBatchRank) return ffi::Error::InvalidArgument("more than four axes of vmap");
  Operands operands(args, batch);
  const auto p_cam = operands.take<float>();
  const CameraOperands camera(operands);
  float* rows = result<float>(rets, 0);
  with_model(model, [&](auto* tag) {
    using Camera = std::remove_pointer_t<decltype(tag)>;
    for_each_item(pool, batch.size, p_cam.length, [&](int64_t item) {
      project(camera.at<Camera>(batch, item), p_cam.at(batch, item), p_cam.length, rows + 9 * p_cam.length * item);
    });
  });
  return ffi::Error::Success();
}

// Rows of values [k n], index [n] -> sums of what shares an index [k num].
ffi::Error SumsByIndex(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets) {
  const auto sums_buffer = *rets.get<ffi::AnyBuffer>(0).value();
  const Batch batch(sums_buffer, 2);
  if (batch.rank > kMaxBatchRank) return ffi::Error::InvalidArgument("more than four axes of vmap");
  Operands operands(args, batch);
  const auto values = operands.take<float>();
  const auto index = operands.take<int32_t>();
  const auto dims = sums_buffer.dimensions();
  const int64_t num = dims.back(), num_rows = dims[dims.size() - 2], count = values.length;
  float* sums = result<float>(rets, 0);
  for_each_item(pool, batch.size, num_rows * count, [&](int64_t item) {
    const float* value = values.at(batch, item);
    const int32_t* place = index.at(batch, item);
    float* sum = sums + item * num_rows * num;
    std::fill_n(sum, num_rows * num, 0.0f);
    for (int64_t row = 0; row < num_rows; ++row)
      for (int64_t n = 0; n < count; ++n)
        if (place[n] >= 0 && place[n] < num) sum[row * num + place[n]] += value[row * count + n];
  });
  return ffi::Error::Success();
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
ffi::Error View(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets, int32_t model,
                int32_t num_ground) {
  const Batch batch(*rets.get<ffi::AnyBuffer>(0).value(), 1);
  if (batch.rank > kMaxBatchRank) return ffi::Error::InvalidArgument("more than four axes of vmap");
  Operands operands(args, batch);
  const auto T_map_base = operands.take<float>(), T_base_cam = operands.take<float>();
  const SampleOperands samples(operands);
  const auto channel = operands.take<int32_t>();
  const auto class_weight = operands.take<float>(), grain = operands.take<float>(), numbers = operands.take<float>();
  const CameraOperands camera(operands);
  const int64_t capacity = rets.get<ffi::AnyBuffer>(0).value()->dimensions().back();
  const auto slots = [&](int64_t item) {
    const int64_t first = item * capacity;
    return Bucket{result<int32_t>(rets, 0) + first,   result<float>(rets, 1) + 3 * first,
                  result<float>(rets, 2) + 3 * first, result<float>(rets, 3) + first,
                  result<int32_t>(rets, 4) + first,   result<int32_t>(rets, 5) + first,
                  result<int32_t>(rets, 6) + first,   static_cast<int>(capacity)};
  };
  with_model(model, [&](auto* tag) {
    using Camera = std::remove_pointer_t<decltype(tag)>;
    for_each_item(pool, batch.size, samples.offset.length, [&](int64_t item) {
      const float* number = numbers.at(batch, item);
      const ViewNumbers config{number[0], number[1], number[2], number[3], number[4],
                               number[5], number[6], number[7], number[8], number[9]};
      const Camera model = camera.at<Camera>(batch, item);
      view(AnyCamera(model), T_map_base.at(batch, item), T_base_cam.at(batch, item),
           samples.at(batch, item), Labels{channel.at(batch, item), class_weight.at(batch, item), num_ground},
           *grain.at(batch, item), config, slots(item));
    });
  });
  return ffi::Error::Success();
}

// T_map_base, T_cam_base, points, texture, camera -> ramp value [p].
ffi::Error RampValues(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets, int32_t model,
                      int32_t num_channels) {
  const Batch batch(*rets.get<ffi::AnyBuffer>(0).value(), 1);
  if (batch.rank > kMaxBatchRank) return ffi::Error::InvalidArgument("more than four axes of vmap");
  Operands operands(args, batch);
  const auto T_map_base = operands.take<float>();
  const auto T_cam_base = operands.take<float>();
  const PointOperands points(operands);
  const TextureOperands texture(operands, num_channels);
  const CameraOperands camera(operands);
  float* value = result<float>(rets, 0);
  with_model(model, [&](auto* tag) {
    using Camera = std::remove_pointer_t<decltype(tag)>;
    for_each_item(pool, batch.size, points.p_map.length, [&](int64_t item) {
      ramp_values(camera.at<Camera>(batch, item),
                  Motion::camera_from_map(T_cam_base.at(batch, item), T_map_base.at(batch, item)),
                  points.at(batch, item), texture.at(batch, item), value + points.p_map.length * item);
    });
  });
  return ffi::Error::Success();
}

// The ramps of each level [cam channel h w], as float32 or as bytes -> texels of all levels, one after another.
ffi::Error Pack(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets) {
  constexpr int64_t kPiece = 65536;
  uint32_t* texels = result<uint32_t>(rets, 0);
  for (size_t level = 0; level < args.size(); ++level) {
    const auto ramp = args.get<ffi::AnyBuffer>(level).value();
    const bool is_bytes = ramp.element_type() == ffi::DataType::U8;
    const float* values = is_bytes ? nullptr : static_cast<const float*>(ramp.untyped_data());
    const uint8_t* bytes = is_bytes ? static_cast<const uint8_t*>(ramp.untyped_data()) : nullptr;
    const int64_t count = ramp.element_count(), width = ramp.dimensions().back();
    // Without their last row and pixel, which have no neighbours, the texels stay zero.
    const int64_t num_pieces = (count + kPiece - 1) / kPiece;
    for_each_item(pool, num_pieces, kPiece, [&](int64_t piece) {
      const int64_t first = piece * kPiece, last = std::min(first + kPiece, count);
      const int64_t end = std::max(first, std::min(last, count - width - 1));
      std::vector<uint8_t> byte(is_bytes ? 0 : end - first + width + 1);
      if (!is_bytes && end > first) quantise(values + first, end - first + width + 1, byte.data());
      interleave(is_bytes ? bytes + first : byte.data(), width, end - first, texels + first);
      std::fill(texels + end, texels + last, 0u);
    });
    texels += count;
  }
  return ffi::Error::Success();
}

}  // namespace
}  // namespace semloc

#define SEMLOC_CALL(symbol, function, ...)                                                                  \
  XLA_FFI_DEFINE_HANDLER_SYMBOL(                                                                            \
      symbol, function,                                                                                     \
      xla::ffi::Ffi::Bind().Ctx<xla::ffi::ThreadPool>().RemainingArgs().RemainingRets() __VA_ARGS__)

SEMLOC_CALL(semloc_normal_equations, semloc::NormalEquations, .Attr<int32_t>("model").Attr<int32_t>("num_channels"));
SEMLOC_CALL(semloc_damped_step, semloc::DampedStep);
SEMLOC_CALL(semloc_pack, semloc::Pack);
SEMLOC_CALL(semloc_lookup, semloc::Lookup, .Attr<int32_t>("num_channels"));
SEMLOC_CALL(semloc_accumulate, semloc::Accumulate);
SEMLOC_CALL(semloc_visible_weight, semloc::VisibleWeight, .Attr<int32_t>("model"));
SEMLOC_CALL(semloc_project, semloc::Project, .Attr<int32_t>("model"));
SEMLOC_CALL(semloc_sums_by_index, semloc::SumsByIndex);
SEMLOC_CALL(semloc_view, semloc::View, .Attr<int32_t>("model").Attr<int32_t>("num_ground"));
SEMLOC_CALL(semloc_ramp_values, semloc::RampValues, .Attr<int32_t>("model").Attr<int32_t>("num_channels"));
SEMLOC_CALL(semloc_robust_cost, semloc::RobustCost, .Attr<int32_t>("model").Attr<int32_t>("num_channels"));

XLA_FFI_DEFINE_HANDLER_SYMBOL(
    semloc_seen, semloc::Seen,
    xla::ffi::Ffi::Bind().RemainingArgs().RemainingRets().Attr<double>("threshold"));
XLA_FFI_DEFINE_HANDLER_SYMBOL(semloc_eliminated, semloc::Eliminated,
                              xla::ffi::Ffi::Bind().RemainingArgs().RemainingRets());

// The levels of one channel of one camera whose stride is a multiple of `stride`, from layers uint8[height width], both
// multiples of every stride. Nothing is written where the value does not occur. level_shape: height,
// width, bytes from row to row, stride.
extern "C" void semloc_mask_ramps(const uint8_t* layers, int32_t height, int32_t width, int32_t value, int32_t stride,
                                  float blur_px, const float* keep, const float* add, float half, float outset,
                                  int32_t num_levels, uint8_t* const* bytes, const int32_t* level_shape,
                                  const float* ramp_px) {
  using namespace semloc;
  const uint8_t wanted = static_cast<uint8_t>(value);
  const Box content = box_of(layers, height, width, wanted);
  if (content.bottom == 0) return;
  std::vector<Level> levels;
  for (int n = 0; n < num_levels; ++n)
    levels.push_back({bytes[n], level_shape[4 * n], level_shape[4 * n + 1], level_shape[4 * n + 2], level_shape[4 * n + 3],
                      ramp_px[n]});
  write_levels(layers, height, width, content, wanted, stride, {blur_px, keep, add, half, outset}, levels);
}

// The ramps of each level, as bytes -> texels of all levels, one after another; `count` pixels of rows of `width`.
extern "C" void semloc_pack_bytes(int32_t num_levels, const uint8_t* const* bytes, const int64_t* count,
                                  const int64_t* width, uint32_t* texels) {
  for (int32_t level = 0; level < num_levels; ++level) {
    const int64_t end = std::max<int64_t>(0, count[level] - width[level] - 1);
    semloc::interleave(bytes[level], width[level], end, texels);
    std::fill(texels + end, texels + count[level], 0u);
    texels += count[level];
  }
}
