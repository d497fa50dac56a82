#pragma once

#include <nanobind/nanobind.h>

void bind_problem(nanobind::module_& m);
void bind_solver(nanobind::module_& m);
