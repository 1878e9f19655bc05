// One step of each loop of the verifier, from any state of the loop, on a tape of any content.
#include "any.hpp"
#include "law/tape.cpp"
#include "law/upload.cpp"
#include "no_interrupt.hpp"

using heli::law::Bits;
using heli::law::Cells;
using heli::law::LawError;
using heli::law::Overhead;
using heli::law::Schedule;
using heli::law::Shape;
using heli::law::Tape;
using heli::law::UploadCheck;
using heli::link::kLawCells;
using heli::link::kLawInputCount;
using heli::link::kLawMaxTerms;
using heli::link::kLawMaxTicks;
using heli::link::kLawTickCost;
using heli::link::kLawWords;
using heli::proofs::any;

// Contract: a function of the bytes.
std::uint32_t heli::link::crc32(const std::uint8_t*, std::size_t, std::uint32_t) {
  return any<std::uint32_t>();
}

// Bit 0 of a number marks that it depends on a cell that nothing wrote.
Bits heli::law::result_of(Bits a, Bits b) { return a | b; }

namespace {

Tape tape;

bool accepted(const UploadCheck& check) { return check.error == LawError::none; }

bool is_marked(Bits number) { return (number & 1U) != 0U; }

constexpr std::uint32_t kMostTerms = 2;  // more terms run the same loop

// Whether `cells` notes the read of this cell; only inputs are noted.
bool is_noted(std::uint32_t cell, const Cells& cells) {
  return cell >= kLawInputCount || (cells.inputs_read() >> cell & 1U) != 0U;
}

// Marks the cell if nothing wrote it before the instruction, or if its read is not noted.
void mark(std::uint32_t cell, const Cells& before, const Cells& after) {
  ASSUME(is_marked(tape.cells_[cell]) == !(before.has(cell) && is_noted(cell, after)));
}

// Any set of cells that were written, and any inputs that were read.
Cells any_cells() {
  Cells cells(0);
  for (std::uint32_t& bits : cells.bits_) {
    bits = any<std::uint32_t>();
  }
  cells.inputs_read_ = any<std::uint32_t>();
  return cells;
}

// A tape of any content.
void put_in_any_state() {
  CONSTANT(Tape::kWords);
  CONSTANT(Tape::kCells);
  tape = any<Tape>();
}

// The invariant of the schedule: the running tick has its overhead, and room for its end.
bool holds(const Schedule& schedule) {
  return schedule.ticks_ >= 1U && schedule.in_tick_ >= schedule.around_.every &&
         schedule.in_tick_ <= kLawTickCost &&
         schedule.in_tick_ + schedule.around_.end <= kLawTickCost;
}

}  // namespace

// The head of a tape: after read_shape() accepts it, all its parts have room.
void step_shape() {
  put_in_any_state();
  ASSUME(tape.expected_ <= kLawWords);

  const UploadCheck check = tape.read_shape();

  const Shape& shape = tape.shape_;
  CLAIM(!accepted(check) || tape.outputs_at_ == Shape::kHeadWords + shape.constants +
                                                    shape.parameters + shape.states,
        "the outputs follow the numbers");
  CLAIM(!accepted(check) || tape.program_at_ == tape.outputs_at_ + shape.outputs(),
        "the program follows the outputs");
  CLAIM(!accepted(check) || tape.program_at_ + shape.instructions == tape.expected_,
        "the program ends with the tape");
  CLAIM(!accepted(check) || shape.first_written() <= kLawCells, "all numbers are cells");
  CLAIM(!accepted(check) || (shape.divisor != 0U && shape.signals <= heli::link::kLawSignals),
        "the divisor is not 0, and each signal has a channel");
}

// One instruction: after check_instruction() accepts it, it writes a free cell, and its result
// depends only on cells that were written.
void step_instruction() {
  put_in_any_state();
  std::uint32_t words[kMostTerms + 1U];
  for (std::uint32_t& word : words) {
    word = any<std::uint32_t>();
  }
  const auto terms = any<std::uint32_t>();
  ASSUME(terms <= kMostTerms);
  // The instruction ends at the end of the array, so that a read behind it is out of bounds.
  const std::uint32_t* const from = words + (kMostTerms - terms);
  const std::uint32_t* const to = words + kMostTerms + 1U;
  const std::uint32_t word = *from;
  ASSUME(heli::law::words_of(word) == terms + 1U);
  const std::uint32_t target = (word >> 18U) & 0x1ffU;
  const auto count = any<std::uint32_t>();  // of the words up to the program's end
  ASSUME(0U < count && count <= kLawWords);
  const auto first_written = any<std::uint32_t>();
  ASSUME(first_written <= kLawCells);
  Cells cells = any_cells();
  const Cells before = cells;

  const UploadCheck check = heli::law::check_instruction({from, count}, first_written, cells);

  if (!accepted(check)) {
    return;
  }
  CLAIM(terms < count, "an instruction ends inside the program");
  CLAIM(first_written <= target && target < kLawCells, "an instruction writes a free cell");
  const auto cell = any<std::uint32_t>();
  ASSUME(cell < kLawCells);
  CLAIM(cells.has(cell) == (before.has(cell) || cell == target), "the written cell is noted");
  // Marks the operands that the verifier should not have let pass: none of the marks may reach the
  // result. Without terms they are in the instruction, otherwise each term has two.
  if (terms == 0U) {
    mark((word >> 9U) & 0x1ffU, before, cells);
    mark(word & 0x1ffU, before, cells);
  }
  for (const std::uint32_t* pair = from + 1; pair != to; ++pair) {
    mark((*pair >> 9U) & 0x1ffU, before, cells);
    mark(*pair & 0x1ffU, before, cells);
  }
  tape.execute(from, to);
  CLAIM(!is_marked(tape.cells_[target]), "a result depends on what was written, and inputs noted");
}

// One output: after check_output() accepts it, it is a cell that was written.
void step_output() {
  const auto shape = any<Shape>();
  ASSUME(shape.states <= kLawCells && shape.parameters <= kLawCells &&
         shape.constants <= kLawCells && shape.first_written() <= kLawCells &&
         shape.signals <= heli::link::kLawSignals);
  const auto k = any<std::uint32_t>();
  const auto cell = any<std::uint32_t>();
  Cells cells = any_cells();

  const UploadCheck check = heli::law::check_output(shape, k, cell, cells);

  CLAIM(!accepted(check) || (cell < kLawCells && cells.has(cell) && is_noted(cell, cells)),
        "an output was written, or is an input noted");
  CLAIM(!accepted(check) || k < Shape::kFirstSignal + shape.signals || cell < shape.first_state() ||
            cell >= shape.first_state() + shape.states,
        "a new state is no state");
}

// One instruction is added to the schedule: no tick costs more than it may.
void step_schedule() {
  const auto shape = any<Shape>();
  ASSUME(shape.states <= kLawCells && shape.signals <= heli::link::kLawSignals);
  const Overhead around = heli::law::overhead_of(shape, any<std::uint32_t>());
  std::uint16_t ends[kLawMaxTicks] = {};
  Schedule schedule(around, ends);
  CLAIM(holds(schedule), "the invariant holds at the start");
  schedule.in_tick_ = any<std::uint32_t>();
  schedule.ticks_ = any<std::uint32_t>();
  ASSUME(schedule.ticks_ <= kLawWords);  // each begins with an instruction
  schedule.cost_ = any<std::uint32_t>();
  ASSUME(holds(schedule));
  const std::uint32_t in_tick = schedule.in_tick_;
  const std::uint32_t ticks = schedule.ticks_;
  const std::uint32_t declared = schedule.cost_;
  const auto word = any<std::uint32_t>();
  const std::uint32_t terms = heli::law::words_of(word) - 1U;
  ASSUME(word >> 27U < heli::link::kOperationCount && terms <= kLawMaxTerms);
  const auto k = any<std::uint32_t>();
  ASSUME(k <= kLawWords);

  const std::uint32_t cost = heli::law::cost_of(word);
  schedule.add(k, cost);

  const bool begins = schedule.ticks_ != ticks;
  CLAIM(holds(schedule), "each tick costs no more than a tick may");
  CLAIM(!begins || schedule.ticks_ == ticks + 1U, "an instruction begins at most one tick");
  CLAIM(schedule.in_tick_ == (begins ? around.every : in_tick) + cost,
        "an instruction counts once");
  CLAIM(schedule.cost_ == declared + (begins ? around.every : 0U) + cost,
        "the declared cost grows by what the ticks cost more");
  CLAIM(!begins || ticks > kLawMaxTicks || ends[ticks - 1U] == k,
        "a tick ends before an instruction");
}
