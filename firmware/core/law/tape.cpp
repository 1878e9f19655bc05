// Runs a verified tape in the tick. A word is operation (5 bits), target, first and second operand
// (9 bits each: cell numbers), from the top bit down; docs/reference/link.md describes the format.
#include "law/tape.hpp"

#include "law/functions.hpp"
#include "law/sum.hpp"

namespace heli::law {

using link::Operation;

namespace {

// Adds cell times cell for each word from `term` to `end`; the sign is the word's top bit. A
// separate function, because its loop needs all registers.
[[gnu::noinline]] Bits sum_of_products(const Bits* cells, const std::uint32_t* term,
                                       const std::uint32_t* end) {
  Sum sum;
  do {
    const std::uint32_t word = *term;
    ++term;
    sum.add(cells[(word >> 9U) & 0x1ffU], cells[word & 0x1ffU], word);
  } while (term != end);
  return sum.value();
}

}  // namespace

// Sets the states to their initial values, which the image holds after constants and parameters.
void Tape::restart() {
  const std::uint32_t* first = image_ + Shape::kHeadWords + shape_.constants + shape_.parameters;
  Bits* state = cells_ + shape_.first_state();
  for (std::uint32_t k = 0; k < shape_.states; ++k) {
    state[k] = flushed(first[k]);
  }
}

// False if the law has no such parameter. A number below the normal ones becomes zero.
bool Tape::set_parameter(std::uint32_t index, Bits value) {
  if (index >= shape_.parameters) {
    return false;
  }
  cells_[shape_.first_parameter() + index] = flushed(value);
  return true;
}

bool Tape::run(std::uint32_t tick) {
  const std::uint32_t* program = image_ + program_at_;
  execute(program + (tick == 0U ? 0U : ends_[tick - 1U]), program + ends_[tick]);
  return tick + 1U == ticks_;
}

// Moves the new states, the last outputs, to the cells of the states.
bool Tape::commit_states() {
  const std::uint32_t* output_cells = image_ + outputs_at_ + Shape::kFirstSignal + shape_.signals;
  Bits* state = cells_ + shape_.first_state();
  Bits largest = 0;  // without its sign; infinity and NaN are larger than all numbers
  for (std::uint32_t k = 0; k < shape_.states; ++k) {
    const Bits new_state = cells_[output_cells[k]];
    state[k] = new_state;
    largest = (new_state << 1U) > largest ? new_state << 1U : largest;
  }
  return is_finite(largest >> 1U);
}

// Executes the instructions up to `end`. The verifier has checked every cell number.
void Tape::execute(const std::uint32_t* instruction, const std::uint32_t* end) {
  Bits* const cells = cells_;
  for (; instruction != end; ++instruction) {
    const std::uint32_t word = *instruction;
    const Bits a = cells[(word >> 9U) & 0x1ffU];
    const Bits b = cells[word & 0x1ffU];
    Bits result = a;
    switch (static_cast<Operation>(word >> 27U)) {
      case Operation::copy:
        break;
      case Operation::add:
        result = add(a, b);
        break;
      case Operation::subtract:
        result = subtract(a, b);
        break;
      case Operation::multiply:
        result = multiply(a, b);
        break;
      case Operation::divide:
        result = divide(a, b);
        break;
      case Operation::negate:
        result = a ^ kSign;
        break;
      case Operation::absolute:
        result = a & ~kSign;
        break;
      case Operation::minimum:
        result = minimum(a, b);
        break;
      case Operation::maximum:
        result = maximum(a, b);
        break;
      case Operation::less:
        result = less(a, b);
        break;
      case Operation::less_equal:
        result = less_equal(a, b);
        break;
      case Operation::equal:
        result = equal(a, b);
        break;
      case Operation::not_equal:
        result = not_equal(a, b);
        break;
      case Operation::both:
        result = both(a, b);
        break;
      case Operation::either:
        result = either(a, b);
        break;
      case Operation::negation:
        result = negation(a);
        break;
      case Operation::select:
        result = select(a, b);
        break;
      case Operation::floor:
        result = floor(a);
        break;
      case Operation::square_root:
        result = square_root(a);
        break;
      case Operation::sine:
        result = sine(a);
        break;
      case Operation::cosine:
        result = cosine(a);
        break;
      case Operation::tangent:
        result = tangent(a);
        break;
      case Operation::arctangent:
        result = arctangent(a, b);
        break;
      case Operation::hyperbolic_tangent:
        result = hyperbolic_tangent(a);
        break;
      case Operation::exponential:
        result = exponential(a);
        break;
      case Operation::sum_of_products:
        result = sum_of_products(cells, instruction + 1, instruction + 1 + (word & 0x1ffU));
        instruction += word & 0x1ffU;
        break;
    }
    cells[(word >> 18U) & 0x1ffU] = result;
  }
}

}  // namespace heli::law
