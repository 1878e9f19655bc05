// Layout, check and writing of the two stored sets; see store.hpp and README.md. Idle loop.
#include "params/store.hpp"

#include <cstring>

#include "link/bytes.hpp"
#include "link/crc32.hpp"

namespace heli::params {
namespace {

constexpr std::size_t kPages = 2;
constexpr std::uint16_t kMagic = 0x5048;  // "HP"
constexpr std::uint8_t kFormat = 2;

// Byte offsets within a set.
constexpr std::size_t kMagicAt = 0;
constexpr std::size_t kFormatAt = 2;
constexpr std::size_t kCountAt = 3;
constexpr std::size_t kHashAt = 4;
constexpr std::size_t kGenerationAt = 8;
constexpr std::size_t kValuesAt = 12;
constexpr std::size_t kCrcAt = kSetBytes - 4;
constexpr std::size_t kEntryBytes = 6;  // number of the parameter, then its value
constexpr std::size_t kMaxEntries = (kCrcAt - kValuesAt) / kEntryBytes;
static_assert(link::kParamCount <= kMaxEntries, "the parameters must fit one set");
static_assert(link::kParamCount <= 8 * sizeof(Origin::fresh), "a bit for each parameter");

enum class Content : std::uint8_t {
  erased,
  damaged,  // the CRC does not match
  foreign,  // whole, but of another format, or with values that its own schema forbids
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

float value_at(const std::uint8_t* page, std::size_t entry) {
  return link::get_f32(page + kValuesAt + kEntryBytes * entry + 2);
}

// Returns the parameter of a stored entry, kParamCount if it is unknown.
std::size_t parameter_at(const std::uint8_t* page, std::size_t entry) {
  const std::uint16_t id = link::get_u16(page + kValuesAt + kEntryBytes * entry);
  std::size_t index = 0;
  while (index < link::kParamCount && link::kParams[index].id != id) {
    ++index;
  }
  return index;
}

bool same_schema(const std::uint8_t* page) {
  return link::get_u32(page + kHashAt) == link::kParamsHash;
}

// What a page contains.
Copy classify(const std::uint8_t* page) {
  Copy copy;
  if (all_ones(page)) return copy;
  copy.content = Content::damaged;
  if (link::crc32(page, kCrcAt) != link::get_u32(page + kCrcAt)) return copy;
  copy.content = Content::foreign;
  if (link::get_u16(page + kMagicAt) != kMagic || page[kFormatAt] != kFormat ||
      page[kCountAt] > kMaxEntries) {
    return copy;
  }
  // Under another schema a value may be out of range here: load() drops it.
  for (std::size_t i = 0; same_schema(page) && i < page[kCountAt]; ++i) {
    const auto which = static_cast<link::Param>(parameter_at(page, i));
    if (Params::check(which, value_at(page, i)) != link::Result::ok) {
      return copy;
    }
  }
  copy.content = Content::valid;
  copy.generation = link::get_u32(page + kGenerationAt);
  return copy;
}

// Reads both pages through `buffer`. Returns the page of the newest valid copy, kPages if there is
// none.
std::size_t find_newest(Board& board, std::uint8_t* buffer, Copy (&copies)[kPages]) {
  std::size_t newest = kPages;
  for (std::size_t page = 0; page < kPages; ++page) {
    board.read_page(page, buffer, kSetBytes);
    copies[page] = classify(buffer);
    if (copies[page].content != Content::valid) continue;
    // As a signed difference, so that the count may wrap.
    if (newest == kPages ||
        static_cast<std::int32_t>(copies[page].generation - copies[newest].generation) > 0) {
      newest = page;
    }
  }
  return newest;
}

// Copies the stored values that are still valid into `params`, which has its defaults.
Origin load_values(const std::uint8_t* page, Params& params) {
  Origin origin;
  origin.schema = link::get_u32(page + kHashAt);
  for (std::size_t i = 0; i < link::kParamCount; ++i) {
    origin.fresh[i / 32U] |= 1U << (i % 32U);
  }
  for (std::size_t entry = 0; entry < page[kCountAt]; ++entry) {
    const std::size_t index = parameter_at(page, entry);
    if (params.set(static_cast<link::Param>(index), value_at(page, entry), true) ==
        link::Result::ok) {
      origin.fresh[index / 32U] &= ~(1U << (index % 32U));
      ++origin.kept;
    } else {
      ++origin.dropped;
    }
  }
  return origin;
}

// Writes a page and compares what can be read back.
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
  const std::size_t newest = find_newest(board_, buffer, copies);

  params.defaults();
  origin_ = {};
  link::ParamsSource source = link::ParamsSource::corrupt;
  if (newest == kPages) {
    generation_ = 0;
    // A finished save leaves no page erased. If page 1 is erased, then either nothing was ever
    // saved, or the first save was interrupted.
    if (copies[0].content <= Content::damaged && copies[1].content == Content::erased) {
      source = link::ParamsSource::defaults;
    }
  } else {
    board_.read_page(newest, buffer, kSetBytes);
    origin_ = load_values(buffer, params);
    generation_ = copies[newest].generation;
    const bool other_damaged = copies[1 - newest].content == Content::damaged;
    source = !same_schema(buffer) ? link::ParamsSource::migrated
             : other_damaged      ? link::ParamsSource::fallback
                                  : link::ParamsSource::stored;
  }
  source_.store(source, std::memory_order_relaxed);
  return source;
}

void Store::drop(Params& params, link::Param which) {
  const auto index = static_cast<std::size_t>(which);
  params.set(which, link::kParams[index].initial, true);
  origin_.fresh[index / 32U] |= 1U << (index % 32U);
  --origin_.kept;
  ++origin_.dropped;
  source_.store(link::ParamsSource::migrated, std::memory_order_relaxed);
}

bool Store::save(const Params& params) {
  std::uint8_t page[kSetBytes];
  Copy copies[kPages];
  const std::size_t newest = find_newest(board_, page, copies);
  // Never the newest valid copy: a power cut from here on leaves it as it is.
  const std::size_t target = newest == kPages ? 0 : 1 - newest;
  const std::uint32_t generation = newest == kPages ? 1 : copies[newest].generation + 1;

  std::memset(page, 0xff, sizeof page);
  link::put_u16(page + kMagicAt, kMagic);
  page[kFormatAt] = kFormat;
  page[kCountAt] = static_cast<std::uint8_t>(link::kParamCount);
  link::put_u32(page + kHashAt, link::kParamsHash);
  link::put_u32(page + kGenerationAt, generation);
  for (std::size_t i = 0; i < link::kParamCount; ++i) {
    link::put_u16(page + kValuesAt + kEntryBytes * i, link::kParams[i].id);
    link::put_f32(page + kValuesAt + kEntryBytes * i + 2, params.data()[i]);
  }
  link::put_u32(page + kCrcAt, link::crc32(page, kCrcAt));

  if (!write_verified(board_, target, page)) return false;
  // Without another valid copy, the set is written to both pages: then there are two from the first
  // save on, and the next start does not find a damaged page, which would read as `fallback`.
  if (newest == kPages) write_verified(board_, 1, page);
  generation_ = generation;
  origin_ = {};
  origin_.schema = link::kParamsHash;
  origin_.kept = static_cast<std::uint8_t>(link::kParamCount);
  source_.store(link::ParamsSource::stored, std::memory_order_relaxed);
  return true;
}

}  // namespace heli::params
