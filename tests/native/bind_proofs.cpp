// The invariants of firmware/proofs on flight code that breaks one. Compiled without access
// control.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <memory>
#include <string>

#include "flight_code.hpp"
#include "invariants.hpp"
#include "native_board.hpp"

namespace nb = nanobind;

namespace {

// What the check says of a started board, after one member was made wrong; empty if all is well.
std::string broken_by(const std::string& member) {
  heli_sim::MemoryBoard board;
  const auto code = std::make_unique<heli::FlightCode>(board);
  heli::Core& core = code->core;
  core.start();
  core.tick();
  if (member == "decoded_count") {
    core.link_.parser_.decoded_count_ = heli::link::Parser::kMaxBytes + 1U;
  } else if (member == "busy") {
    core.link_.dispatcher_.busy_ = true;
  } else if (member == "reply_size") {
    core.link_.dispatcher_.reply_.size = heli::link::Outgoing::kMaxBytes + 1U;
  } else if (member == "fault") {
    core.supervisor_.fault_ = heli::link::Fault::hardware_stop;
  } else if (member == "exciter") {
    core.supervisor_.exciter_.kind_ = heli::link::Excitation::chirp;
  } else if (member == "flying") {
    core.uploaded_.tape_.flying_ = true;
  } else if (member == "parameters") {
    core.uploaded_.tape_.stored_ = heli::law::LawState::ready;
    core.uploaded_.tape_.shape_.parameters = heli::law::Tape::kCells;
  } else if (member == "program_end") {
    core.uploaded_.tape_.stored_ = heli::law::LawState::ready;
    core.uploaded_.tape_.program_at_ = core.uploaded_.tape_.shape_.outputs();
    core.uploaded_.tape_.ends_[0] = 1;
  } else if (member == "slew") {
    core.derived_[core.active_].setpoint_limits.step_max_rad[0] = heli::flight::Step::from_raw(-1);
  } else if (member == "path") {
    core.supervisor_.setpoints_.axes_[0].path.raw_ = std::int64_t{1} << 44;
  } else if (member == "differential") {
    code->cascade.constants_[core.active_].mixer.differential_max_V =
        heli::control::Quantity::from_raw(INT32_MAX);
  } else if (member == "max_duty") {
    core.derived_[core.active_].conversion.back.max_duty = board.kDutyFull + 1;
  }
  const char* claim = heli_sim::broken_invariant(*code, board.kDutyFull);
  return claim == nullptr ? "" : claim;
}

}  // namespace

void bind_proofs(nb::module_& module) {
  auto proofs = module.def_submodule("proofs");
  proofs.def("broken_by", &broken_by, nb::arg("member"));
}
