#include "contact_report.hpp"

namespace signorini {

std::vector<Contact> contact_reports(const Assembler& assembler, const std::vector<ContactPoint>& points,
                                     const ConstVectorRef& impulse, const ConstVectorRef& sigma, double time_step) {
  std::vector<Contact> list;
  for (const Assembler::Set& set : assembler.sets()) {
    if (is_moment(set)) {  // after all contacts
      Contact& contact = list[static_cast<std::size_t>(set.index)];
      contact.moment += contact.frame.transpose() * moment_of(set, impulse.data() + set.start) / time_step;
    }
    if (set.source != SetSource::Contact) continue;
    const ContactPoint& point = points[static_cast<std::size_t>(set.index)];
    Contact contact;
    contact.geometry_a = point.geometry_a;
    contact.geometry_b = point.geometry_b;
    contact.position = point.position;
    contact.frame = set.frame;
    contact.distance = point.distance;
    const Vector3 own = impulse.segment<3>(set.start);
    contact.force = own / time_step;
    contact.velocity = sigma.segment<3>(set.start);
    contact.velocity[2] -= set.correction + set.compliance * own[2];  // sigma without gap and spring
    // On the border of the cone it slides, if not by velocity then by the next ounce of force.
    const double border = set.material.friction * own[2];
    contact.mode = !(own[2] > 0.0)                                 ? ContactMode::Open
                   : own.head<2>().norm() >= (1.0 - 1e-9) * border ? ContactMode::Slide
                                                                   : ContactMode::Stick;
    contact.id = point.id;
    list.push_back(contact);
  }
  return list;
}

}  // namespace signorini
