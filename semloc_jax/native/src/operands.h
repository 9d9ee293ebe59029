// The operands that several kernels take, in the order in which semloc_jax/residuals/native_kernels.py gives them.
#pragma once
#include "alignment.h"
#include "batch.h"

namespace semloc {

constexpr Problem kTooManyAxes = "more than four axes of vmap";

// The operands of a call in their order.
class Operands {
 public:
  Operands(const Call& call, const Batch& batch) : call_(call), batch_(batch) {}
  template <typename T>
  Operand<T> take() {
    return Operand<T>(call_.operand(next_++), batch_);
  }
  size_t left() const { return call_.num_operands() - next_; }

 private:
  const Call& call_;
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

// The chart of a solve and where in it: T_start, sigma, y.
struct ChartOperands {
  Operand<float> T_start, sigma, y;
  explicit ChartOperands(Operands& operands)
      : T_start(operands.take<float>()), sigma(operands.take<float>()), y(operands.take<float>()) {}
  struct Place {
    float T_local_base[12];
    Dual jacobian;
    const float* sigma;
  };
  Place at(const Batch& batch, int64_t item) const {
    Place place;
    place.sigma = sigma.at(batch, item);
    const float* scaled = y.at(batch, item);
    float xi[6];
    for (int k = 0; k < 6; ++k) xi[k] = place.sigma[k] * scaled[k];
    retract(T_start.at(batch, item), xi, place.T_local_base);
    place.jacobian = right_jacobian(xi);
    return place;
  }
};

}  // namespace semloc
