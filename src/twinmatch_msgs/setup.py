"""Build messages and services with pip, without CMake: the rosidl generators are Python and come as wheels.

The generated code in `build/generated` is compiled into one extension: the C type support of Fast DDS, the
only middleware with wheels, and the introspection type support that it also needs. On a system ROS 2 this
file is not used: colcon reads package.xml and CMakeLists.txt.
"""

from __future__ import annotations

import copy
import functools
import multiprocessing
import os
import re
import shutil
import sysconfig
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from setuptools import Extension, setup
from setuptools.command.build import build
from setuptools.command.build_ext import build_ext

NAME = "twinmatch_msgs"
HERE = Path(__file__).resolve().parent
MESSAGES = sorted((HERE / "msg").glob("*.msg"))
SERVICES = sorted((HERE / "srv").glob("*.srv"))
GENERATED = HERE / "build" / "generated" / NAME
USED_PACKAGES = ("std_msgs", "service_msgs", "builtin_interfaces")
JOINED = {"python.c": "*_s.c", "fastrtps.cpp": "*__type_support_c.cpp"}
"""Generated files that are compiled as one: their headers take longer than their code."""

DISPATCH_HEAD = """\
#include <cstring>
#include "rosidl_runtime_c/message_type_support_struct.h"
#include "rosidl_runtime_c/service_type_support_struct.h"
#include "rosidl_typesupport_interface/macros.h"
"""
INCLUDE = """
#include "{package}/{folder}/detail/{file}__type_support.h"
#include "{package}/{folder}/detail/{file}__rosidl_typesupport_fastrtps_c.h"
#include "{package}/{folder}/detail/{file}__rosidl_typesupport_introspection_c.h"
"""
DISPATCH = """
static const rosidl_{kind}_type_support_t * {name}_by_name(
  const rosidl_{kind}_type_support_t * handle, const char * name)
{{
  const auto * introspection = ROSIDL_TYPESUPPORT_INTERFACE__{KIND}_SYMBOL_NAME(
    rosidl_typesupport_introspection_c, {package}, {folder}, {name})();
  if (std::strcmp(name, introspection->typesupport_identifier) == 0) {{
    return introspection;
  }}
  return get_{kind}_typesupport_handle_function(handle, name);
}}

extern "C" const rosidl_{kind}_type_support_t *
ROSIDL_TYPESUPPORT_INTERFACE__{KIND}_SYMBOL_NAME(rosidl_typesupport_c, {package}, {folder}, {name})()
{{
  static const rosidl_{kind}_type_support_t handle = [] {{
    auto copy = *ROSIDL_TYPESUPPORT_INTERFACE__{KIND}_SYMBOL_NAME(
      rosidl_typesupport_fastrtps_c, {package}, {folder}, {name})();
    copy.func = {name}_by_name;{parts}
    return copy;
  }}();
  return &handle;
}}
"""
"""Replaces the generator's dispatch between two type supports, which loads a separate library for each."""
PART = """
    copy.{part}_typesupport = ROSIDL_TYPESUPPORT_INTERFACE__MESSAGE_SYMBOL_NAME(
      rosidl_typesupport_c, {package}, {folder}, {name})();"""


def check_compiler() -> None:
    """Report a missing compiler or header in one line, before the compiler prints a hundred."""
    compiler = os.environ.get("CXX", "g++").split()[0]
    if shutil.which(compiler) is None:
        raise SystemExit(
            f"{NAME}: no C++ compiler ({compiler}); install it: apt-get install g++"
        )
    header = Path(sysconfig.get_path("include")) / "Python.h"
    if not header.exists():
        raise SystemExit(
            f"{NAME}: {header} is missing; install it: apt-get install python3-dev"
        )


def ros_prefix() -> Path:
    """The prefix with `share` and `lib` of the ROS wheels."""
    try:
        import rosidl_cli
    except ImportError:
        raise SystemExit(
            f"{NAME}: no rosidl generators; run 'make setup' or use colcon"
        ) from None
    return Path(rosidl_cli.__file__).resolve().parents[4]


def requirements() -> list[str]:
    """Requirements of the built messages: the wheels of the release used for the build, and numpy."""
    installed = {d.metadata["Name"]: d.version for d in distributions()}
    releases = [r for r in ("jazzy", "kilted") if f"ros-{r}-rclpy" in installed]
    if not releases:
        return ["numpy>=1.26"]
    names = [
        f"ros-{releases[0]}-std-msgs",
        f"ros-{releases[0]}-rmw-fastrtps-cpp",
        "ros-service-msgs",
    ]
    return ["numpy>=1.26", *(f"{name}~={installed[name]}" for name in names)]


def generate(prefix: Path) -> None:
    """Turn msg/*.msg and srv/*.srv into C sources and Python modules below `GENERATED`."""
    os.environ["AMENT_PREFIX_PATH"] = str(prefix)
    from rosidl_cli.command.translate.api import translate
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    parse_once()
    share = [str(prefix / "share")]
    idl = [
        str(path)
        for path in translate(
            package_name=NAME,
            interface_files=[
                f"{HERE}:{path.parent.name}/{path.name}" for path in MESSAGES + SERVICES
            ],
            include_paths=share,
            output_format="idl",
            output_path=GENERATED,
        )
    ]
    hashes = HashTypeDescription("hashes").generate_type_hashes(
        package_name=NAME,
        interface_files=idl,
        include_paths=share,
        output_path=GENERATED,
    )

    def generate_c() -> None:
        GenerateC("c").generate(
            NAME, idl, share, GENERATED, type_description_files=hashes
        )
        for path in GENERATED.glob(
            "*/detail/*__type_support.c"
        ):  # the introspection has files of this name too
            path.rename(path.with_name(path.name.replace("__type_support", "__events")))
        GenerateIntrospectionCTypesupport("introspection").generate(
            NAME, idl, share, GENERATED
        )

    def generate_fastrtps() -> None:
        GenerateFastRTPSCTypesupport("fastrtps").generate(NAME, idl, share, GENERATED)

    def generate_python() -> None:
        implementations = {"typesupport_implementations": ["rosidl_typesupport_c"]}
        GeneratePython("python", **implementations).generate(
            NAME, idl, share, GENERATED
        )

    side_by_side(generate_python, generate_c, generate_fastrtps)
    (GENERATED / "dispatch.cpp").write_text(
        DISPATCH_HEAD + "".join(map(dispatch, MESSAGES + SERVICES))
    )
    for name, pattern in JOINED.items():
        parts = sorted(
            path.relative_to(GENERATED.parent) for path in GENERATED.rglob(pattern)
        )
        (GENERATED / name).write_text("".join(f'#include "{part}"\n' for part in parts))
    (GENERATED / "__init__.py").touch()


def parse_once() -> None:
    """Let the generators share what is parsed; each parses every file, which is most of their time."""
    from rosidl_parser import parser

    parse = functools.cache(parser.parse_idl_string)
    parser.parse_idl_string = lambda text, **options: copy.deepcopy(
        parse(text, **options)
    )


def side_by_side(*jobs: Callable[[], None]) -> None:
    """Run jobs in processes of their own, which know everything that this one does."""
    started = [multiprocessing.get_context("fork").Process(target=job) for job in jobs]
    for process in started:
        process.start()
    for process in started:
        process.join()
    if any(process.exitcode for process in started):
        raise SystemExit(f"{NAME}: the rosidl generators failed")


def dispatch(source: Path) -> str:
    """C++ code that finds either type support of a message or service within the extension."""
    file = re.sub("(?<=[a-z0-9])(?=[A-Z])", "_", source.stem).lower()
    place = {"package": NAME, "folder": source.parent.name}
    parts = {
        part: f"{source.stem}_{part.title()}"
        for part in ("request", "response", "event")
    }
    message = {"kind": "message", "KIND": "MESSAGE", "parts": ""}
    code = INCLUDE.format(file=file, **place)
    if source in MESSAGES:
        return code + DISPATCH.format(name=source.stem, **message, **place)
    code += "".join(
        DISPATCH.format(name=name, **message, **place) for name in parts.values()
    )
    joined = "".join(
        PART.format(part=part, name=name, **place) for part, name in parts.items()
    )
    return code + DISPATCH.format(
        kind="service", KIND="SERVICE", name=source.stem, parts=joined, **place
    )


def fill(extension: Extension, prefix: Path) -> None:
    """Set the extension's sources to the generated code, and its libraries to those of the messages used."""
    import numpy

    joined = {path for pattern in JOINED.values() for path in GENERATED.rglob(pattern)}
    sources = {
        path for path in GENERATED.rglob("*") if path.suffix in {".c", ".cpp"}
    } - joined
    # The longest first, so that no processor waits for one at the end.
    names = [os.path.relpath(path, HERE) for path in sorted(sources)]
    extension.sources = sorted(names, key=lambda name: Path(name).name not in JOINED)
    include = prefix / "include"
    folders = sorted(path for path in include.iterdir() if path.is_dir())
    extension.include_dirs = [
        str(path) for path in (GENERATED.parent, include, *folders)
    ]
    extension.include_dirs.append(numpy.get_include())
    kinds = (
        "generator_c",
        "generator_py",
        "typesupport_fastrtps_c",
        "typesupport_introspection_c",
    )
    extension.libraries = [
        f"{used}__rosidl_{kind}" for used in USED_PACKAGES for kind in kinds
    ]
    extension.libraries += ["rosidl_runtime_c", "rosidl_typesupport_fastrtps_c"]
    extension.libraries += [
        "rosidl_typesupport_fastrtps_cpp",
        "rosidl_typesupport_introspection_c",
    ]
    extension.libraries += ["rmw", "rcutils"]
    fast_cdr = next(iter(sorted((prefix / "lib").glob("libfastcdr.so.*"))))
    extension.library_dirs = [str(prefix / "lib")]
    extension.extra_link_args = [f"-l:{fast_cdr.name}"]
    extension.runtime_library_dirs = ["$ORIGIN/../../.."]
    extension.extra_compile_args = ["-O1", "-g0"]


class Build(build):
    """Build from an empty folder, so that a removed message is not shipped."""

    def run(self) -> None:
        """Generate the code, then build it."""
        check_compiler()
        shutil.rmtree(HERE / "build", ignore_errors=True)
        GENERATED.mkdir(parents=True)
        generate(ros_prefix())
        super().run()


class BuildExtension(build_ext):
    """Sets the sources only at build time, after they were generated."""

    def run(self) -> None:
        """Fill in the sources, then compile them."""
        for extension in self.extensions:
            fill(extension, ros_prefix())
        super().run()

    def build_extensions(self) -> None:
        """Compile the sources of the extension side by side."""
        compile_some = self.compiler.compile

        def compile_all(sources: list[str], **options: Any) -> list[str]:
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                made = pool.map(
                    lambda source: compile_some([source], **options), sources
                )
                return [name for names in made for name in names]

        self.compiler.compile = compile_all
        super().build_extensions()


for folder in ("msg", "srv"):
    (GENERATED / folder).mkdir(parents=True, exist_ok=True)
setup(
    packages=[NAME, f"{NAME}.msg", f"{NAME}.srv"],
    package_dir={NAME: os.path.relpath(GENERATED, HERE)},
    ext_modules=[
        Extension(f"{NAME}.{NAME}_s__rosidl_typesupport_c", sources=[], language="c++")
    ],
    data_files=[
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/msg", [f"msg/{path.name}" for path in MESSAGES]),
        (f"share/{NAME}/srv", [f"srv/{path.name}" for path in SERVICES]),
    ],
    install_requires=requirements(),
    cmdclass={"build": Build, "build_ext": BuildExtension},
)
