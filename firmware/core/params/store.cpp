#include "params/store.hpp"

#include <cstring>

#include "link/bytes.hpp"
#include "link/crc32.hpp"

namespace heli::params {
namespace {

constexpr std::size_t kPages = 2;
constexpr std::uint16_t kMagic = 0x5048;  // "HP"
constexpr std::uint8_t kFormat = 1;

constexpr std::size_t kMagicAt = 0;
constexpr std::size_t kFormatAt = 2;
constexpr std::size_t kCountAt = 3;
constexpr std::size_t kHashAt = 4;
constexpr std::size_t kGenerationAt = 8;
constexpr std::size_t kValuesAt = 12;
constexpr std::size_t kCrcAt = kSetBytes - 4;
static_assert(kValuesAt + 4 * link::kParamCount <= kCrcAt, "the parameters must fit one set");

enum class Content : std::uint8_t {
  erased,
  damaged,
  foreign,  // whole, but from another declaration: says nothing about this one
  valid,
};

struct Copy {
  Content content = Content::erased;
  std::uint32_t generation = 0;
};

bool all_ones(const std::uint8_t* page) {
  for (std::size_t i = 0; i < kSetBytes; ++i) {
    if (page[i] != 0xff) return false;
  }
  return true;
}

float value_at(const std::uint8_t* page, std::size_t index) {
  return link::get_f32(page + kValuesAt + 4 * index);
}

Copy judge(const std::uint8_t* page) {
  Copy copy;
  if (all_ones(page)) return copy;
  copy.content = Content::damaged;
  if (link::crc32(page, kCrcAt) != link::get_u32(page + kCrcAt)) return copy;
  copy.content = Content::foreign;
  if (link::get_u16(page + kMagicAt) != kMagic || page[kFormatAt] != kFormat ||
      page[kCountAt] != link::kParamCount || link::get_u32(page + kHashAt) != link::kLinkHash) {
    return copy;
  }
  for (std::size_t i = 0; i < link::kParamCount; ++i) {
    if (Params::check(static_cast<link::Param>(i), value_at(page, i)) != link::Result::ok) {
      return copy;
    }
  }
  copy.content = Content::valid;
  copy.generation = link::get_u32(page + kGenerationAt);
  return copy;
}

// Reads both pages through `buffer`; says which valid copy is the newest, kPages if none is valid.
std::size_t survey(Board& board, std::uint8_t* buffer, Copy (&copies)[kPages]) {
  std::size_t newest = kPages;
  for (std::size_t page = 0; page < kPages; ++page) {
    board.read_page(page, buffer, kSetBytes);
    copies[page] = judge(buffer);
    if (copies[page].content != Content::valid) continue;
    // As a signed difference, so that the count may wrap.
    if (newest == kPages ||
        static_cast<std::int32_t>(copies[page].generation - copies[newest].generation) > 0) {
      newest = page;
    }
  }
  return newest;
}

bool write_verified(Board& board, std::size_t page, const std::uint8_t* bytes) {
  if (!board.write_page(page, bytes, kSetBytes)) return false;
  std::uint8_t written[kSetBytes];
  board.read_page(page, written, kSetBytes);
  return std::memcmp(bytes, written, sizeof written) == 0;
}

}  // namespace

link::ParamsSource Store::load(Params& params) {
  std::uint8_t buffer[kSetBytes];
  Copy copies[kPages];
  const std::size_t newest = survey(board_, buffer, copies);

  params.defaults();
  link::ParamsSource source = link::ParamsSource::corrupt;
  if (newest == kPages) {
    generation_ = 0;
    // A finished save leaves no page erased: beside an erased one, page 0 was torn in the first
    // save.
    if (copies[0].content <= Content::damaged && copies[1].content == Content::erased) {
      source = link::ParamsSource::defaults;
    }
  } else {
    board_.read_page(newest, buffer, kSetBytes);
    for (std::size_t i = 0; i < link::kParamCount; ++i) {
      params.set(static_cast<link::Param>(i), value_at(buffer, i), true);
    }
    generation_ = copies[newest].generation;
    const bool other_damaged = copies[1 - newest].content == Content::damaged;
    source = other_damaged ? link::ParamsSource::fallback : link::ParamsSource::stored;
  }
  source_.store(source, std::memory_order_relaxed);
  return source;
}

bool Store::save(const Params& params) {
  std::uint8_t page[kSetBytes];
  Copy copies[kPages];
  const std::size_t newest = survey(board_, page, copies);
  // Never the newest valid copy: a power cut from here on leaves it as it is.
  const std::size_t target = newest == kPages ? 0 : 1 - newest;
  const std::uint32_t generation = newest == kPages ? 1 : copies[newest].generation + 1;

  std::memset(page, 0xff, sizeof page);
  link::put_u16(page + kMagicAt, kMagic);
  page[kFormatAt] = kFormat;
  page[kCountAt] = static_cast<std::uint8_t>(link::kParamCount);
  link::put_u32(page + kHashAt, link::kLinkHash);
  link::put_u32(page + kGenerationAt, generation);
  for (std::size_t i = 0; i < link::kParamCount; ++i) {
    link::put_f32(page + kValuesAt + 4 * i, params.data()[i]);
  }
  link::put_u32(page + kCrcAt, link::crc32(page, kCrcAt));

  if (!write_verified(board_, target, page)) return false;
  // With no valid copy beside it the set is written twice: there are two from the first save on,
  // and no damaged neighbour is taken for a newer one at the next start.
  if (newest == kPages) write_verified(board_, 1, page);
  generation_ = generation;
  source_.store(link::ParamsSource::stored, std::memory_order_relaxed);
  return true;
}

}  // namespace heli::params
