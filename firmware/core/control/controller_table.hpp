// The compiled controllers of a board: one row per controller. The parameter `controller` selects a
// row.
#pragma once

#include <cstddef>

#include "control/controller.hpp"
#include "link/controller_names.hpp"
#include "params/params.hpp"

namespace heli::control {

struct ControllerRow {
  const char* name;  // at most link::ControllerNames::kCharacters of it reach the host
  Controller& controller;
};

class ControllerTable {
 public:
  template <std::size_t kRows>
  explicit ControllerTable(const ControllerRow (&rows)[kRows]) {
    static_assert(kRows <= link::ControllerNames::kMax, "link.toml: the parameter controller");
    for (const ControllerRow& row : rows) {
      controllers_[names_.count] = &row.controller;
      names_.name[names_.count++] = row.name;
    }
    for (Controller*& selected : selected_) {
      selected = controllers_[0];
    }
  }

  const link::ControllerNames& names() const { return names_; }

  // Derives the constants of all rows, so that the row that flies has them in both banks even while
  // another one is selected. A number beyond the last row selects row 0.
  void derive(IdleLoop idle, const params::Params& params, Bank bank) {
    for (std::size_t row = 0; row < names_.count; ++row) {
      controllers_[row]->derive(idle, params, bank);
    }
    const auto row = static_cast<std::size_t>(params.get(link::Param::controller));
    selected_[bank] = controllers_[row < names_.count ? row : 0];
  }

  Controller& selected(Bank bank) const { return *selected_[bank]; }

 private:
  link::ControllerNames names_;
  Controller* controllers_[link::ControllerNames::kMax] = {};
  Controller* selected_[kBanks] = {};
};

}  // namespace heli::control
