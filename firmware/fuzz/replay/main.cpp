// Runs a fuzz target without a fuzzer, for compilers that have none: each file named, or, with none
// named, generated inputs, the same ones every time. Ends by abort() where a claim is broken.
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t count);

namespace {

constexpr std::uint32_t kGenerated = 500;  // inputs, if neither files nor a number are given

// xorshift32 (Marsaglia 2003): the same sequence everywhere.
std::uint32_t next(std::uint32_t& state) {
  state ^= state << 13U;
  state ^= state >> 17U;
  state ^= state << 5U;
  return state;
}

// Generated input `number`: up to 399 bytes, the same for each number.
std::vector<std::uint8_t> generate(std::uint32_t number) {
  std::uint32_t state = 2463534242U + number;  // Marsaglia's seed
  for (int warm_up = 0; warm_up < 8; ++warm_up) next(state);
  std::vector<std::uint8_t> input(next(state) % 400U);
  // One byte in four is small: in a list of steps these are the ones that lead somewhere.
  for (std::uint8_t& byte : input) {
    const std::uint32_t drawn = next(state);
    byte = static_cast<std::uint8_t>((drawn >> 8U) & ((drawn & 3U) == 0U ? 15U : 255U));
  }
  return input;
}

}  // namespace

// Arguments: files, or `--generated N`, or none.
int main(int argc, char** argv) {
  if (argc == 3 && std::strcmp(argv[1], "--generated") == 0) {
    const auto count = static_cast<std::uint32_t>(std::strtoul(argv[2], nullptr, 10));
    for (std::uint32_t number = 0; number < count; ++number) {
      const std::vector<std::uint8_t> input = generate(number);
      LLVMFuzzerTestOneInput(input.data(), input.size());
    }
    std::printf("%u inputs, no claim broken\n", count);
    return 0;
  }
  for (int i = 1; i < argc; ++i) {
    std::ifstream file(argv[i], std::ios::binary);
    if (!file) {
      std::fprintf(stderr, "%s cannot be read; name files that the fuzzer wrote\n", argv[i]);
      return 1;
    }
    const std::vector<char> text{std::istreambuf_iterator<char>(file), {}};
    LLVMFuzzerTestOneInput(reinterpret_cast<const std::uint8_t*>(text.data()), text.size());
  }
  if (argc == 1) {
    for (std::uint32_t number = 0; number < kGenerated; ++number) {
      const std::vector<std::uint8_t> input = generate(number);
      LLVMFuzzerTestOneInput(input.data(), input.size());
    }
  }
  std::printf("%d inputs, no claim broken\n", argc == 1 ? static_cast<int>(kGenerated) : argc - 1);
  return 0;
}
