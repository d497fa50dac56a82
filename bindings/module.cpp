#include "bindings.hpp"
#include "signorini/errors.hpp"

namespace nb = nanobind;

NB_MODULE(_core, m) {
  m.doc() = "The C++ core. Private: use the package signorini, which checks and converts what goes in.";
  m.attr("__version__") = SIGNORINI_VERSION;
  nb::exception<signorini::InvalidInput>(m, "InvalidInputError", PyExc_ValueError);
  bind_problem(m);
  bind_solver(m);
}
