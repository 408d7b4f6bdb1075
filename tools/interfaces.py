"""Build the types of `PACKAGES` into the virtual environment whose interpreter runs this, where that is not done yet.

No package registry has them. rclpy's wheels bring what generates it and what it is linked with; from outside
come a C++ compiler and, for the time of the build, empy 3.3.4: the generators' templates do not work with a newer one.
The generated C and C++ is what rclpy on Fast DDS needs and no more. Its libraries lie beside the Python classes and
carry the path to those of the wheels (RPATH); the definitions are entered in the environment's ament index.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tools.environment import ROOT, UnsuitableError, alone

PACKAGES = ("control_msgs", "controller_manager_msgs", "tf2_msgs")
DEFINITIONS = ROOT / "interfaces"
# The packages whose types the definitions use, and those that rosidl adds to services and actions.
USED = (
    *(
        "action_msgs",
        "builtin_interfaces",
        "geometry_msgs",
        "lifecycle_msgs",
        "service_msgs",
        "std_msgs",
    ),
    *("trajectory_msgs", "unique_identifier_msgs"),
)
LIBRARIES = ("generator_c", "typesupport_fastrtps_c", "typesupport_introspection_c")
MODULE = "typesupport_c"
LOG = ROOT / "build" / "interfaces.log"
_RUNTIME = (
    *(f"rosidl_{name}" for name in (*LIBRARIES[1:], MODULE, "runtime_c")),
    "rcutils",
    "fastcdr",
)
_EMPY = "empy==3.3.4"


def main() -> int:
    """Build what is not built; 1 with one line when that cannot be done."""
    site = Path(sysconfig.get_path("purelib"))
    if not unbuilt(site):
        return 0
    (ROOT / "build").mkdir(exist_ok=True)
    try:
        with alone(ROOT / "build" / "interfaces.lock"):
            if packages := unbuilt(site):  # not by another that held the lock
                start = time.monotonic()
                build(packages, site)
                _say(
                    f"{' and '.join(packages)} built into {site} in {time.monotonic() - start:.0f} s"
                )
    except UnsuitableError as error:
        _say(f"{' and '.join(unbuilt(site))} not built, what needs them stays off: {error}")
        return 1
    except KeyboardInterrupt:
        _say("interrupted; the next run builds it")
        return 130
    return 0


def unbuilt(site: Path) -> list[str]:
    """Return the packages that were not built whole, into this folder of packages, from what there is now."""
    stamps = {package: _stamp(site / package) for package in PACKAGES}
    return [
        package
        for package, stamp in stamps.items()
        if not (stamp.is_file() and stamp.read_text(encoding="utf-8") == inputs(package))
    ]


def inputs(package: str) -> str:
    """Return a hash of what the build depends on: definitions, this file, interpreter, versions of ROS's wheels."""
    digest = hashlib.sha256(sys.version.encode())
    for path in (Path(__file__), *definitions(package)):
        digest.update(f"{path.name} {path.stat().st_size} ".encode() + path.read_bytes())
    wheels = Path(sysconfig.get_path("purelib")).glob("ros_*.dist-info")
    digest.update(" ".join(sorted(path.name for path in wheels)).encode())
    return digest.hexdigest()


def definitions(package: str) -> list[Path]:
    """Return the interface files of a package."""
    kinds = ("action", "msg", "srv")
    return sorted(
        path for kind in kinds for path in (DEFINITIONS / package / kind).glob(f"*.{kind}")
    )


def build(packages: Sequence[str], site: Path) -> None:
    """Generate and compile packages, and put them into the folder of packages.

    Raises:
        UnsuitableError: in one line, where something is missing or a step fails.
    """
    if sys.prefix == sys.base_prefix:
        raise UnsuitableError(
            f"{sys.executable} belongs to no virtual environment; accepted: make action, "
            f"or with ROS installed sudo apt install {' '.join(debian_name(package) for package in PACKAGES)}"
        )
    compiler = find_compiler()
    _say(f"building {' and '.join(packages)} with {compiler[0]}")
    with tempfile.TemporaryDirectory(prefix="interfaces-", dir=ROOT / "build") as temporary:
        folder = Path(temporary)
        _run(
            [
                sys.executable,
                "-m",
                "pip",
                "install",
                "-q",
                "--no-deps",
                "--target",
                str(folder / "empy"),
                _EMPY,
            ]
        )
        sys.path.insert(0, str(folder / "empy"))
        # One redirection for all: empy puts itself between standard output and what it was at first.
        with LOG.open("w", encoding="utf-8") as log, contextlib.redirect_stdout(log):
            for package in packages:
                generate(package, folder / package)
        for package in packages:
            _install(compile_package(package, folder / package, compiler), site / package)
            _register(package)
            kinds = sorted({path.parent.name for path in definitions(package)})
            modules = [
                f"{package}.{package}_s__rosidl_{MODULE}",
                *(f"{package}.{kind}" for kind in kinds),
            ]
            _run([sys.executable, "-c", f"import {', '.join(modules)}"])
            _stamp(site / package).write_text(inputs(package), encoding="utf-8")


def debian_name(package: str) -> str:
    """Return the name of a package of ROS 2 Jazzy among Ubuntu's."""
    return f"ros-jazzy-{package.replace('_', '-')}"


def find_compiler() -> list[str]:
    """Return the command of the C++ compiler: CXX, or c++.

    Raises:
        UnsuitableError: if there is none, or Python's headers are missing.
    """
    command = shlex.split(os.environ.get("CXX", "")) or ["c++"]
    if shutil.which(command[0]) is None:
        raise UnsuitableError(
            f"no C++ compiler ({command[0]}); accepted: for example sudo apt install g++"
        )
    if not Path(sysconfig.get_path("include"), "Python.h").is_file():
        version = f"{sys.version_info[0]}.{sys.version_info[1]}"
        raise UnsuitableError(
            f"no headers of Python {version}; accepted: for example sudo apt install python{version}-dev"
        )
    return command


def generate(package: str, sources: Path) -> None:
    """Write the C, C++ and Python sources of a package: a folder for each library, in it one of the package's name."""
    os.environ["AMENT_PREFIX_PATH"] = sys.prefix
    from rosidl_adapter.action import convert_action_to_idl
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_adapter.srv import convert_srv_to_idl
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    convert = {
        ".action": convert_action_to_idl,
        ".msg": convert_msg_to_idl,
        ".srv": convert_srv_to_idl,
    }
    used = [str(Path(sys.prefix, "share", name)) for name in USED]
    folder, described = DEFINITIONS / package, sources / "idl" / package
    files = []
    for path in definitions(package):
        own = path.relative_to(folder)
        idl = convert[path.suffix](folder, package, own, described / own.parent)
        files.append(f"{described}:{idl.relative_to(described)}")
    hashes = HashTypeDescription("hash").generate_type_hashes(package, files, used, described)
    GenerateC("c").generate(
        package, files, used, sources / "generator_c" / package, type_description_files=hashes
    )
    cdr = ["rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"]
    for library, generator in (
        ("typesupport_fastrtps_c", GenerateFastRTPSCTypesupport("fastrtps_c")),
        ("typesupport_introspection_c", GenerateIntrospectionCTypesupport("introspection_c")),
        (MODULE, GenerateCTypesupport("c", typesupport_implementations=cdr)),
        (MODULE, GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"])),
    ):
        generator.generate(package, files, used, sources / library / package)


def compile_package(name: str, sources: Path, compiler: Sequence[str]) -> Path:
    """Compile the generated sources of a package and link them; return the folder of the Python package.

    Three libraries, as ROS names them, and the module that the Python classes load. rosidl opens the first two by
    name at run time, and finds them loaded: the module is linked with them.
    """
    folder = sources / MODULE / name
    # One translation unit of a library's C++: nine tenths of the time go into headers that each file includes.
    units = {
        library: [_one_unit(sources / library, "*.cpp"), *(sources / library).rglob("*.c")]
        for library in (*LIBRARIES, MODULE)
    }
    command = [
        *compiler,
        "-c",
        "-fPIC",
        "-O1",
        *(f"-I{path}" for path in _include_folders(sources)),
    ]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        all_units = [unit for own in units.values() for unit in own]
        list(pool.map(lambda unit: _compile(command, unit), all_units))

    # RPATH, not the newer RUNPATH: it also holds where the libraries of the wheels look for each other.
    rpath = f"-Wl,-rpath,{':'.join(['$ORIGIN', *_origin_paths()])}"
    paths = ["-Wl,--disable-new-dtags", rpath, f"-L{folder}", f"-L{sys.prefix}/lib"]
    kinds = (*LIBRARIES, "generator_py", "typesupport_c")
    wheels = [f"-l{used}__rosidl_{kind}" for used in USED for kind in kinds] + [
        f"-l{used}" for used in _RUNTIME
    ]
    linked: list[str] = []
    for library, own in units.items():
        file = (
            f"lib{name}__rosidl_{library}.so"
            if library != MODULE
            else f"{name}_s__rosidl_{MODULE}.so"
        )
        objects = [f"{unit}.o" for unit in own]
        options = [
            *paths,
            "-Wl,--no-as-needed",
            *linked,
            "-Wl,--as-needed",
            *wheels,
            f"-Wl,-soname,{file}",
        ]
        _run([*compiler, "-shared", "-s", *objects, *options, "-o", str(folder / file)])
        linked.append(f"-l:{file}")
    return folder


def _origin_paths() -> list[str]:
    """Return the folders of the wheels' libraries as a package sees them; some wheels have one of their own."""
    purelib = Path(sysconfig.get_path("purelib"))
    folders = [Path(sys.prefix, "lib"), *sorted(purelib.glob("ros_*.libs"))]
    return [f"$ORIGIN/{os.path.relpath(folder, purelib / 'package')}" for folder in folders]


def _one_unit(folder: Path, pattern: str) -> Path:
    unit = folder / "all.cc"
    found = sorted(path.relative_to(folder) for path in folder.rglob(pattern))
    unit.write_text("".join(f'#include "{path}"\n' for path in found), encoding="utf-8")
    return unit


def _include_folders(sources: Path) -> list[str | Path]:
    import numpy as np

    wheels = Path(sys.prefix, "include")
    own = [sources / library for library in (*LIBRARIES, MODULE)]
    return [
        *own,
        sysconfig.get_path("include"),
        np.get_include(),
        wheels,
        *sorted(wheels.iterdir()),
    ]


def _compile(command: list[str], unit: Path) -> None:
    language = ("-std=gnu++17",) if unit.suffix == ".cc" else ("-x", "c", "-std=gnu11")
    _run([*command, *language, str(unit), "-o", f"{unit}.o"])


def _install(package: Path, target: Path) -> None:
    """Put the Python classes and the library in place of an earlier build."""
    (package / "__init__.py").touch()
    shutil.rmtree(target, ignore_errors=True)
    for path in (*package.rglob("*.py"), *package.glob("*.so")):
        place = target / path.relative_to(package)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, place)


def _register(package: str) -> None:
    """Enter a package and its definitions in the index by which ROS's command line finds both."""
    share, own = Path(sys.prefix, "share"), definitions(package)
    names = [path.relative_to(DEFINITIONS / package).as_posix() for path in own]
    for name, path in zip(names, own, strict=True):
        place = share / package / name
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, place)
    for kind, content in (("packages", ""), ("rosidl_interfaces", "\n".join(names))):
        place = share / "ament_index" / "resource_index" / kind / package
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(content, encoding="utf-8")


def _stamp(target: Path) -> Path:
    return target / "rx90_emulator.stamp"


def _run(command: list[str]) -> None:
    """Run a step of the build.

    Raises:
        UnsuitableError: with the first line of what it says of an error, if it fails.
    """
    done = subprocess.run(
        command,
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode:
        LOG.write_text(f"{shlex.join(command)}\n{done.stdout}", encoding="utf-8")
        lines = [line.strip() for line in done.stdout.splitlines() if line.strip()]
        errors = [line for line in lines if "error" in line.lower()]
        raise UnsuitableError(f"{(errors or lines or [command[0]])[0]} (all of it in {LOG})")


def _say(text: str) -> None:
    print(f"interfaces: {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(main())
