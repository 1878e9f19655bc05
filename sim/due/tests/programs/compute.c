// Work for the comparison with another processor: soft float, 64-bit arithmetic, division, sorting,
// strings, bit fields, tables of jumps, recursion and calls through pointers.
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { kCount = 64 };

static volatile uint32_t sink;
static uint32_t state = 12345;
static int32_t numbers[kCount];
static double samples[kCount];

struct packed_fields {
  uint32_t low : 5;
  int32_t middle : 11;
  uint32_t high : 16;
};

static uint32_t next_random(void) {
  state ^= state << 13;
  state ^= state >> 17;
  state ^= state << 5;
  return state;
}

static int by_value(const void* a, const void* b) {
  const int32_t x = *(const int32_t*)a;
  const int32_t y = *(const int32_t*)b;
  return (x > y) - (x < y);
}

static uint32_t crc32(const uint8_t* bytes, unsigned count) {
  uint32_t crc = ~0u;
  for (unsigned i = 0; i < count; ++i) {
    crc ^= bytes[i];
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
  }
  return ~crc;
}

static uint32_t ackermann(uint32_t m, uint32_t n) {
  if (m == 0) return n + 1;
  return n == 0 ? ackermann(m - 1, 1) : ackermann(m - 1, ackermann(m, n - 1));
}

static int32_t choose(uint32_t code, int32_t a, int32_t b) {
  switch (code % 11) {
    case 0: return a + b;
    case 1: return a - b;
    case 2: return a * b;
    case 3: return b ? a / b : 0;
    case 4: return b ? a % b : 0;
    case 5: return a & b;
    case 6: return a << (b & 31);
    case 7: return a >> (b & 31);
    case 8: return a < b ? -a : b;
    case 9: return (int32_t)((uint32_t)a / ((uint32_t)b | 1u));
    default: return ~a;
  }
}

static float filter(float x, float* memory) {
  memory[1] = 0.9f * memory[1] + 0.1f * x;
  memory[0] += memory[1] * 0.001f;
  return memory[0] > 1.0f ? 1.0f : memory[0] < -1.0f ? -1.0f : memory[0];
}

typedef int32_t (*operation)(uint32_t, int32_t, int32_t);

int main(void) {
  float memory[2] = {0.0f, 0.0f};
  operation call = choose;
  for (unsigned round = 0; round < 200; ++round) {
    int64_t sum = 0;
    for (int i = 0; i < kCount; ++i) {
      numbers[i] = (int32_t)next_random() >> (next_random() & 15);
      sum += (int64_t)numbers[i] * (int32_t)next_random();
      sink = (uint32_t)call(next_random(), numbers[i], (int32_t)(next_random() & 255) - 128);
    }
    sink = (uint32_t)(sum / 77) ^ (uint32_t)((uint64_t)sum >> 33);
    qsort(numbers, kCount, sizeof numbers[0], by_value);
    samples[round % kCount] = sin((double)round * 0.1) * exp(-(double)round * 0.01) + sqrt(round + 1.0);
    sink = (uint32_t)(samples[round % kCount] * 1e6);
    sink = (uint32_t)(int32_t)(filter((float)numbers[round % kCount] / 1e9f, memory) * 1e6f);
    struct packed_fields fields = {next_random(), (int32_t)next_random(), next_random()};
    fields.middle += 3;
    sink = fields.low + (uint32_t)fields.middle + fields.high;
    char text[40];
    memset(text, 'a' + (int)(round % 26), sizeof text);
    memcpy(text + 3, numbers, 17);
    memmove(text + 1, text + 2, 30);
    text[39] = 0;
    sink = (uint32_t)strlen(text) + crc32((const uint8_t*)text, 39);
    sink = ackermann(2, round % 5);
    sink = __builtin_clz(next_random() | 1u) + (uint32_t)__builtin_bswap32(state);
  }
  return 0;
}
