# For a build against the wheels of ROS in a Python environment, where no ROS 2 is sourced:
#   cmake -DCMAKE_PROJECT_INCLUDE=cmake/wheels.cmake -DPython3_EXECUTABLE=.../bin/python
# Wheels install into the prefix of the environment, which is then the ament index too.
find_package(Python3 REQUIRED COMPONENTS Interpreter)
execute_process(COMMAND ${Python3_EXECUTABLE} -c "import sys; print(sys.prefix, end='')"
  OUTPUT_VARIABLE environment_prefix COMMAND_ERROR_IS_FATAL ANY)
list(PREPEND CMAKE_PREFIX_PATH ${environment_prefix})
set(ENV{AMENT_PREFIX_PATH} ${environment_prefix})

# Targets of the wheels name folders of the machine that built them. CMake refuses a target with
# a folder that is missing, and needs none of them: the generator adds Python's and NumPy's own.
function(forget_missing_folders)
  get_property(imported DIRECTORY PROPERTY IMPORTED_TARGETS)
  list(FILTER imported INCLUDE REGEX "__rosidl_generator_py$")
  foreach(target ${imported})
    get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
    set(there)
    foreach(folder ${folders})
      if(EXISTS ${folder})
        list(APPEND there ${folder})
      endif()
    endforeach()
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${there}")
  endforeach()
endfunction()
cmake_language(DEFER CALL forget_missing_folders)

# The C++ of a message includes far more than it says: all of a target in one file is compiled in a
# third of the time.
function(compile_in_one_file)
  get_property(targets DIRECTORY PROPERTY BUILDSYSTEM_TARGETS)
  list(FILTER targets INCLUDE REGEX "__rosidl_typesupport_(cpp|fastrtps_c|fastrtps_cpp)$")
  set_target_properties(${targets} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 0)
endfunction()
cmake_language(DEFER CALL compile_in_one_file)
