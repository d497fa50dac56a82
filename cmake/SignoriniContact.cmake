# The library signorini_contact: problem, delassus, solver. Depends on Eigen and on nothing else.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)
find_package(Eigen3 3.4 REQUIRED NO_MODULE)

set(source_dir ${PROJECT_SOURCE_DIR}/src)
file(GLOB contact_sources CONFIGURE_DEPENDS ${source_dir}/problem/*.cpp ${source_dir}/delassus/*.cpp
     ${source_dir}/solver/*.cpp)
set(kernel_sources ${source_dir}/delassus/dense_kernels.cpp ${source_dir}/solver/cone_kernels.cpp)
list(REMOVE_ITEM contact_sources ${kernel_sources})

add_library(signorini_contact STATIC ${contact_sources})
add_library(signorini::contact ALIAS signorini_contact)
set_target_properties(signorini_contact PROPERTIES EXPORT_NAME contact)
target_compile_features(signorini_contact PUBLIC cxx_std_17)
target_link_libraries(signorini_contact PUBLIC Eigen3::Eigen)
# How Eigen allocates depends on -mavx and on AddressSanitizer. These two make it the same here and in whoever links this
# library: what one allocates the other may free.
if(CMAKE_SIZEOF_VOID_P EQUAL 8)
  target_compile_definitions(signorini_contact PUBLIC EIGEN_MAX_ALIGN_BYTES=16 EIGEN_MALLOC_ALREADY_ALIGNED=1)
endif()

# What every file of ours is compiled with, tests and bindings included.
function(signorini_compile_options target)
  target_include_directories(${target} PRIVATE ${PROJECT_SOURCE_DIR}/include ${source_dir})
  target_compile_definitions(${target} PRIVATE SIGNORINI_VERSION="${PROJECT_VERSION}")
  if(CMAKE_CXX_COMPILER_ID MATCHES "GNU|Clang")
    target_compile_options(${target} PRIVATE -Wall -Wextra -Wshadow -Wnon-virtual-dtor -Woverloaded-virtual)
    # errno is nobody's business here. Contracting a * b + c would make the bits depend on the compiler.
    target_compile_options(${target} PRIVATE -fno-math-errno -ffp-contract=off)
  endif()
  if(SIGNORINI_NO_MALLOC)
    target_compile_definitions(${target} PRIVATE EIGEN_RUNTIME_NO_MALLOC SIGNORINI_NO_MALLOC)
  endif()
endfunction()

# Eigen's headers take longer to read than most files of ours to compile: the files of one call become one.
function(signorini_compile_together target group)
  set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_MODE GROUP)
  set_source_files_properties(${ARGN} PROPERTIES UNITY_GROUP ${group})
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")  # what is local to a file is in a header now, to its eyes
    target_compile_options(${target} PRIVATE -Wno-subobject-linkage)
  endif()
endfunction()

signorini_compile_options(signorini_contact)
foreach(folder problem delassus solver)
  file(GLOB folder_sources ${source_dir}/${folder}/*.cpp)
  signorini_compile_together(signorini_contact ${folder} ${folder_sources})
endforeach()
target_include_directories(signorini_contact PUBLIC $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/include>
                                                    $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)

# The kernels: one copy an instruction set, chosen when the library starts; elsewhere one plain copy.
function(signorini_add_kernels name)
  add_library(signorini_kernels_${name} OBJECT ${kernel_sources})
  if(NOT name STREQUAL "plain")
    target_compile_definitions(signorini_kernels_${name} PRIVATE SIGNORINI_KERNEL_NAMESPACE=kernels_${name})
  endif()
  signorini_compile_options(signorini_kernels_${name})
  # Without traps the compiler may compute both sides of a choice, eight cones at a time.
  target_compile_options(signorini_kernels_${name} PRIVATE -fno-trapping-math)
  target_compile_options(signorini_kernels_${name} PRIVATE ${ARGN})
  set_target_properties(signorini_kernels_${name} PROPERTIES CXX_VISIBILITY_PRESET hidden
                                                             VISIBILITY_INLINES_HIDDEN ON)
  target_sources(signorini_contact PRIVATE $<TARGET_OBJECTS:signorini_kernels_${name}>)
endfunction()

if(CMAKE_SYSTEM_PROCESSOR MATCHES "^(x86_64|AMD64)$" AND CMAKE_CXX_COMPILER_ID MATCHES "GNU|Clang")
  signorini_add_kernels(sse2)
  signorini_add_kernels(avx2 -mavx2 -mfma -ffp-contract=fast)
  signorini_add_kernels(avx512 -mavx512f -mavx512dq -mavx512vl -mprefer-vector-width=512 -mfma -ffp-contract=fast
                        $<$<CXX_COMPILER_ID:GNU>:-Wno-maybe-uninitialized>)  # of what GCC's own intrinsics leave open on purpose
  set_property(SOURCE ${source_dir}/delassus/dense_kernels_dispatch.cpp ${source_dir}/solver/cone_kernels_dispatch.cpp
               APPEND PROPERTY COMPILE_DEFINITIONS SIGNORINI_KERNELS_X86)
else()
  signorini_add_kernels(plain)
endif()

if(SIGNORINI_INSTALL)
  set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/signorini_contact)
  install(TARGETS signorini_contact EXPORT signorini_contact-targets COMPONENT cpp)
  set(include_dir ${PROJECT_SOURCE_DIR}/include/signorini)
  install(FILES ${include_dir}/types.hpp ${include_dir}/errors.hpp
          DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/signorini COMPONENT cpp)
  install(DIRECTORY ${include_dir}/problem ${include_dir}/delassus ${include_dir}/solver
          DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/signorini COMPONENT cpp)
  install(EXPORT signorini_contact-targets NAMESPACE signorini:: DESTINATION ${package_dir} COMPONENT cpp)
  configure_package_config_file(${PROJECT_SOURCE_DIR}/cmake/signorini_contact-config.cmake.in
                                ${PROJECT_BINARY_DIR}/signorini_contact-config.cmake INSTALL_DESTINATION ${package_dir})
  write_basic_package_version_file(${PROJECT_BINARY_DIR}/signorini_contact-config-version.cmake
                                   COMPATIBILITY SameMinorVersion)
  install(FILES ${PROJECT_BINARY_DIR}/signorini_contact-config.cmake
                ${PROJECT_BINARY_DIR}/signorini_contact-config-version.cmake DESTINATION ${package_dir} COMPONENT cpp)
endif()
