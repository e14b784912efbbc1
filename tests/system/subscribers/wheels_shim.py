"""What stands between the CMake files in the ROS wheels and a build with them.

The wheels bring rosidl with its CMake files, Debian brings ament_cmake; what neither has are small packages,
and the wheels remember a folder of the machine they were made on. A ROS 2 that was installed as a whole
needs nothing of this.
"""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

GENERATORS = """\
foreach(package rosidl_cmake rosidl_generator_type_description rosidl_generator_c
    rosidl_typesupport_fastrtps_c rosidl_typesupport_c rosidl_generator_py std_msgs service_msgs)
  find_package(${package} REQUIRED)
endforeach()
foreach(package std_msgs builtin_interfaces service_msgs)
  set_target_properties(
    ${package}::${package}__rosidl_generator_py PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "")
endforeach()
# Only what a Python program loads: nothing here reads the types for C++, which take longest to compile.
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp")
# Generated files share their headers, which take longer to compile than what is in the files.
set(CMAKE_UNITY_BUILD ON)
set(CMAKE_UNITY_BUILD_BATCH_SIZE 0)
cmake_language(DEFER CALL
  set_target_properties ${PROJECT_NAME}__rosidl_generator_c PROPERTIES UNITY_BUILD OFF)
"""

DEFAULTS = """\
if(NOT TARGET ament_cmake_ros_core::ament_ros_defaults)
  add_library(ament_cmake_ros_core::ament_ros_defaults INTERFACE IMPORTED)
endif()
"""


def write_shim(prefix: Path) -> None:
    """Write the packages below a prefix."""
    packages = {
        "rosidl_default_generators": GENERATORS,
        "ament_cmake_ros_core": DEFAULTS,
        # Jazzy asks for these three; what they would bring, CMake finds here or is given.
        **dict.fromkeys(("ament_cmake_ros", "python_cmake_module", "PythonExtra"), ""),
    }
    for package, text in packages.items():
        folder = prefix / "share" / package / "cmake"
        folder.mkdir(parents=True)
        (folder / f"{package}Config.cmake").write_text(text)


KEPT = """

_parse = parse_idl_string


def parse_idl_string(idl_string, png_file=None):
    import hashlib, pathlib, pickle
    kept = pathlib.Path(__file__).with_name(hashlib.sha256(idl_string.encode()).hexdigest())
    if not kept.exists():
        part = kept.with_suffix(f".{os.getpid()}")
        part.write_bytes(pickle.dumps(_parse(idl_string)))
        part.replace(kept)
    return pickle.loads(kept.read_bytes())
"""


def write_parser(folder: Path) -> None:
    """Write the parser of the generators so that it keeps what it has parsed: each of them parses every
    message, which is most of their time."""
    spec = importlib.util.find_spec("rosidl_parser")
    assert spec is not None
    assert spec.origin is not None
    shutil.copytree(Path(spec.origin).parent, folder / "rosidl_parser")
    with (folder / "rosidl_parser" / "parser.py").open("a") as parser:
        parser.write(KEPT)
