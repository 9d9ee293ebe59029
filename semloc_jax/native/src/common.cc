// XLA custom calls that know no camera, and masks. Every operand may be batched by jax.vmap; see
// semloc_jax/residuals/native_kernels.py for them.
#include "operands.h"
#include "ramps.h"

namespace semloc {
namespace {

// Hessian [6 6], gradient [6], step size -> solution of (H + I / step size) d = -g [6].
Problem DampedStep(const Call& call) {
  const Batch batch(call.result(0), 1);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto hessian = operands.take<float>(), gradient = operands.take<float>(), step_size = operands.take<float>();
  float* step = call.result_data<float>(0);
  for_each_item(call, batch.size, 1, [&](int64_t item) {
    damped_step(hessian.at(batch, item), gradient.at(batch, item), 1.0f / *step_size.at(batch, item), step + 6 * item);
  });
  return nullptr;
}

// Rows of values [k n], index [n] -> sums of what shares an index [k num].
Problem SumsByIndex(const Call& call) {
  const auto sums_buffer = call.result(0);
  const Batch batch(sums_buffer, 2);
  if (batch.rank > kMaxBatchRank) return kTooManyAxes;
  Operands operands(call, batch);
  const auto values = operands.take<float>();
  const auto index = operands.take<int32_t>();
  const auto dims = sums_buffer.dimensions();
  const int64_t num = dims.back(), num_rows = dims[dims.size() - 2], count = values.length;
  float* sums = call.result_data<float>(0);
  for_each_item(call, batch.size, num_rows * count, [&](int64_t item) {
    const float* value = values.at(batch, item);
    const int32_t* place = index.at(batch, item);
    float* sum = sums + item * num_rows * num;
    std::fill_n(sum, num_rows * num, 0.0f);
    for (int64_t row = 0; row < num_rows; ++row)
      for (int64_t n = 0; n < count; ++n)
        if (place[n] >= 0 && place[n] < num) sum[row * num + place[n]] += value[row * count + n];
  });
  return nullptr;
}

// The ramps of each level [cam channel h w], as float32 or as bytes -> texels of all levels, one after another.
Problem Pack(const Call& call) {
  constexpr int64_t kPiece = 65536;
  uint32_t* texels = call.result_data<uint32_t>(0);
  for (size_t level = 0; level < call.num_operands(); ++level) {
    const auto ramp = call.operand(level);
    const bool is_bytes = ramp.is_bytes();
    const float* values = is_bytes ? nullptr : static_cast<const float*>(ramp.data());
    const uint8_t* bytes = is_bytes ? static_cast<const uint8_t*>(ramp.data()) : nullptr;
    const int64_t count = ramp.element_count(), width = ramp.dimensions().back();
    // Without their last row and pixel, which have no neighbours, the texels stay zero.
    const int64_t num_pieces = (count + kPiece - 1) / kPiece;
    for_each_item(call, num_pieces, kPiece, [&](int64_t piece) {
      const int64_t first = piece * kPiece, last = std::min(first + kPiece, count);
      const int64_t end = std::max(first, std::min(last, count - width - 1));
      std::vector<uint8_t> byte(is_bytes ? 0 : end - first + width + 1);
      if (!is_bytes && end > first) quantise(values + first, end - first + width + 1, byte.data());
      interleave(is_bytes ? bytes + first : byte.data(), width, end - first, texels + first);
      std::fill(texels + end, texels + last, 0u);
    });
    texels += count;
  }
  return nullptr;
}

}  // namespace
}  // namespace semloc

SEMLOC_CALL(semloc_damped_step, semloc::DampedStep)
SEMLOC_CALL(semloc_sums_by_index, semloc::SumsByIndex)
SEMLOC_CALL(semloc_pack, semloc::Pack)

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
