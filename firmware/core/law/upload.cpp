// Verifies a tape before it may fly, in the idle loop. A tape has no loop, so these can be checked
// in advance: each cell is written before it is read, no instruction writes a cell of an input,
// number or state, and the cost of a call has a bound. A word is operation (5 bits), target, first
// and second operand (9 bits each: cell numbers), from the top bit down.
#include <cstring>

#include "law/tape.hpp"
#include "link/crc32.hpp"

namespace heli::law {

namespace {

constexpr std::uint32_t kPartWords = 12;  // of an upload message

constexpr std::uint32_t kCellMask = 0x1ffU;    // one cell number
constexpr std::uint32_t kPairMask = 0x3ffffU;  // two cell numbers

constexpr bool is_sum(std::uint32_t word) {
  return word >> 27U == static_cast<std::uint32_t>(link::Operation::sum_of_products);
}

// Returns the words of an instruction: itself, and the terms of a sum.
constexpr std::uint32_t words_of(std::uint32_t word) {
  return is_sum(word) ? 1U + (word & kCellMask) : 1U;
}

// Cells written so far, and the inputs that were read.
class Cells {
 public:
  explicit Cells(std::uint32_t first_free) {
    for (std::uint32_t cell = 0; cell < first_free; ++cell) {
      add(cell);
    }
  }
  void add(std::uint32_t cell) { bits_[cell >> 5U] |= 1U << (cell & 31U); }
  bool has(std::uint32_t cell) const { return (bits_[cell >> 5U] >> (cell & 31U) & 1U) != 0U; }
  // Notes a read; false if the cell has not been written.
  bool read(std::uint32_t cell) {
    inputs_read_ |= cell < link::kLawInputCount ? 1U << cell : 0U;
    return has(cell);
  }
  std::uint32_t inputs_read() const { return inputs_read_; }

 private:
  std::uint32_t bits_[link::kLawCells / 32U] = {};
  std::uint32_t inputs_read_ = 0;
};

// An instruction, and the words that follow it in the program.
struct Rest {
  const std::uint32_t* words;
  std::uint32_t count;
};

// Checks a sum of products: its head has the number of terms, each term is a sign and two cells.
UploadCheck check_sum(const Rest& rest, Cells& cells) {
  const std::uint32_t word = rest.words[0];
  const std::uint32_t terms = word & kCellMask;
  if (((word >> 9U) & kCellMask) != 0U || terms == 0U || terms > link::kLawMaxTerms ||
      terms >= rest.count) {
    return {LawError::bad_sum, 0U};
  }
  for (std::uint32_t term = 1; term <= terms; ++term) {
    const std::uint32_t pair = rest.words[term];
    if ((pair & ~(kSign | kPairMask)) != 0U) {
      return {LawError::bad_sum, term};
    }
    if (!cells.read((pair >> 9U) & kCellMask) || !cells.read(pair & kCellMask)) {
      return {LawError::not_written, term};
    }
  }
  return {};
}

// Checks the first instruction, and notes which cells it reads and writes. An error is at a word
// that counts from the instruction.
UploadCheck check_instruction(const Rest& rest, std::uint32_t first_written, Cells& cells) {
  const std::uint32_t word = rest.words[0];
  const std::uint32_t operation = word >> 27U;
  if (operation >= link::kOperationCount) {
    return {LawError::unknown_operation, 0U};
  }
  const std::uint32_t target = (word >> 18U) & kCellMask;
  if (target < first_written || target >= link::kLawCells) {
    return {LawError::bad_cell, 0U};
  }
  if (is_sum(word)) {
    const UploadCheck sum = check_sum(rest, cells);
    if (sum.error != LawError::none) {
      return sum;
    }
  } else {
    const std::uint32_t second = word & kCellMask;
    const bool binary = (link::kBinaryOperations >> operation & 1U) != 0U;
    if (!cells.read((word >> 9U) & kCellMask) || (binary ? !cells.read(second) : second != 0U)) {
      return {LawError::not_written, 0U};
    }
  }
  cells.add(target);
  return {};
}

// Checks the cell of output `k`. A new state must not be the cell of a state, because states are
// replaced one by one.
UploadCheck check_output(const Shape& shape, std::uint32_t k, std::uint32_t cell, Cells& cells) {
  const std::uint32_t word_index = shape.instructions + k;
  const bool is_state = cell >= shape.first_state() && cell < shape.first_written();
  if (cell >= link::kLawCells || (k >= Shape::kFirstSignal + shape.signals && is_state)) {
    return {LawError::bad_cell, word_index};
  }
  if (!cells.read(cell)) {
    return {LawError::not_written, word_index};
  }
  return {};
}

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

// Cost of an instruction with its terms, in processor instructions.
std::uint32_t cost_of(std::uint32_t word) {
  return link::kOperationCost[word >> 27U] + (words_of(word) - 1U) * link::kLawTermCost;
}

// Division of a call into ticks, and its cost. Each tick has room to be the last.
class Schedule {
 public:
  Schedule(const Overhead& around, std::uint16_t* ends)
      : around_(around),
        ends_(ends),
        in_tick_(around.begin + around.every),
        cost_(around.begin + around.every + around.end) {}
  // Adds the instruction that begins at word `k`.
  void add(std::uint32_t k, std::uint32_t cost) {
    if (in_tick_ + cost + around_.end > link::kLawTickCost) {
      end_tick(k);
      ++ticks_;
      in_tick_ = around_.every;
      cost_ += around_.every;
    }
    in_tick_ += cost;
    cost_ += cost;
  }
  // The last tick so far ends before word `k`.
  void end_tick(std::uint32_t k) {
    if (ticks_ <= link::kLawMaxTicks) {
      ends_[ticks_ - 1U] = static_cast<std::uint16_t>(k);
    }
  }
  std::uint32_t ticks() const { return ticks_; }
  std::uint32_t cost() const { return cost_; }

 private:
  Overhead around_;
  std::uint16_t* ends_;
  std::uint32_t in_tick_;  // without the end
  std::uint32_t cost_;     // of the call, if this tick is the last
  std::uint32_t ticks_ = 1;
};

}  // namespace

// Begins an upload, which erases the law that is stored. The tick interrupts this function and may
// begin to fly the stored law at any point. So the law is first made unavailable; only then the
// board checks whether it flies already.
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

// Stores a part, whether it is the next one or a repeated one; returns the words received so far.
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

// Ends an upload: checks the whole law, and makes it available. Repeating the command is harmless.
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
  const UploadCheck verdict = check();
  store(verdict.error == LawError::none ? LawState::ready : LawState::none);
  return verdict.error == LawError::none ? UploadCheck{LawError::none, cost_} : verdict;
}

// The first reason why the law cannot fly, or its cost. Each check relies on those before it.
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
  const UploadCheck shape = read_shape();
  if (shape.error != LawError::none) {
    return shape;
  }
  const UploadCheck numbers = check_numbers();
  if (numbers.error != LawError::none) {
    return numbers;
  }
  const UploadCheck program = check_program();
  if (program.error != LawError::none) {
    return program;
  }
  const UploadCheck timing = schedule();
  if (timing.error == LawError::none) {
    prepare();
  }
  return timing;
}

// Sets the positions of all parts on the tape.
UploadCheck Tape::read_shape() {
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
  return {};
}

// Constants, parameters and initial states must be finite.
UploadCheck Tape::check_numbers() const {
  const std::uint32_t numbers = shape_.constants + shape_.parameters + shape_.states;
  for (std::uint32_t k = 0; k < numbers; ++k) {
    if (!is_finite(image_[Shape::kHeadWords + k])) {
      return {LawError::bad_number, k};
    }
  }
  return {};
}

// Checks all instructions and outputs, in the order in which they run.
UploadCheck Tape::check_program() {
  const std::uint32_t first_written = shape_.first_written();
  const std::uint32_t* const program = image_ + program_at_;
  Cells cells(first_written);
  for (std::uint32_t k = 0; k < shape_.instructions; k += words_of(program[k])) {
    const UploadCheck instruction =
        check_instruction({program + k, shape_.instructions - k}, first_written, cells);
    if (instruction.error != LawError::none) {
      return {instruction.error, k + instruction.value};
    }
  }
  for (std::uint32_t k = 0; k < shape_.outputs(); ++k) {
    const UploadCheck output = check_output(shape_, k, image_[outputs_at_ + k], cells);
    if (output.error != LawError::none) {
      return output;
    }
  }
  inputs_read_ = cells.inputs_read();
  return {};
}

// Divides a call into ticks; refuses a law whose call does not end before the next one begins.
UploadCheck Tape::schedule() {
  Schedule schedule(overhead_of(shape_, inputs_read_), ends_);
  const std::uint32_t* const program = image_ + program_at_;
  for (std::uint32_t k = 0; k < shape_.instructions; k += words_of(program[k])) {
    schedule.add(k, cost_of(program[k]));
  }
  schedule.end_tick(shape_.instructions);
  cost_ = schedule.cost();
  ticks_ = schedule.ticks();
  if (ticks_ > shape_.divisor || ticks_ > link::kLawMaxTicks) {
    return {LawError::too_costly, ticks_};
  }
  return {};
}

// Copies the numbers to their cells, so that the tick can start the law.
void Tape::prepare() {
  const std::uint32_t numbers = shape_.constants + shape_.parameters + shape_.states;
  for (std::uint32_t k = 0; k < numbers; ++k) {
    cells_[link::kLawInputCount + k] = flushed(image_[Shape::kHeadWords + k]);
  }
  restart();
}

}  // namespace heli::law
