"""Builds the messages with pip, without CMake: the rosidl generators are Python and come as wheels.

What they generate lies in `build/generated` and is compiled into one extension: the C type support of
Fast DDS, the only middleware there are wheels for, and the introspection it asks for beside. On a system
ROS 2 this file is not used: colcon reads package.xml and CMakeLists.txt.
"""

from __future__ import annotations

import os
import re
import shutil
import sysconfig
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build import build
from setuptools.command.build_ext import build_ext

NAME = "twinmatch_msgs"
HERE = Path(__file__).resolve().parent
MESSAGES = sorted((HERE / "msg").glob("*.msg"))
GENERATED = HERE / "build" / "generated" / NAME
USED_PACKAGES = ("std_msgs", "builtin_interfaces")

DISPATCH_HEAD = """\
#include <cstring>
#include "rosidl_runtime_c/message_type_support_struct.h"
#include "rosidl_typesupport_interface/macros.h"
"""
DISPATCH = """
#include "{package}/msg/detail/{file}__type_support.h"
#include "{package}/msg/detail/{file}__rosidl_typesupport_fastrtps_c.h"
#include "{package}/msg/detail/{file}__rosidl_typesupport_introspection_c.h"

static const rosidl_message_type_support_t * {file}_by_name(
  const rosidl_message_type_support_t * handle, const char * name)
{{
  const auto * introspection = ROSIDL_TYPESUPPORT_INTERFACE__MESSAGE_SYMBOL_NAME(
    rosidl_typesupport_introspection_c, {package}, msg, {message})();
  if (std::strcmp(name, introspection->typesupport_identifier) == 0) {{
    return introspection;
  }}
  return get_message_typesupport_handle_function(handle, name);
}}

extern "C" const rosidl_message_type_support_t *
ROSIDL_TYPESUPPORT_INTERFACE__MESSAGE_SYMBOL_NAME(rosidl_typesupport_c, {package}, msg, {message})()
{{
  static const rosidl_message_type_support_t handle = [] {{
    auto copy = *ROSIDL_TYPESUPPORT_INTERFACE__MESSAGE_SYMBOL_NAME(
      rosidl_typesupport_fastrtps_c, {package}, msg, {message})();
    copy.func = {file}_by_name;
    return copy;
  }}();
  return &handle;
}}
"""
"""The generator's own choice between two type supports loads a library of its own for each of them."""


def check_compiler() -> None:
    """Say in one line what is missing, before the compiler says it in a hundred."""
    compiler = os.environ.get("CXX", "g++").split()[0]
    if shutil.which(compiler) is None:
        raise SystemExit(f"{NAME}: no C++ compiler ({compiler}); install it: apt-get install g++")
    header = Path(sysconfig.get_path("include")) / "Python.h"
    if not header.exists():
        raise SystemExit(f"{NAME}: {header} is missing; install it: apt-get install python3-dev")


def ros_prefix() -> Path:
    """Where the ROS wheels put their `share` and `lib`."""
    try:
        import rosidl_cli
    except ImportError:
        raise SystemExit(f"{NAME}: no rosidl generators; run 'make setup' or use colcon") from None
    return Path(rosidl_cli.__file__).resolve().parents[4]


def generate(prefix: Path) -> None:
    """Turn msg/*.msg into C sources and Python modules below `GENERATED`."""
    os.environ["AMENT_PREFIX_PATH"] = str(prefix)
    from rosidl_cli.command.translate.api import translate
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    share = [str(prefix / "share")]
    idl = [
        str(path)
        for path in translate(
            package_name=NAME,
            interface_files=[f"{HERE}:msg/{path.name}" for path in MESSAGES],
            include_paths=share,
            output_format="idl",
            output_path=GENERATED,
        )
    ]
    hashes = HashTypeDescription("hashes").generate_type_hashes(
        package_name=NAME, interface_files=idl, include_paths=share, output_path=GENERATED
    )
    GenerateC("c").generate(NAME, idl, share, GENERATED, type_description_files=hashes)
    GenerateFastRTPSCTypesupport("fastrtps").generate(NAME, idl, share, GENERATED)
    GenerateIntrospectionCTypesupport("introspection").generate(NAME, idl, share, GENERATED)
    (GENERATED / "dispatch.cpp").write_text(DISPATCH_HEAD + "".join(map(dispatch, MESSAGES)))
    implementations = {"typesupport_implementations": ["rosidl_typesupport_c"]}
    GeneratePython("python", **implementations).generate(NAME, idl, share, GENERATED)
    (GENERATED / "__init__.py").touch()


def dispatch(message: Path) -> str:
    """C++ that finds either type support of a message without leaving the extension."""
    file = re.sub("(?<=[a-z0-9])(?=[A-Z])", "_", message.stem).lower()
    return DISPATCH.format(package=NAME, file=file, message=message.stem)


def fill(extension: Extension, prefix: Path) -> None:
    """Point the extension at what was generated and at the libraries of the messages ours are made of."""
    import numpy

    extension.sources = sorted(
        os.path.relpath(path, HERE) for path in GENERATED.rglob("*") if path.suffix in {".c", ".cpp"}
    )
    include = prefix / "include"
    folders = sorted(path for path in include.iterdir() if path.is_dir())
    extension.include_dirs = [str(path) for path in (GENERATED.parent, include, *folders)]
    extension.include_dirs.append(numpy.get_include())
    kinds = ("generator_c", "generator_py", "typesupport_fastrtps_c", "typesupport_introspection_c")
    extension.libraries = [f"{used}__rosidl_{kind}" for used in USED_PACKAGES for kind in kinds]
    extension.libraries += ["rosidl_runtime_c", "rosidl_typesupport_fastrtps_c"]
    extension.libraries += ["rosidl_typesupport_fastrtps_cpp", "rosidl_typesupport_introspection_c"]
    extension.libraries += ["rmw", "rcutils"]
    fast_cdr = next(iter(sorted((prefix / "lib").glob("libfastcdr.so.*"))))
    extension.library_dirs = [str(prefix / "lib")]
    extension.extra_link_args = [f"-l:{fast_cdr.name}"]
    extension.runtime_library_dirs = ["$ORIGIN/../../.."]
    extension.extra_compile_args = ["-O1", "-g0"]


class Build(build):
    """Start from an empty folder: a message that was removed must not be shipped."""

    def run(self) -> None:
        """Generate, then build what was generated."""
        check_compiler()
        shutil.rmtree(HERE / "build", ignore_errors=True)
        GENERATED.mkdir(parents=True)
        generate(ros_prefix())
        super().run()


class BuildExtension(build_ext):
    """The sources are known only after they were generated."""

    def run(self) -> None:
        """Fill in the sources, then compile them."""
        for extension in self.extensions:
            fill(extension, ros_prefix())
        self.parallel = self.parallel or os.cpu_count()
        super().run()


(GENERATED / "msg").mkdir(parents=True, exist_ok=True)
setup(
    packages=[NAME, f"{NAME}.msg"],
    package_dir={NAME: os.path.relpath(GENERATED, HERE)},
    ext_modules=[Extension(f"{NAME}.{NAME}_s__rosidl_typesupport_c", sources=[], language="c++")],
    data_files=[
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/msg", [f"msg/{path.name}" for path in MESSAGES]),
    ],
    cmdclass={"build": Build, "build_ext": BuildExtension},
)
