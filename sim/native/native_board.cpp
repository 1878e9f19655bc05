// The functions of Board and SimBoard on memory instead of hardware; see native_board.hpp.
#include "native_board.hpp"

#include <algorithm>
#include <cstdio>
#include <memory>
#include <stdexcept>
#include <string>

#include "invariants.hpp"

namespace heli_sim {

namespace {

// The boot event carries the boot id as a float, which holds whole numbers of 24 bits.
constexpr std::uint32_t kBootIdMask = 0x00FFFFFF;

// Closed with its owner. Streams of C, because WebAssembly's library has no others.
using File = std::unique_ptr<std::FILE, int (*)(std::FILE*)>;
File open_file(const std::string& name, const char* mode) {
  return File(std::fopen(name.c_str(), mode), std::fclose);
}

}  // namespace

// Up to `most` received bytes; returns how many.
std::size_t MemoryBoard::receive(std::uint8_t* to, std::size_t most) {
  std::size_t count = 0;
  while (count < most && !rx.empty()) to[count++] = rx.pop();
  return count;
}

void MemoryBoard::transmit(const std::uint8_t* bytes, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) tx.push(bytes[i]);
}

// Reads the first bytes of a page; a page that does not exist reads as erased.
void MemoryBoard::read_page(std::size_t page, std::uint8_t* to, std::size_t count) {
  if (page >= kPages || count > kPageBytes) {
    std::fill_n(to, count, std::uint8_t{0xFF});
    return;
  }
  std::copy_n(flash.data() + page * kPageBytes, count, to);
}

// Erases a page and writes its first bytes; saves the flash if it has a file. False: there
// is no such page, or the file could not be written.
bool MemoryBoard::write_page(std::size_t page, const std::uint8_t* from, std::size_t count) {
  if (page >= kPages || count > kPageBytes) return false;
  std::uint8_t* to = flash.data() + page * kPageBytes;
  std::fill_n(std::copy_n(from, count, to), kPageBytes - count, std::uint8_t{0xFF});
  if (flash_file.empty()) return true;
  const File file = open_file(flash_file, "wb");
  return file && std::fwrite(flash.data(), 1, flash.size(), file.get()) == flash.size() &&
         std::fflush(file.get()) == 0;
}

// Loads the flash file if it exists.
NativeBoard::NativeBoard(const std::string& flash_file, bool from_edges, std::uint64_t boot_seed)
    : from_edges_(from_edges) {
  std::seed_seq words{boot_seed & 0xFFFFFFFFU, boot_seed >> 32U};
  boot_ids_.seed(words);
  memory_.flash_file = flash_file;
  if (flash_file.empty()) return;
  const File file = open_file(flash_file, "rb");
  if (file && std::fread(memory_.flash.data(), 1, memory_.flash.size(), file.get()) !=
                  memory_.flash.size()) {
    throw std::runtime_error("the flash file " + flash_file + " is not " +
                             std::to_string(memory_.flash.size()) +
                             " bytes long; delete it, it is made again");
  }
}

// Starts the program: a new flight code on the board's memory, with another boot id each time.
void NativeBoard::boot(heli::link::Reset cause) {
  memory_.boot.board = 0;
  memory_.boot.reset = static_cast<std::uint8_t>(cause);
  memory_.boot.boot_fault = 0;
  memory_.boot.boot_id = static_cast<std::uint32_t>(boot_ids_()) & kBootIdMask;
  ++boots_;
  code_.emplace(memory_);
  code_->core.start();
}

// See sim_board.hpp. The control tick and the idle loop run once. An invariant of a proof that does
// not hold after that is a mistake in the flight code, and ends the simulation.
void NativeBoard::tick(const std::int32_t* count) {
  std::copy_n(count, heli::kAxisCount, disc_count_.begin());
  leaving_bytes_ = memory_.tx.size();
  if (reset_ticks_ > 0) {
    --reset_ticks_;
    return;
  }
  if (!from_edges_) {
    for (std::size_t axis = 0; axis < heli::kAxisCount; ++axis) {
      memory_.encoders.count[axis] = disc_count_[axis] - count_at_reset_[axis];
    }
  }
  if (erased_) return;  // there is no program
  if (!code_) boot(reset_cause_);
  code_->core.tick();
  code_->core.poll();
  if (const char* claim = broken_invariant(*code_, MemoryBoard::kDutyFull)) {
    throw std::logic_error(
        std::string("error: the flight code breaks the invariant of the proof '") + claim +
        "'; report this flight, see docs/reference/proved-claims.md");
  }
}

// See sim_board.hpp. The bytes of the millisecond arrive, and the edges count.
void NativeBoard::rest(const Edge* edges, std::size_t edge_count) {
  for (std::size_t i = 0; i < edge_count; ++i) {
    memory_.encoders.count[edges[i].axis] += edges[i].direction;
  }
  while (!arriving_bytes_.empty()) {
    const std::uint8_t byte = arriving_bytes_.pop();
    if (!in_reset() && !memory_.rx.push(byte)) ++memory_.rx_overflow;
  }
}

// The last command as fractions of full duty; the stop input switches the bridges off by itself.
MotorOutput NativeBoard::motors() const {
  const double full = MemoryBoard::kDutyFull;
  return {memory_.motors.front_duty / full, memory_.motors.back_duty / full,
          memory_.motors.enable && !memory_.stop_input};
}

// Ends the program and holds the board in reset; tick() starts the program again. The counters
// begin at 0, wherever the discs are.
void NativeBoard::reset(heli::link::Reset cause) {
  code_.reset();
  memory_.motors = {};
  memory_.encoders = {};
  count_at_reset_ = disc_count_;
  memory_.rx.clear();
  memory_.tx.clear();
  leaving_bytes_ = 0;
  reset_cause_ = cause;
  reset_ticks_ = kResetTicks;
}

// No program starts any more, as on a Due with an empty flash.
void NativeBoard::erase() {
  reset(heli::link::Reset::user);
  memory_.flash.fill(0xFF);
  erased_ = true;
}

// The next byte that was written before this millisecond; false if there is none.
bool NativeBoard::uart_transmit(std::uint8_t& byte) {
  if (leaving_bytes_ == 0) return false;
  --leaving_bytes_;
  byte = memory_.tx.pop();
  return true;
}

}  // namespace heli_sim
