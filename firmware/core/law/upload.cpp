// Verifies a tape before it may fly. A tape has no loop, so everything is known here: each cell is
// written before it is read, each written cell is free, and the cost of a call has a bound.
#include <cstring>

#include "law/tape.hpp"
#include "link/crc32.hpp"

namespace heli::law {

namespace {

constexpr std::uint32_t kPartWords = 12;

constexpr std::uint32_t kCellMask = 0x1ffU;
constexpr std::uint32_t kPairMask = 0x3ffffU;

constexpr bool is_sum(std::uint32_t word) {
  return word >> 27U == static_cast<std::uint32_t>(link::Operation::sum_of_products);
}

// Of an instruction: itself, and the terms of a sum.
constexpr std::uint32_t words_of(std::uint32_t word) {
  return is_sum(word) ? 1U + (word & kCellMask) : 1U;
}

// Cells written so far.
class Cells {
 public:
  explicit Cells(std::uint32_t first_free) {
    for (std::uint32_t cell = 0; cell < first_free; ++cell) {
      add(cell);
    }
  }
  void add(std::uint32_t cell) { bits_[cell >> 5U] |= 1U << (cell & 31U); }
  bool has(std::uint32_t cell) const { return (bits_[cell >> 5U] >> (cell & 31U) & 1U) != 0U; }

 private:
  std::uint32_t bits_[link::kLawCells / 32U] = {};
};

// Cost of a call in addition to its operations.
struct Overhead {
  std::uint32_t begin = 0;  // its first tick
  std::uint32_t every = 0;  // each tick
  std::uint32_t end = 0;    // its last tick
};

Overhead overhead_of(const Shape& shape, std::uint32_t inputs_read) {
  Overhead cost;
  cost.every = link::kLawFixedCost;
  cost.end = link::kLawOutputCost + link::kLawStateCost * shape.states +
             link::kLawSignalCost * shape.signals;
  for (std::uint32_t input = 0; input < link::kLawInputCount; ++input) {
    cost.begin += (inputs_read >> input & 1U) != 0U ? link::kLawInputCost : 0U;
  }
  for (std::uint32_t axis = 0; axis < link::kAxisCount; ++axis) {
    cost.every += (inputs_read & moving_inputs(axis)) != 0U ? link::kLawMovingCost : 0U;
  }
  return cost;
}

}  // namespace

UploadCheck Tape::begin(const link::LawBeginMessage& message) {
  const LawState before = stored();
  store(LawState::none);
  // A release store alone lets the compiler read `flying` before it.
  std::atomic_signal_fence(std::memory_order_seq_cst);
  if (flying()) {
    store(before);
    return {LawError::flying, 0U};
  }
  hash_ = message.hash;
  received_ = 0;
  expected_ = message.words;
  if (expected_ > kWords) {
    return {LawError::too_long, kWords};
  }
  store(LawState::receiving);
  return {};
}

UploadCheck Tape::receive(const link::LawPartMessage& message) {
  const std::uint32_t first = message.first;
  // The host repeats a part whose answer was lost.
  if (stored() != LawState::receiving || first > received_ || first % kPartWords != 0U ||
      first >= expected_) {
    return {LawError::wrong_part, first};
  }
  const std::uint32_t words[kPartWords] = {message.word_0, message.word_1,  message.word_2,
                                           message.word_3, message.word_4,  message.word_5,
                                           message.word_6, message.word_7,  message.word_8,
                                           message.word_9, message.word_10, message.word_11};
  std::uint32_t end = first;
  for (std::uint32_t k = 0; k < kPartWords && end < expected_; ++k, ++end) {
    image_[end] = words[k];
  }
  received_ = end > received_ ? end : received_;
  return {LawError::none, received_};
}

UploadCheck Tape::end() {
  if (stored() == LawState::ready) {
    return {LawError::none, cost_};
  }
  if (stored() != LawState::receiving) {
    return {LawError::not_loaded, 0U};
  }
  if (received_ != expected_) {
    return {LawError::incomplete, received_};
  }
  const UploadCheck found = check();
  store(found.error == LawError::none ? LawState::ready : LawState::none);
  return found.error == LawError::none ? UploadCheck{LawError::none, cost_} : found;
}

UploadCheck Tape::check() {
  std::uint32_t crc = 0;
  for (std::uint32_t k = 0; k < expected_; ++k) {
    std::uint8_t bytes[4];
    link::put_u32(bytes, image_[k]);
    crc = link::crc32(bytes, sizeof bytes, crc);
  }
  if (crc != hash_) {
    return {LawError::wrong_hash, 0U};
  }
  if (expected_ < Shape::kHeadWords || (image_[0] & 0xffU) != link::kLawFormat) {
    return {LawError::wrong_format, Shape::kHeadWords};
  }
  shape_.divisor = (image_[0] >> 8U) & 0xffU;
  shape_.signals = (image_[0] >> 16U) & 0xffU;
  shape_.parameters = image_[0] >> 24U;
  shape_.constants = image_[1] & 0xffffU;
  shape_.states = image_[1] >> 16U;
  shape_.instructions = image_[2] & 0xffffU;
  if (shape_.words() != expected_ || (image_[2] >> 16U) != 0U ||
      shape_.signals > link::kLawSignals) {
    return {LawError::wrong_format, shape_.words()};
  }
  if (shape_.first_written() > kCells) {
    return {LawError::too_large, shape_.first_written()};
  }
  constexpr std::uint32_t kTicksPerSecond = 1000000U / link::kTick_us;
  if (shape_.divisor == 0U || kTicksPerSecond % shape_.divisor != 0U) {
    return {LawError::bad_divisor, shape_.divisor};
  }
  outputs_at_ = Shape::kHeadWords + shape_.constants + shape_.parameters + shape_.states;
  program_at_ = outputs_at_ + shape_.outputs();
  const UploadCheck numbers = check_numbers();
  if (numbers.error != LawError::none) {
    return numbers;
  }
  const UploadCheck program = check_instructions();
  if (program.error != LawError::none) {
    return program;
  }
  const UploadCheck division = schedule();
  if (division.error == LawError::none) {
    prepare();
  }
  return division;
}

UploadCheck Tape::check_numbers() const {
  const std::uint32_t numbers = shape_.constants + shape_.parameters + shape_.states;
  for (std::uint32_t k = 0; k < numbers; ++k) {
    if (!is_finite(image_[Shape::kHeadWords + k])) {
      return {LawError::bad_number, k};
    }
  }
  return {};
}

UploadCheck Tape::check_instructions() {
  const std::uint32_t first_written = shape_.first_written();
  Cells written(first_written);
  inputs_read_ = 0;
  const auto may_read = [this, &written](std::uint32_t cell) {
    inputs_read_ |= cell < link::kLawInputCount ? 1U << cell : 0U;
    return written.has(cell);
  };
  std::uint32_t words = 0;
  for (std::uint32_t k = 0; k < shape_.instructions; k += words) {
    const std::uint32_t word = image_[program_at_ + k];
    const std::uint32_t operation = word >> 27U;
    if (operation >= link::kOperationCount) {
      return {LawError::unknown_operation, k};
    }
    const std::uint32_t target = (word >> 18U) & kCellMask;
    if (target < first_written || target >= kCells) {
      return {LawError::bad_cell, k};
    }
    words = words_of(word);
    const std::uint32_t first = (word >> 9U) & kCellMask;
    const std::uint32_t second = word & kCellMask;
    if (is_sum(word)) {
      if (first != 0U || second == 0U || second > link::kLawMaxTerms ||
          second >= shape_.instructions - k) {
        return {LawError::bad_sum, k};
      }
      for (std::uint32_t term = k + 1U; term < k + words; ++term) {
        const std::uint32_t pair = image_[program_at_ + term];
        if ((pair & ~(kSign | kPairMask)) != 0U) {
          return {LawError::bad_sum, term};
        }
        if (!may_read((pair >> 9U) & kCellMask) || !may_read(pair & kCellMask)) {
          return {LawError::not_written, term};
        }
      }
    } else {
      const bool binary = (link::kBinaryOperations >> operation & 1U) != 0U;
      if (!may_read(first) || (binary ? !may_read(second) : second != 0U)) {
        return {LawError::not_written, k};
      }
    }
    written.add(target);
  }
  const std::uint32_t first_new_state = Shape::kFirstSignal + shape_.signals;
  for (std::uint32_t k = 0; k < shape_.outputs(); ++k) {
    const std::uint32_t cell = image_[outputs_at_ + k];
    const std::uint32_t place = shape_.instructions + k;
    const bool own = cell >= shape_.first_state() && cell < first_written;
    if (cell >= kCells || (k >= first_new_state && own)) {
      return {LawError::bad_cell, place};
    }
    if (!may_read(cell)) {
      return {LawError::not_written, place};
    }
  }
  return {};
}

// Over how many ticks a call is spread, and what it costs. Each tick has room to be the last.
UploadCheck Tape::schedule() {
  const Overhead around = overhead_of(shape_, inputs_read_);
  std::uint32_t in_tick = around.begin + around.every;
  cost_ = in_tick + around.end;
  ticks_ = 1;
  std::uint32_t words = 0;
  for (std::uint32_t k = 0; k < shape_.instructions; k += words) {
    const std::uint32_t word = image_[program_at_ + k];
    words = words_of(word);
    const std::uint32_t cost =
        link::kOperationCost[word >> 27U] + (words - 1U) * link::kLawTermCost;
    if (in_tick + cost + around.end > link::kLawTickCost) {
      if (ticks_ <= link::kLawMaxTicks) {
        ends_[ticks_ - 1U] = static_cast<std::uint16_t>(k);
      }
      ++ticks_;
      in_tick = around.every;
      cost_ += around.every;
    }
    in_tick += cost;
    cost_ += cost;
  }
  if (ticks_ > shape_.divisor || ticks_ > link::kLawMaxTicks) {
    return {LawError::too_costly, ticks_};
  }
  ends_[ticks_ - 1U] = static_cast<std::uint16_t>(shape_.instructions);
  return {};
}

void Tape::prepare() {
  const std::uint32_t numbers = shape_.constants + shape_.parameters + shape_.states;
  for (std::uint32_t k = 0; k < numbers; ++k) {
    cells_[link::kLawInputCount + k] = flushed(image_[Shape::kHeadWords + k]);
  }
  restart();
}

}  // namespace heli::law
