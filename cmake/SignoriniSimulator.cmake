# Two libraries on top of signorini_contact. signorini_collision: shapes and the contact detector, with Coal.
# signorini_simulator: model, assembly, simulation, rollout.
find_package(coal 3.0 REQUIRED NO_MODULE)
file(GLOB collision_sources CONFIGURE_DEPENDS ${source_dir}/collision/*.cpp)
add_library(signorini_collision STATIC ${collision_sources} ${source_dir}/model/shape.cpp)
add_library(signorini::collision ALIAS signorini_collision)
target_link_libraries(signorini_collision PUBLIC signorini::contact PRIVATE coal::coal)
signorini_compile_options(signorini_collision)
set(pair_sources ${source_dir}/collision/hull.cpp ${source_dir}/collision/manifold.cpp
    ${source_dir}/collision/convex_pair.cpp)
list(REMOVE_ITEM collision_sources ${pair_sources})
signorini_compile_together(signorini_collision pair ${pair_sources} ${source_dir}/model/shape.cpp)
signorini_compile_together(signorini_collision detector ${collision_sources})

if(NOT SIGNORINI_BUILD_SIMULATOR)
  return()
endif()
find_package(Threads REQUIRED)
file(GLOB simulator_sources CONFIGURE_DEPENDS ${source_dir}/model/*.cpp ${source_dir}/assembly/*.cpp
     ${source_dir}/simulation/*.cpp ${source_dir}/rollout/*.cpp)
list(REMOVE_ITEM simulator_sources ${source_dir}/model/shape.cpp)
add_library(signorini_simulator STATIC ${simulator_sources})
add_library(signorini::simulator ALIAS signorini_simulator)
target_link_libraries(signorini_simulator PUBLIC signorini::collision PRIVATE Threads::Threads)
signorini_compile_options(signorini_simulator)
signorini_compile_together(signorini_simulator simulator ${simulator_sources})
