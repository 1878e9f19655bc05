// Reads, erases and writes the parameter pages through EEFC1; see flash.hpp. Idle loop, motors off.
#include <cstring>

#include "drivers.hpp"
#include "registers.hpp"

namespace heli::due::flash {
namespace {

constexpr std::uint32_t kBank = 0x000C0000;  // address of the second bank
constexpr std::uint32_t kBankBytes = 256 * 1024;
constexpr std::uint32_t kBankPages = kBankBytes / kPageBytes;
constexpr std::uint32_t kParameterPages = 4;
// due.ld keeps the program out of these pages.
constexpr std::uint32_t kFirstPage = kBankPages - kParameterPages;

constexpr std::uint32_t kKey = EEFC_FCR_FKEY(0x5A);
constexpr std::uint32_t kEraseAndWritePage = EEFC_FCR_FCMD(0x03);

// Whatever the clock: the vendor's header for this chip has CHIP_FLASH_WRITE_WAIT_STATE = 6.
constexpr std::uint32_t kProgrammingWaitStates = EEFC_FMR_FWS(6);

// A page takes about 5 ms to erase and write; one poll takes 0.1 us or more.
constexpr std::uint32_t kMaxPolls = 1000000;

volatile std::uint32_t* words_of(std::size_t page) {
  return reinterpret_cast<volatile std::uint32_t*>(kBank + (kFirstPage + page) * kPageBytes);
}

// Waits until the flash is ready. Reading the status clears its error bits, so they are collected
// over all reads. Returns 0 if the flash stays busy.
std::uint32_t status_when_ready() {
  std::uint32_t status = 0;
  for (std::uint32_t i = 0; i < kMaxPolls; ++i) {
    status |= EFC1->EEFC_FSR.read();
    if ((status & EEFC_FSR_FRDY) != 0U) return status;
  }
  return 0;
}

}  // namespace

// Word by word, because the flash is volatile here and memcpy() does not take volatile memory.
void read_page(std::size_t page, std::uint8_t* to, std::size_t count) {
  const volatile std::uint32_t* from = words_of(page);
  for (std::size_t i = 0; i < count / 4; ++i) {
    const std::uint32_t word = from[i];
    std::memcpy(to + 4 * i, &word, sizeof word);
  }
}

bool write_page(std::size_t page, const std::uint8_t* from, std::size_t count) {
  if (page >= kParameterPages || count > kPageBytes || status_when_ready() == 0U) return false;
  const std::uint32_t reading_mode = EFC1->EEFC_FMR.read();
  EFC1->EEFC_FMR.write(kProgrammingWaitStates);
  // The page buffer takes whole words in ascending order, and erased ones where none was written.
  volatile std::uint32_t* to = words_of(page);
  for (std::size_t i = 0; i < kPageBytes / 4; ++i) {
    std::uint32_t word = 0xffffffff;
    if (4 * i < count) std::memcpy(&word, from + 4 * i, sizeof word);
    to[i] = word;
  }
  EFC1->EEFC_FCR.write(kKey | kEraseAndWritePage |
                       EEFC_FCR_FARG(static_cast<std::uint32_t>(kFirstPage + page)));
  const std::uint32_t status = status_when_ready();
  EFC1->EEFC_FMR.write(reading_mode);
  return (status & (EEFC_FSR_FRDY | EEFC_FSR_FCMDE | EEFC_FSR_FLOCKE)) == EEFC_FSR_FRDY;
}

}  // namespace heli::due::flash
