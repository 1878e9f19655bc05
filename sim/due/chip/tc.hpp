// Timer counter (section 36): three channels of 32 bits and a quadrature decoder in front of them.
#pragma once

#include <array>

#include "chip/peripheral.hpp"
#include "chip/pins.hpp"
#include "chip/quadrature.hpp"

namespace due_emulator {

class Tc;

// One channel. Its counter is computed when it is read. Events are scheduled only for compares that
// an interrupt or an output waits for.
class TcChannel final : public EventSink {
 public:
  TcChannel(System& system, Tc& block, int index, int identifier);

  void reset();
  void event(std::uint64_t now) override;
  std::uint32_t read(std::uint32_t offset);
  void write(std::uint32_t offset, std::uint32_t value);

  // A step of the quadrature decoder, when the channel counts those.
  void count(int direction);
  void software_trigger();
  // TCCLKS = 5 (XC0): the channel counts the steps of the decoder.
  bool counts_external() const { return running_ && (mode_ & 7U) == 5; }
  bool output_a() const { return level_a_; }
  bool output_b() const { return level_b_; }
  // EEVT = 0: TIOB is an input that can trigger.
  bool event_is_tiob() const { return (mode_ & 0xC00U) == 0; }
  bool is_wave() const { return (mode_ & (1U << 15)) != 0; }
  int identifier() const { return identifier_; }
  void update_irq();

 private:
  // Times of the counter are counted in `steps` of its clock since the prescaler began, and in
  // `ticks`, which are the steps since the counter was 0.
  std::uint64_t step() const;
  bool pending() const;
  std::uint64_t ticks(std::uint64_t now) const;
  std::uint64_t period() const;
  std::uint32_t value() const;
  // WAVSEL 1 and 3: the counter runs up and then down.
  bool updown() const { return is_wave() && ((mode_ >> 13) & 1U) != 0; }
  bool resets_at_rc() const;
  std::uint64_t next_match(std::uint64_t after, std::uint32_t compare) const;
  void settle();
  void matched(std::uint32_t flag, std::uint32_t a_effect, std::uint32_t b_effect);
  void effect(bool& level, std::uint32_t code, bool is_a);
  void restart(std::uint32_t from);
  void trigger();
  void stop();
  void plan();
  void write_control(std::uint32_t value);
  void write_mode(std::uint32_t value);

  System& system_;
  Tc& block_;
  int index_;
  int identifier_;
  Scheduler::Id id_;
  std::uint32_t mode_ = 0;  // TC_CMR
  std::uint32_t ra_ = 0;
  std::uint32_t rb_ = 0;
  std::uint32_t rc_ = 0;
  std::uint32_t status_ = 0;      // TC_SR: the flags that reading clears
  std::uint32_t interrupts_ = 0;  // TC_IMR
  bool enabled_ = false;          // CLKSTA
  bool running_ = false;          // enabled and triggered
  bool clears_ = false;           // the decoder's next step clears the counter
  std::uint32_t held_ = 0;        // the value while the clock stands, or counts edges
  std::uint64_t start_step_ = 0;  // clock steps at which the value was 0
  std::uint64_t seen_ticks_ = 0;  // compares up to here are in status_
  bool level_a_ = false;          // TIOA and TIOB in waveform mode
  bool level_b_ = false;
};

class Tc final : public Peripheral, public PinListener, public PinDriver {
 public:
  // Pins of TIOA and TIOB for each channel, -1 where the board has none, and their peripheral.
  struct Wiring {
    int tioa[3];
    int tiob[3];
    bool peripheral_b;
  };

  Tc(System& system, Pins& pins, int index, const Wiring& wiring);

  void reset() override;
  void pin_changed(int signal, bool level, std::uint64_t now) override;
  bool drives(int signal) const override;
  bool level(int signal) const override;

  bool pin_level(int channel, bool is_a) const;
  void output_changed(int channel, bool is_a);
  void not_modelled_in(int channel, std::uint32_t offset, const std::string& text) const;
  void misuse_in(int channel, std::uint32_t offset, const std::string& text) const;
  // The decoder's interrupt shares the line of channel 0.
  bool quadrature_irq() const { return (quadrature_.flags() & quadrature_interrupts_) != 0; }
  void quadrature_step(int direction);
  Quadrature& quadrature() { return quadrature_; }

 protected:
  std::uint32_t read(std::uint32_t offset) override;
  void write(std::uint32_t offset, std::uint32_t value) override;
  int clock_of(std::uint32_t offset) const override;
  std::uint32_t from_outside(std::uint32_t offset) const override;

 private:
  Pins& pins_;
  Wiring wiring_;
  TcChannel channels_[3];
  Quadrature quadrature_;
  std::uint32_t block_mode_ = 0;             // TC_BMR
  std::uint32_t quadrature_interrupts_ = 0;  // TC_QIMR
};

}  // namespace due_emulator
