// A save into any flash, with a power cut or a failure at any of its writes, then a start.
#include <cmath>

#include "any.hpp"
#include "link/crc32.hpp"
#include "link/declaration.hpp"
#include "no_interrupt.hpp"

// Contract: whole numbers are any; the first parameters need not be whole.
namespace std {
inline float any_trunc(float) { return heli::proofs::any<float>(); }
}  // namespace std
#define trunc any_trunc

// The table's first parameters in a set just long enough for them: the loops are the same.
namespace heli::link {
inline constexpr std::size_t kFewParams = 1;
}
#define kParamCount kFewParams
#include "params/params.cpp"
#undef trunc
#include "params/store.hpp"
namespace heli::params {
inline constexpr std::size_t kFewBytes = 24;
}
#define kSetBytes kFewBytes
#include "params/store.cpp"
#undef kSetBytes
#undef kParamCount

using heli::params::kFewBytes;
using heli::params::Params;
using heli::params::Store;
using heli::proofs::any;

using heli::Page;

namespace {

constexpr std::size_t kChecked = kFewBytes - 4;  // bytes in front of the CRC

}  // namespace

// Contract: a function of the bytes. Their exclusive or is one that the solver takes.
std::uint32_t heli::link::crc32(const std::uint8_t* bytes, std::size_t, std::uint32_t) {
  std::uint32_t sum = 0;
  for (std::size_t i = 0; i < kChecked; i += 4) {
    sum ^= heli::link::get_u32(bytes + i);
  }
  return ~sum;
}

// Each page by its name: a page of any index is expensive for the solver.
void heli::Board::read_page(std::size_t page, std::uint8_t* to, std::size_t) {
  CLAIM(page < 2, "the store has two pages");
  const Page content = page == 0 ? first_ : second_;
  std::memcpy(to, content.bytes, kFewBytes);
}

// The write succeeds, does nothing, or leaves a page with a wrong CRC; then the power may be cut.
bool heli::Board::write_page(std::size_t page, const std::uint8_t* from, std::size_t) {
  CLAIM(page < 2, "the store has two pages");
  if (cut_) {
    return false;
  }
  cut_ = any<bool>();
  Page content = page == 0 ? first_ : second_;
  if (any<bool>()) {
    std::memcpy(content.bytes, from, kFewBytes);
  } else if (any<bool>()) {
    content = any<Page>();
    ASSUME(heli::link::crc32(content.bytes, kChecked, 0) !=
           heli::link::get_u32(content.bytes + kChecked));
  }
  if (page == 0) {
    first_ = content;
  } else {
    second_ = content;
  }
  return any<bool>();
}

namespace {

bool same_values(const Params& a, const Params& b) { return a.values_[0] == b.values_[0]; }

}  // namespace

// After a save that a power cut may end anywhere, a start finds the old or the new set.
void step_save() {
  heli::Board flash;
  flash.first_ = any<Page>();
  flash.second_ = any<Page>();
  Params before;
  Store store(flash);
  store.load(before);
  Params set;
  for (std::size_t i = 0; i < heli::link::kFewParams; ++i) {
    set.values_[i] = any<float>();
    ASSUME(Params::check(static_cast<heli::link::Param>(i), set.values_[i]) ==
           heli::link::Result::ok);
  }

  const bool saved = store.save(set);

  const bool finished = !flash.cut_;
  Params after;
  Store restarted(flash);
  restarted.load(after);
  CLAIM(same_values(after, before) || same_values(after, set), "the old or the new set");
  CLAIM(!finished || !saved || same_values(after, set), "what was saved is the new set");
}
