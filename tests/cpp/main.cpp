// The main of Boost.Test, for executables of several files.
#define BOOST_TEST_MODULE signorini
#include <boost/test/unit_test.hpp>
