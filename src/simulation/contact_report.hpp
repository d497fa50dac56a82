#pragma once

#include <vector>

#include "signorini/simulation/simulator.hpp"

namespace signorini {

/// The contacts among the assembler's sets, for people. impulse, sigma: of all its rows.
std::vector<Contact> contact_reports(const Assembler& assembler, const std::vector<ContactPoint>& points,
                                     const ConstVectorRef& impulse, const ConstVectorRef& sigma, double time_step);

}  // namespace signorini
