// UART0 to the ATmega16U2, both directions through the PDC. Idle loop only; nothing here waits.
#pragma once

#include <cstddef>
#include <cstdint>

namespace heli::due::uart {

void start();

// At every turn of the idle loop: hands the PDC what it may send or fill next.
void service();

// As Board's functions of these names.
std::size_t receive(std::uint8_t* to, std::size_t capacity);
std::size_t transmit_free();
void transmit(const std::uint8_t* bytes, std::size_t count);

}  // namespace heli::due::uart
