// Packs samples: per channel the first value, then differences of the smallest width that holds
// all. Idle loop.
#include "link/telemetry.hpp"

#include "link/bytes.hpp"

namespace heli::link {
namespace {

constexpr std::size_t kWidthBytes = (kChannelCount + 1) / 2;

constexpr std::size_t base_bytes() {
  std::size_t sum = 0;
  for (const std::uint8_t bytes : kChannelBytes) sum += bytes;
  return sum;
}

constexpr std::size_t kHeadBytes = TelemetryMessage::kSize + kWidthBytes + base_bytes();
static_assert(kHeadBytes <= kMaxTelemetryPayload, "one sample must fit, so that halving ends");

// Bits of a delta by width code: 0, 2, 4, 8, 16, 32.
constexpr std::uint32_t bits_of(std::uint32_t width) { return width == 0 ? 0U : 1U << width; }

// Difference of a channel from sample k - 1 to sample k; wraps.
std::uint32_t delta(const Sample* samples, std::size_t k, std::size_t channel) {
  return static_cast<std::uint32_t>(samples[k].raw[channel]) -
         static_cast<std::uint32_t>(samples[k - 1].raw[channel]);
}

// Width code of the narrowest two's complement that holds all deltas of one channel. `any_bits` is
// the OR of the deltas; `magnitude` that of each delta with its own sign bit removed from all bits.
std::uint32_t width_of(std::uint32_t any_bits, std::uint32_t magnitude) {
  if (any_bits == 0) return 0;
  if (magnitude < 0x2U) return 1;
  if (magnitude < 0x8U) return 2;
  if (magnitude < 0x80U) return 3;
  return magnitude < 0x8000U ? 4 : 5;
}

// Fills in the width codes; returns the length of the payload.
std::size_t choose_widths(const Sample* samples, std::size_t count, std::uint32_t* widths) {
  std::size_t bytes = kHeadBytes;
  for (std::size_t channel = 0; channel < kChannelCount; ++channel) {
    std::uint32_t any_bits = 0;
    std::uint32_t magnitude = 0;
    for (std::size_t k = 1; k < count; ++k) {
      const std::uint32_t difference = delta(samples, k, channel);
      any_bits |= difference;
      magnitude |= (difference & 0x80000000U) != 0 ? ~difference : difference;
    }
    widths[channel] = width_of(any_bits, magnitude);
    bytes += ((count - 1) * bits_of(widths[channel]) + 7) >> 3U;
  }
  return bytes;
}

// Packs the differences of a channel, `bits` each, lowest bit first, and fills the last byte with
// zeros; returns the position behind them.
std::uint8_t* put_deltas(const Sample* samples, std::size_t count, std::size_t channel,
                         std::uint32_t bits, std::uint8_t* to) {
  // A shift by 32 bits, as the mask below would need, is undefined.
  if (bits == 32) {
    for (std::size_t k = 1; k < count; ++k, to += 4) put_u32(to, delta(samples, k, channel));
    return to;
  }
  const std::uint32_t mask = (1U << bits) - 1U;
  // Bits that do not fill a byte yet: at most 7, and 16 of a new difference.
  std::uint32_t pending = 0;
  std::uint32_t pending_bits = 0;
  for (std::size_t k = 1; k < count; ++k) {
    pending |= (delta(samples, k, channel) & mask) << pending_bits;
    pending_bits += bits;
    for (; pending_bits >= 8; pending_bits -= 8, pending >>= 8U) {
      *to++ = static_cast<std::uint8_t>(pending & 0xffU);
    }
  }
  if (pending_bits > 0) *to++ = static_cast<std::uint8_t>(pending);
  return to;
}

// Writes a channel's first value in the bytes of its type; returns the position behind it.
std::uint8_t* put_base(std::int32_t raw, std::uint8_t bytes, std::uint8_t* to) {
  if (bytes == 1) {
    put_u8(to, static_cast<std::uint8_t>(raw));
  } else if (bytes == 2) {
    put_i16(to, static_cast<std::int16_t>(raw));
  } else {
    put_i32(to, raw);
  }
  return to + bytes;
}

}  // namespace

Packed pack_batch(const Sample* samples, std::size_t count, std::uint8_t* to) {
  std::uint32_t widths[kWidthBytes * 2] = {};
  std::size_t bytes = choose_widths(samples, count, widths);
  while (bytes > kMaxTelemetryPayload) {
    count >>= 1U;
    bytes = choose_widths(samples, count, widths);
  }

  // Head, width codes (two per byte), first values, differences.
  TelemetryMessage head;
  head.first_tick = samples[0].tick;
  head.count = static_cast<std::uint8_t>(count);
  head.write(to);
  to += TelemetryMessage::kSize;
  for (std::size_t i = 0; i < kWidthBytes; ++i) {
    *to++ = static_cast<std::uint8_t>(widths[2 * i] | (widths[2 * i + 1] << 4U));
  }
  for (std::size_t channel = 0; channel < kChannelCount; ++channel) {
    to = put_base(samples[0].raw[channel], kChannelBytes[channel], to);
  }
  for (std::size_t channel = 0; channel < kChannelCount; ++channel) {
    if (widths[channel] == 0) continue;
    to = put_deltas(samples, count, channel, bits_of(widths[channel]), to);
  }
  return {count, bytes};
}

}  // namespace heli::link
