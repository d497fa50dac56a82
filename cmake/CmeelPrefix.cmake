# Eigen, Boost and Coal may come from PyPI ("cmeel" wheels). Those keep their files in <site-packages>/cmeel.prefix, where
# CMake does not look. Candidates: the entries of CMAKE_PREFIX_PATH (scikit-build-core puts the build environment's
# site-packages there) and the site-packages of the Python that FindPython prefers, an active virtual environment first.
set(candidates ${CMAKE_PREFIX_PATH} $ENV{CMAKE_PREFIX_PATH})
string(REPLACE ":" ";" candidates "${candidates}")
find_package(Python 3.10 QUIET COMPONENTS Interpreter OPTIONAL_COMPONENTS Development.Module)
if(Python_SITELIB)
  list(APPEND candidates ${Python_SITELIB})
endif()
foreach(wanted "lib/cmake/coal" "share/eigen3")
  foreach(candidate IN LISTS candidates)
    if(EXISTS "${candidate}/cmeel.prefix/${wanted}")
      list(PREPEND CMAKE_PREFIX_PATH "${candidate}/cmeel.prefix")
      break()
    endif()
  endforeach()
endforeach()
unset(candidates)
