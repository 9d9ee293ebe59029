// A call by XLA, through its C interface: the C++ one takes a second of every build.
#pragma once
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "xla/ffi/api/c_api.h"

namespace semloc {

struct Dims {
  const int64_t* first;
  size_t count;
  size_t size() const { return count; }
  int64_t operator[](size_t k) const { return first[k]; }
  int64_t back() const { return first[count - 1]; }
};

// An operand or a result.
class Buffer {
 public:
  explicit Buffer(const void* buffer) : buffer_(static_cast<const XLA_FFI_Buffer*>(buffer)) {}
  Dims dimensions() const { return {buffer_->dims, static_cast<size_t>(buffer_->rank)}; }
  void* data() const { return buffer_->data; }
  bool is_bytes() const { return buffer_->dtype == XLA_FFI_DataType_U8; }
  int64_t element_count() const {
    int64_t count = 1;
    for (int64_t k = 0; k < buffer_->rank; ++k) count *= buffer_->dims[k];
    return count;
  }

 private:
  const XLA_FFI_Buffer* buffer_;
};

class Call {
 public:
  explicit Call(XLA_FFI_CallFrame* frame) : frame_(frame) {}

  size_t num_operands() const { return frame_->args.size; }
  size_t num_results() const { return frame_->rets.size; }
  Buffer operand(size_t k) const { return Buffer(frame_->args.args[k]); }
  Buffer result(size_t k) const { return Buffer(frame_->rets.rets[k]); }
  template <typename T>
  T* result_data(size_t k) const {
    return static_cast<T*>(result(k).data());
  }

  // A number that the caller gives by name; it has to be there.
  template <typename T>
  T attribute(const char* name) const {
    for (int64_t k = 0; k < frame_->attrs.size; ++k) {
      const XLA_FFI_ByteSpan* known = frame_->attrs.names[k];
      if (known->len == std::strlen(name) && std::memcmp(known->ptr, name, known->len) == 0)
        return *static_cast<const T*>(static_cast<const XLA_FFI_Scalar*>(frame_->attrs.attrs[k])->value);
    }
    return T{};
  }

  // Threads of XLA beside this one; 1 where it has none.
  int64_t num_threads() const {
    int64_t count = 1;
    XLA_FFI_ThreadPool_NumThreads_Args args{XLA_FFI_ThreadPool_NumThreads_Args_STRUCT_SIZE, nullptr, frame_->ctx, &count};
    return succeeds(frame_->api->XLA_FFI_ThreadPool_NumThreads(&args)) ? count : 1;
  }

  // Whether task(data) runs on another thread, sooner or later.
  bool schedule(XLA_FFI_Task* task, void* data) const {
    XLA_FFI_ThreadPool_Schedule_Args args{XLA_FFI_ThreadPool_Schedule_Args_STRUCT_SIZE, nullptr, frame_->ctx, task, data};
    return succeeds(frame_->api->XLA_FFI_ThreadPool_Schedule(&args));
  }

 private:
  bool succeeds(XLA_FFI_Error* error) const {
    if (error == nullptr) return true;
    XLA_FFI_Error_Destroy_Args args{XLA_FFI_Error_Destroy_Args_STRUCT_SIZE, nullptr, error};
    frame_->api->XLA_FFI_Error_Destroy(&args);
    return false;
  }

  XLA_FFI_CallFrame* frame_;
};

// What a kernel returns: null, or what is wrong with the call.
using Problem = const char*;

// Runs a kernel; tells the version of the interface where XLA asks for it.
inline XLA_FFI_Error* answer(XLA_FFI_CallFrame* frame, Problem (*kernel)(const Call&)) {
  const XLA_FFI_Extension_Base* asked = frame->extension_start;
  if (asked != nullptr && asked->type == XLA_FFI_Extension_Metadata) {
    XLA_FFI_Metadata* told = reinterpret_cast<const XLA_FFI_Metadata_Extension*>(asked)->metadata;
    told->api_version = {XLA_FFI_Api_Version_STRUCT_SIZE, nullptr, XLA_FFI_API_MAJOR, XLA_FFI_API_MINOR};
    told->traits = 0;
    told->state_type_id = XLA_FFI_UNKNOWN_TYPE_ID;
    return nullptr;
  }
  const Problem problem = kernel(Call(frame));
  if (problem == nullptr) return nullptr;
  XLA_FFI_Error_Create_Args args{XLA_FFI_Error_Create_Args_STRUCT_SIZE, nullptr, problem,
                                 XLA_FFI_Error_Code_INVALID_ARGUMENT};
  return frame->api->XLA_FFI_Error_Create(&args);
}

}  // namespace semloc

#define SEMLOC_CALL(symbol, kernel) \
  extern "C" XLA_FFI_Error* symbol(XLA_FFI_CallFrame* frame) { return semloc::answer(frame, &kernel); }
