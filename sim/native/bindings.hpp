// One function for each part of the extension; module.cpp calls them.
#pragma once

#include <nanobind/nanobind.h>

void bind_board(nanobind::module_& module);
void bind_world(nanobind::module_& module);
