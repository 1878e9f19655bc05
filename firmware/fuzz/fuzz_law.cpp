// Uploads of laws above a valid hash: refused, or run within the tape and within the ticks that
// were found for them. Most words are made such that a tape can come of them; some are any bits.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>

#include "law/tape.hpp"
#include "link/crc32.hpp"

namespace {

using heli::law::Shape;
using heli::law::Tape;
using heli::law::UploadCheck;
using heli::link::LawError;
namespace link = heli::link;

// The fuzzer's bytes, one after the other; zeros when they have run out.
class Bytes {
 public:
  Bytes(const std::uint8_t* bytes, std::size_t count) : next_(bytes), left_(count) {}
  bool empty() const { return left_ == 0U; }
  std::uint32_t byte() {
    if (left_ == 0U) return 0U;
    --left_;
    return *next_++;
  }
  std::uint32_t word() {
    const std::uint32_t low = byte() | byte() << 8U;
    return low | byte() << 16U | byte() << 24U;
  }

 private:
  const std::uint8_t* next_;
  std::size_t left_;
};

// The words of an upload; two more than a tape takes, so that a tape that is too long occurs.
struct Upload {
  std::uint32_t words[link::kLawWords + 2U] = {};
  std::uint32_t count = 0;
  void put(std::uint32_t word) {
    if (count < link::kLawWords + 2U) words[count++] = word;
  }
};

// The number of a cell that the program has written before (`written` counts them); now and then
// cell 511, which may not exist.
std::uint32_t cell(Bytes& in, std::uint32_t written) {
  const std::uint32_t drawn = in.byte();
  return drawn == 255U ? 511U : drawn % written;
}

// Makes an upload of the fuzzer's bytes: head, numbers, outputs, program, as docs/reference
// describes the tape. Sizes are small, and most operands are cells that were written, so that many
// tapes are valid. A byte of 255 puts any word into the program instead.
void make(Bytes& in, Upload& out) {
  const std::uint32_t signals = in.byte() % 6U;
  const std::uint32_t parameters = in.byte() % 4U;
  const std::uint32_t constants = in.byte() % 8U;
  const std::uint32_t states = in.byte() % 8U;
  const std::uint32_t divisor = 1U + in.byte() % 12U;
  std::uint32_t written =
      static_cast<std::uint32_t>(link::kLawInputCount) + constants + parameters + states;
  const std::uint32_t first_written = written;
  Upload program;
  while (!in.empty()) {
    const std::uint32_t drawn = in.byte();
    if (drawn == 255U) {
      program.put(in.word());
      continue;
    }
    const std::uint32_t operation = drawn % (link::kOperationCount + 1U);
    const bool sum = operation == static_cast<std::uint32_t>(link::Operation::sum_of_products);
    const bool binary = (link::kBinaryOperations >> (operation & 31U) & 1U) != 0U;
    const std::uint32_t terms = in.byte() % 70U;
    const std::uint32_t first = sum ? 0U : cell(in, written);
    const std::uint32_t second = sum ? terms : binary ? cell(in, written) : 0U;
    const std::uint32_t target = written < 500U ? written : first_written;
    // Instruction: operation in bits 31 to 27, then target and two operands of 9 bits each.
    program.put(operation << 27U | target << 18U | first << 9U | second);
    for (std::uint32_t k = 0; sum && k < terms && !in.empty(); ++k) {
      // Term of a sum: sign and two factors.
      program.put((in.byte() & 1U) << 31U | cell(in, written) << 9U | cell(in, written));
    }
    written = target + 1U > written ? target + 1U : written;
  }
  out.put(link::kLawFormat | divisor << 8U | signals << 16U | parameters << 24U);
  out.put(constants | states << 16U);
  out.put(program.count);
  for (std::uint32_t k = 0; k < constants + parameters + states; ++k) {
    // Without bit 30 a float is below 2, and so finite.
    out.put(program.words[k % (program.count + 1U)] & 0xbfffffffU);
  }
  const std::uint32_t outputs = Shape::kFirstSignal + signals + states;
  for (std::uint32_t k = 0; k < outputs; ++k) out.put(written - 1U - (k % 3U));
  for (std::uint32_t k = 0; k < program.count; ++k) out.put(program.words[k]);
}

// The CRC-32 over all words, as the message law_begin carries it.
std::uint32_t hash_of(const Upload& upload) {
  std::uint32_t crc = 0;
  for (std::uint32_t k = 0; k < upload.count; ++k) {
    std::uint8_t bytes[4];
    link::put_u32(bytes, upload.words[k]);
    crc = link::crc32(bytes, sizeof bytes, crc);
  }
  return crc;
}

// Uploads all words in messages of 12. Returns the first error, or the result of the verification.
UploadCheck send(Tape& tape, const Upload& upload) {
  link::LawBeginMessage begin;
  begin.hash = hash_of(upload);
  begin.words = static_cast<std::uint16_t>(upload.count);
  UploadCheck check = tape.begin(begin);
  for (std::uint32_t first = 0; check.error == LawError::none && first < upload.count;
       first += 12U) {
    std::uint8_t payload[link::LawPartMessage::kSize] = {};
    link::put_u16(payload + 1, static_cast<std::uint16_t>(first));
    for (std::uint32_t k = 0; k < 12U && first + k < upload.count; ++k) {
      link::put_u32(payload + 3U + 4U * k, upload.words[first + k]);
    }
    check = tape.receive(link::LawPartMessage::read(payload));
  }
  return check.error == LawError::none ? tape.end() : check;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t count) {
  Bytes in(bytes, count);
  auto upload = std::make_unique<Upload>();
  make(in, *upload);
  // On the heap, so that the sanitizer sees an access beyond either of them.
  auto tape = std::make_unique<Tape>();
  if (send(*tape, *upload).error != LawError::none) {
    if (tape->state() == link::LawState::ready) std::abort();
    return 0;
  }
  if (tape->ticks() > tape->shape().divisor || tape->ticks() > link::kLawMaxTicks) std::abort();
  // Three calls of the law: each must take as many ticks as the verifier has found.
  for (std::uint32_t call = 0; call < 3U; ++call) {
    for (std::uint32_t k = 0; k < link::kLawInputCount; ++k) {
      tape->set_input(k, heli::law::flushed(upload->words[(call + k) % upload->count]));
    }
    std::uint32_t tick = 0;
    while (!tape->run(tick)) ++tick;
    if (tick + 1U != tape->ticks()) std::abort();
    tape->commit_states();
  }
  return 0;
}
