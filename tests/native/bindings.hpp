// One function for each room of tests; module.cpp calls them.
#pragma once

#include <nanobind/nanobind.h>

void bind_control(nanobind::module_& module);
void bind_flight(nanobind::module_& module);
void bind_law(nanobind::module_& module);
void bind_link(nanobind::module_& module);
void bind_plant(nanobind::module_& module);
void bind_proofs(nanobind::module_& module);
