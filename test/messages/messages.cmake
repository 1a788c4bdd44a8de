# Builds the messages of another stack that lie in msg/; DEPENDENCIES are packages that they use.

find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
foreach(package ${DEPENDENCIES})
  find_package(${package} REQUIRED)
endforeach()
file(GLOB messages RELATIVE ${CMAKE_CURRENT_SOURCE_DIR} msg/*.msg)
rosidl_generate_interfaces(${PROJECT_NAME} ${messages} DEPENDENCIES ${DEPENDENCIES})
ament_package()
