// The simulated world as one WebAssembly module: either board, serial line, power stage and
// encoders.
//
// The plant is a module of its own, which heli_web.plant writes; its function arrives in the table
// of this one. JavaScript writes into memory of `allocate` and calls the functions below; one world
// at a time.
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <exception>
#include <memory>
#include <string>
#include <vector>

#include "due_board.hpp"
#include "native_board.hpp"
#include "world.hpp"

#define EXPORT(name) extern "C" __attribute__((export_name(#name)))

namespace {

using heli_sim::DueBoard;
using heli_sim::NativeBoard;
using heli_sim::World;

using Step = void (*)(const double* state, const double* volts_V, const double* locked,
                      const double* parameters, double* next_state, double* angles_rad);

class LinkedStep final : public heli_sim::PlantStep {
 public:
  LinkedStep(Step step, std::size_t state_count, std::size_t parameter_count)
      : step_(step), state_count_(state_count), parameter_count_(parameter_count) {}
  void step(const double* state, const double* volts_V, const double* locked,
            const double* parameters, double* next_state, double* angles_rad) override {
    const std::array<double, 2> late_V = delayed(volts_V);
    step_(state, late_V.data(), locked, parameters, next_state, angles_rad);
    past_V_.push_front({volts_V[0], volts_V[1]});
    past_V_.resize(kMaxDelay_ticks);
  }
  std::size_t state_count() const override { return state_count_; }
  std::size_t parameter_count() const override { return parameter_count_; }
  void set_delay(double delay_s) { delay_s_ = delay_s; }

 private:
  // The voltages that act if commands act late by delay_s, as in heli_sim.model.plant: a mean of
  // two successive commands.
  std::array<double, 2> delayed(const double* volts_V) const {
    const auto ticks = static_cast<std::size_t>(std::ceil(delay_s_ / kTick_s - 1e-9));
    if (ticks == 0) return {volts_V[0], volts_V[1]};
    const double newer_share = static_cast<double>(ticks) - delay_s_ / kTick_s;
    std::array<double, 2> late_V{};
    for (std::size_t motor = 0; motor < 2; ++motor) {
      const double newer_V = ticks == 1 ? volts_V[motor] : past_V_[ticks - 2][motor];
      late_V[motor] = newer_share * newer_V + (1 - newer_share) * past_V_[ticks - 1][motor];
    }
    return late_V;
  }

  static constexpr double kTick_s = 1e-3;
  static constexpr std::size_t kMaxDelay_ticks = 1000;
  std::deque<std::array<double, 2>> past_V_ = std::deque<std::array<double, 2>>(kMaxDelay_ticks);
  double delay_s_ = 0.0;
  Step step_;
  std::size_t state_count_;
  std::size_t parameter_count_;
};

// Timer channel TC3, as in heli_sim.due.firmware.
constexpr std::uint8_t kTickHandler = 16 + 30;

struct Simulation {
  std::shared_ptr<NativeBoard> native;
  std::shared_ptr<DueBoard> due;
  std::shared_ptr<LinkedStep> step;
  std::unique_ptr<World> world;
  std::vector<std::uint8_t> to_host;
  std::string error;
};

Simulation simulation;

}  // namespace

EXPORT(allocate) void* allocate(std::size_t bytes) { return std::malloc(bytes); }
EXPORT(release) void release(void* place) { std::free(place); }

// Makes the native board, whose boot ids follow from the seed. `flash` is as long as its flash.
EXPORT(make_native) void make_native(std::uint32_t boot_seed, const std::uint8_t* flash) {
  simulation = {};
  simulation.native = std::make_shared<NativeBoard>("", false, boot_seed);
  std::memcpy(simulation.native->memory().flash.data(), flash,
              simulation.native->memory().flash.size());
}

// Makes an emulated Due with an empty flash; load_due() writes the program and the parameters.
EXPORT(make_due) void make_due(std::uint32_t boot_seed) {
  simulation = {};
  simulation.due = std::make_shared<DueBoard>();
  simulation.due->due().chip.trng.seed(boot_seed);
}

EXPORT(load_due)
void load_due(std::uint32_t address, const std::uint8_t* bytes, std::size_t count) {
  simulation.due->due().load(address, bytes, count);
}

// Makes the world around the board. Arrays: state, parameters, and `encoders` with counts per rad,
// then offsets, of the three axes.
EXPORT(make_world)
void make_world(Step step, const double* state, std::size_t state_count, const double* parameters,
                std::size_t parameter_count, double supply_V, double dead_band,
                const double* encoders, double delay_s) {
  std::shared_ptr<heli_sim::SimBoard> board = simulation.native;
  if (simulation.due) {
    // The flight code has a handler of its own, which stops the motors and starts anew.
    simulation.due->due().chip.system.cpu.stop_at_hardfault = false;
    simulation.due->align(kTickHandler);
    board = simulation.due;
  }
  heli_sim::EncoderConfig config{};
  std::memcpy(config.counts_per_rad, encoders, sizeof config.counts_per_rad);
  std::memcpy(config.offset_count, encoders + heli::kAxisCount, sizeof config.offset_count);
  simulation.step = std::make_shared<LinkedStep>(step, state_count, parameter_count);
  simulation.step->set_delay(delay_s);
  simulation.world = std::make_unique<World>(
      board, simulation.step, std::vector<double>(state, state + state_count),
      std::vector<double>(parameters, parameters + parameter_count),
      heli_sim::PowerStage{supply_V, dead_band}, config);
}

// Lets milliseconds pass, as World::advance() does. Returns how many; -1 if the board stopped, then
// error() is the reason.
EXPORT(advance)
std::int32_t advance(std::uint32_t ticks, const std::uint8_t* bytes, std::size_t count,
                     bool until_output, std::uint32_t least) {
  simulation.to_host.clear();
  try {
    simulation.world->line().host_write(bytes, count);
    return static_cast<std::int32_t>(
        simulation.world->advance(ticks, until_output, least, simulation.to_host));
  } catch (const std::exception& error) {
    simulation.error = error.what();
    return -1;
  }
}

EXPORT(to_host) const std::uint8_t* to_host() { return simulation.to_host.data(); }
EXPORT(to_host_count) std::size_t to_host_count() { return simulation.to_host.size(); }
EXPORT(error) const char* error() { return simulation.error.c_str(); }
EXPORT(state) const double* state() { return simulation.world->state().data(); }
EXPORT(volts) const double* volts() { return simulation.world->volts_V().data(); }

EXPORT(set_parameters) void set_parameters(const double* values, std::size_t count) {
  simulation.world->set_parameters(std::vector<double>(values, values + count));
}
EXPORT(set_state) void set_state(const double* values, std::size_t count) {
  simulation.world->set_state(std::vector<double>(values, values + count));
}
EXPORT(set_delay) void set_delay(double delay_s) { simulation.step->set_delay(delay_s); }
EXPORT(support_below) void support_below(double elevation_rad) {
  simulation.world->support_below(elevation_rad);
}
EXPORT(set_encoder_out) void set_encoder_out(std::size_t axis, bool out) {
  simulation.world->set_encoder_out(axis, out);
}
EXPORT(set_supply_on) void set_supply_on(bool on) { simulation.world->set_supply_on(on); }
EXPORT(set_stop) void set_stop(bool pressed) { simulation.world->board().set_stop(pressed); }
EXPORT(set_host_reading) void set_host_reading(bool reading) {
  simulation.world->line().set_host_reading(reading);
}
EXPORT(unplug) void unplug() { simulation.world->line().clear(); }
EXPORT(reset) void reset() { simulation.world->board().reset(heli::link::Reset::user); }
EXPORT(power_cycle) void power_cycle() {
  simulation.world->board().reset(heli::link::Reset::power_up);
}

// The functions of mathematics that a plant calls.
#define MATH1(name) \
  EXPORT(math_##name) double math_##name(double x) { return std::name(x); }
#define MATH2(name) \
  EXPORT(math_##name) double math_##name(double x, double y) { return std::name(x, y); }
MATH1(sin);
MATH1(cos);
MATH1(tan);
MATH1(asin);
MATH1(acos);
MATH1(atan);
MATH1(sinh);
MATH1(cosh);
MATH1(tanh);
MATH1(exp);
MATH1(log);
MATH1(expm1);
MATH1(log1p);
MATH2(pow);
MATH2(fmod);
MATH2(fmin);
MATH2(fmax);
MATH2(atan2);
MATH2(hypot);
