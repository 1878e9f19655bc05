// One function for each part of the extension; module.cpp calls them.
#pragma once

#include <nanobind/nanobind.h>

void bind_core(nanobind::module_& module);
void bind_due(nanobind::module_& module);
