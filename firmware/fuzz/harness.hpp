// Shared by the fuzz targets: a board in memory that checks each call of the flight code.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <vector>

#include "board.hpp"
#include "flight_code.hpp"
#include "link/bytes.hpp"
#include "link/cobs.hpp"
#include "link/crc32.hpp"
#include "link/declaration.hpp"
#include "link/frame_writer.hpp"

namespace heli_fuzz {

using heli::link::State;

// Ends the run if a claim is false; the fuzzer keeps the input that led here.
inline void require(bool claim, const char* text) {
  if (claim) return;
  std::fprintf(stderr, "broken: %s\n", text);
  std::abort();
}

// The fuzzer's bytes, one after the other; zeros when they have run out.
class Input {
 public:
  Input(const std::uint8_t* bytes, std::size_t count) : bytes_(bytes), left_(count) {}

  bool empty() const { return left_ == 0; }
  std::uint8_t byte() {
    if (left_ == 0) return 0;
    --left_;
    return *bytes_++;
  }
  std::vector<std::uint8_t> take(std::size_t count) {
    std::vector<std::uint8_t> taken(count);
    for (std::uint8_t& value : taken) value = byte();
    return taken;
  }

 private:
  const std::uint8_t* bytes_;
  std::size_t left_;
};

// Reads what the board sends as a host would; a frame that a host could not read breaks a claim.
class Auditor {
 public:
  // The next byte on the line; 0 ends a frame.
  void put(std::uint8_t byte) {
    if (byte != 0) {
      std::uint8_t decoded = 0;
      if (cobs_.put(byte, decoded)) frame_.push_back(decoded);
      return;
    }
    require(cobs_.whole(), "a frame ends where its COBS blocks end");
    judge();
    frame_.clear();
    cobs_.reset();
  }

  std::size_t welcomes() const { return welcomes_; }

 private:
  // Checks a whole frame: CRC, head, sequence number, and the payload's length for its message.
  void judge() {
    using heli::link::MessageId;
    constexpr std::size_t kOverhead = heli::link::kFrameHead + heli::link::kFrameTail;
    require(frame_.size() >= kOverhead, "a frame has head and CRC");
    const std::size_t checked = frame_.size() - heli::link::kFrameTail;
    require(
        heli::link::crc32(frame_.data(), checked) == heli::link::get_u32(frame_.data() + checked),
        "the CRC of a frame is right");
    require(frame_[0] == heli::link::kProtocol, "a frame starts with the protocol");
    if (sequence_) {
      require(frame_[2] == static_cast<std::uint8_t>(*sequence_ + 1), "no frame is left out");
    }
    sequence_ = frame_[2];
    const std::size_t size = frame_.size() - kOverhead;
    const std::uint8_t* payload = frame_.data() + heli::link::kFrameHead;
    switch (static_cast<MessageId>(frame_[1])) {
      case MessageId::ack:
        return exactly(size, heli::link::AckMessage::kSize);
      case MessageId::welcome:
        ++welcomes_;
        return exactly(size, heli::link::WelcomeMessage::kSize);
      case MessageId::pong:
        return exactly(size, heli::link::PongMessage::kSize);
      case MessageId::status:
        return exactly(size, heli::link::StatusMessage::kSize);
      case MessageId::event:
        return exactly(size, heli::link::EventMessage::kSize);
      case MessageId::law:
        return exactly(size, heli::link::LawMessage::kSize);
      case MessageId::controller:
        return exactly(size, heli::link::ControllerMessage::kSize);
      case MessageId::params_origin:
        return exactly(size, heli::link::ParamsOriginMessage::kSize);
      case MessageId::params:
        require(size > 2, "params has a head");
        return exactly(size, heli::link::ParamsMessage::kSize + 4U * payload[2]);
      case MessageId::telemetry:
        return telemetry(payload, size);
      default:
        require(false, "the board sends only what is declared for its direction");
    }
  }

  // A batch of telemetry has the length that its head and width codes give, and later ticks than
  // the last.
  void telemetry(const std::uint8_t* payload, std::size_t size) {
    // Width of a channel's differences, by its code of four bits.
    constexpr std::uint32_t kBits[] = {0, 2, 4, 8, 16, 32};
    // After the head: the codes, two per byte; first values; differences, padded to bytes.
    constexpr std::size_t kWidths = heli::link::TelemetryMessage::kSize;
    constexpr std::size_t kBases = kWidths + (heli::link::kChannelCount + 1) / 2;
    require(size > kBases && size <= heli::link::kMaxTelemetryPayload,
            "a batch has a frame's length");
    const auto head = heli::link::TelemetryMessage::read(payload);
    require(head.count >= 1, "a batch has at least one tick");
    std::size_t expected = kBases;
    for (std::size_t channel = 0; channel < heli::link::kChannelCount; ++channel) {
      const unsigned code = (payload[kWidths + channel / 2] >> (4 * (channel % 2))) & 15U;
      require(code < 6, "a width code is declared");
      expected += heli::link::kChannelBytes[channel] + ((head.count - 1U) * kBits[code] + 7) / 8;
    }
    exactly(size, expected);
    if (next_tick_) require(head.first_tick >= *next_tick_, "no tick is sent twice");
    next_tick_ = head.first_tick + head.count;
  }

  static void exactly(std::size_t size, std::size_t declared) {
    require(size == declared, "a payload has its declared length");
  }

  heli::link::CobsDecoder cobs_;
  std::vector<std::uint8_t> frame_;
  std::optional<std::uint8_t> sequence_;
  std::optional<std::uint32_t> next_tick_;
  std::size_t welcomes_ = 0;
};

// A board whose calls check what the flight code may ask of it.
class FuzzBoard final : public heli::Board {
 public:
  // Values that no real board has: they show what the flight code assumes of one.
  static constexpr std::int16_t kDutyFull = 1000;
  static constexpr std::size_t kPageBytes = 512;

  FuzzBoard() {
    for (auto& page : pages) page.fill(0xff);
  }

  std::int16_t duty_full() override { return kDutyFull; }
  heli::EncoderReading read_encoders() override { return encoders; }
  void write_motors(const heli::MotorCommand& command) override { motors = command; }
  bool hardware_stop() override { return stop_input; }

  // The bytes that have arrived, up to `most`.
  std::size_t receive(std::uint8_t* to, std::size_t most) override {
    std::size_t count = 0;
    for (; count < most && read_ < received_.size(); ++count) to[count] = received_[read_++];
    if (read_ == received_.size()) forget_received();
    return count;
  }
  void will_receive(const std::uint8_t* bytes, std::size_t count) {
    received_.insert(received_.end(), bytes, bytes + count);
  }
  void forget_received() {
    received_.clear();
    read_ = 0;
  }
  std::size_t transmit_free() override { return room; }
  // What the board sends goes to the auditor, byte by byte.
  void transmit(const std::uint8_t* bytes, std::size_t count) override {
    require(count <= room, "no more is sent than there is room for");
    room -= count;
    for (std::size_t i = 0; i < count; ++i) auditor.put(bytes[i]);
  }

  void read_page(std::size_t page, std::uint8_t* to, std::size_t count) override {
    require(count <= kPageBytes, "no more is read than a page has");
    for (std::size_t i = 0; i < count; ++i) to[i] = pages.at(page)[i];
  }
  bool write_page(std::size_t page, const std::uint8_t* from, std::size_t count) override {
    require(!motors.enable, "flash is written only while the motors are off");
    require(count <= kPageBytes, "no more is written than a page takes");
    pages.at(page).fill(0xff);
    for (std::size_t i = 0; i < count; ++i) pages.at(page)[i] = from[i];
    return true;
  }
  heli::BootReport boot_report() override { return {0, 0, 0, 1}; }

  heli::EncoderReading encoders{};
  heli::MotorCommand motors{};
  bool stop_input = false;
  std::size_t room = 0;  // bytes that the transmitter takes
  std::array<std::array<std::uint8_t, kPageBytes>, 2> pages;
  Auditor auditor;

 private:
  std::vector<std::uint8_t> received_;
  std::size_t read_ = 0;
};

// The flight code on that board, and what must hold after every tick.
class Harness {
 public:
  static constexpr std::size_t kLineBytes = 25;  // a millisecond at 250 kbaud

  Harness() { boot(); }

  // A reset: the flash stays, everything else begins anew.
  void boot() {
    board.motors = {};
    board.forget_received();
    board.auditor = {};
    code.emplace(board);
    code->core.start();
  }

  // One millisecond; without `poll` the idle loop has no time to run.
  void tick(bool poll = true) {
    code->core.tick();
    audit_motors();
    board.room = board.room + kLineBytes < kMaxRoom ? board.room + kLineBytes : kMaxRoom;
    if (poll) code->core.poll();
  }

  // A valid frame arrives at the board.
  void send(std::uint8_t id, const std::vector<std::uint8_t>& payload) {
    std::vector<std::uint8_t> wire(heli::link::FrameWriter::wire_bytes(payload.size()));
    wire.resize(writer.write(id, payload.data(), payload.size(), wire.data()));
    board.will_receive(wire.data(), wire.size());
  }

  template <class Message>
  void send(const Message& message) {
    std::vector<std::uint8_t> payload(Message::kSize);
    message.write(payload.data());
    send(static_cast<std::uint8_t>(Message::kId), payload);
  }

  // Lets time pass without a host: the motors must be off in the end.
  void require_rest_without_host() {
    for (std::size_t k = 0; k < kLongestDescent_ticks && board.motors.enable; ++k) tick();
    require(!board.motors.enable, "without a host the motors are off in the end");
  }

  State state() const { return code->core.state(); }

  FuzzBoard board;
  std::optional<heli::FlightCode> code;
  heli::link::FrameWriter writer;

 private:
  static constexpr std::size_t kMaxRoom = 1024;  // bytes of the transmitter's buffer
  // The largest setpoint_land_s and landing_timeout_s, and half a minute.
  static constexpr std::size_t kLongestDescent_ticks = 120000;

  // The command of the motors must fit the state of the flight code.
  void audit_motors() const {
    const heli::MotorCommand& m = board.motors;
    constexpr std::int16_t kFull = FuzzBoard::kDutyFull;
    require(m.front_duty >= -kFull && m.front_duty <= kFull && m.back_duty >= -kFull &&
                m.back_duty <= kFull,
            "a duty is at most full");
    if (state() == State::idle || state() == State::fault) {
      require(!m.enable, "in idle and fault the drivers are off");
    }
    if (state() == State::armed) {
      require(m.front_duty == 0 && m.back_duty == 0, "armed motors have no voltage");
    }
    if (board.stop_input) require(!m.enable, "the hardware stop keeps the drivers off");
  }
};

}  // namespace heli_fuzz
