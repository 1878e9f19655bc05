// Writes and reads little-endian numbers in byte arrays, for any alignment and any byte order of
// the machine.
#pragma once

#include <cstdint>
#include <cstring>

namespace heli::link {

inline void put_u8(std::uint8_t* to, std::uint8_t value) { to[0] = value; }

inline void put_u16(std::uint8_t* to, std::uint16_t value) {
  to[0] = static_cast<std::uint8_t>(value & 0xffU);
  to[1] = static_cast<std::uint8_t>(value >> 8U);
}

inline void put_u32(std::uint8_t* to, std::uint32_t value) {
  put_u16(to, static_cast<std::uint16_t>(value & 0xffffU));
  put_u16(to + 2, static_cast<std::uint16_t>(value >> 16U));
}

inline void put_u64(std::uint8_t* to, std::uint64_t value) {
  put_u32(to, static_cast<std::uint32_t>(value & 0xffffffffU));
  put_u32(to + 4, static_cast<std::uint32_t>(value >> 32U));
}

inline void put_i16(std::uint8_t* to, std::int16_t value) {
  put_u16(to, static_cast<std::uint16_t>(value));
}

inline void put_i32(std::uint8_t* to, std::int32_t value) {
  put_u32(to, static_cast<std::uint32_t>(value));
}

inline void put_f32(std::uint8_t* to, float value) {
  std::uint32_t bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  put_u32(to, bits);
}

inline std::uint8_t get_u8(const std::uint8_t* from) { return from[0]; }

inline std::uint16_t get_u16(const std::uint8_t* from) {
  return static_cast<std::uint16_t>(from[0] | (from[1] << 8U));
}

inline std::uint32_t get_u32(const std::uint8_t* from) {
  return static_cast<std::uint32_t>(get_u16(from)) |
         (static_cast<std::uint32_t>(get_u16(from + 2)) << 16U);
}

inline std::uint64_t get_u64(const std::uint8_t* from) {
  return static_cast<std::uint64_t>(get_u32(from)) |
         (static_cast<std::uint64_t>(get_u32(from + 4)) << 32U);
}

inline std::int16_t get_i16(const std::uint8_t* from) {
  return static_cast<std::int16_t>(get_u16(from));
}

inline std::int32_t get_i32(const std::uint8_t* from) {
  return static_cast<std::int32_t>(get_u32(from));
}

inline float get_f32(const std::uint8_t* from) {
  const std::uint32_t bits = get_u32(from);
  float value = 0.0F;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

}  // namespace heli::link
