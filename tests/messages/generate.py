"""Python packages of messages that no wheel has, made from the .msg files in this folder with ROS's own generators.

A process that runs already can import them: their libraries need no LD_LIBRARY_PATH, which is read at the start only.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from functools import cache
from importlib import metadata, util
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

MESSAGES = Path(__file__).resolve().parent
CACHE = MESSAGES.parents[1] / ".cache" / "messages"

_COMPILERS = {".c": "gcc", ".cpp": "g++"}
_GENERATORS = ("rosidl_adapter", "rosidl_generator_py", "rosidl_typesupport_fastrtps_c")
_STRUCTURES, _TYPE_SUPPORT = "rosidl_generator_c", "rosidl_typesupport_c"
_SERIALIZATION, _INTROSPECTION = "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"
_PARTS = (_STRUCTURES, "rosidl_generator_py", _TYPE_SUPPORT, _SERIALIZATION, _INTROSPECTION)
_RUNTIME = (
    *(_TYPE_SUPPORT, _SERIALIZATION, _INTROSPECTION, "rosidl_typesupport_fastrtps_cpp"),
    *("rosidl_runtime_c", "rosidl_dynamic_typesupport", "rmw", "rcutils", "fastcdr"),
)
_ABI = re.compile(r"(ros-(?!jazzy-).*|numpy|empy)")


class MessagesError(Exception):
    """A package of messages cannot be made here."""


def obstacle(package: str) -> str:
    """Return what keeps this process from importing a package of messages; empty if nothing does."""
    if util.find_spec(package):
        return ""
    if not all(map(util.find_spec, ("rclpy", *_GENERATORS))):
        return "ROS 2 is not installed"
    return _missing_tools()


def make_importable(package: str) -> None:
    """Let this process import a package of messages."""
    if not util.find_spec(package):
        sys.path.append(str(build(package)))


def environment(package: str, base: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return an environment in which another Python process can import a package of messages.

    Parameters
    ----------
    base : its other variables
    """
    found = util.find_spec(package)
    folder = Path(found.origin).parents[1] if found and found.origin else build(package)
    return {**base, "PYTHONPATH": os.pathsep.join(filter(None, [base.get("PYTHONPATH"), str(folder)]))}


@cache
def build(package: str) -> Path:
    """Return a folder for ``sys.path`` that holds a package of messages; make it if it is not there.

    Several processes may do so at once: each makes a folder of its own, and the first to finish names it.

    Raises
    ------
    MessagesError
        If there is no such package or no compiler, or if the compiler fails.
    """
    sources = sorted((MESSAGES / package / "msg").glob("*.msg"))
    if not sources:
        raise MessagesError(f"{package}: no .msg file in {MESSAGES / package / 'msg'}")
    made = CACHE / f"{package}-{_fingerprint(sources)}"
    if made.is_dir():
        return made
    if missing := _missing_tools():
        raise MessagesError(f"{package}: {missing}")
    CACHE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f"{package}-", dir=CACHE) as work:
        code, complete = Path(work, "code"), Path(work, "complete")
        _generate(package, sources, code, complete / package)
        _compile(package, code, complete / package)
        try:
            complete.rename(made)
        except OSError:
            if not made.is_dir():  # it is there when another process was faster
                raise
    return made


def _missing_tools() -> str:
    if missing := [name for name in _COMPILERS.values() if shutil.which(name) is None]:
        return f"{' and '.join(missing)} not found; on Debian and Ubuntu: apt install g++"
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        return f"Python.h not found; on Debian and Ubuntu: apt install python{sysconfig.get_python_version()}-dev"
    return ""


def _prefix() -> Path:
    """Return the folder that ROS is installed in."""
    import rclpy

    return Path(rclpy.__file__).parents[4]  # of lib/python3.*/site-packages/rclpy/__init__.py


def _fingerprint(sources: Sequence[Path]) -> str:
    """Return a hash of everything that decides what `build` makes."""
    versions = {
        f"{name}={each.version}"
        for each in metadata.distributions()
        if _ABI.fullmatch(name := (each.metadata["Name"] or "").lower().replace("_", "-"))
    }
    parts = [str(_prefix()), sysconfig.get_config_var("SOABI"), Path(__file__).read_text(), *sorted(versions)]
    parts += [part for source in sources for part in (source.name, source.read_text())]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _generate(package: str, sources: Sequence[Path], code: Path, python: Path) -> None:
    """Run the generators. That of Python writes to a folder of its own, each other one to ``code`` under its name."""
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_generator_c import generate_c
    from rosidl_generator_py import generate_py
    from rosidl_generator_type_description import generate_type_hash
    from rosidl_typesupport_c import generate_c as generate_type_support
    from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
    from rosidl_typesupport_introspection_c import generate_c as generate_introspection

    share = _prefix() / "share"
    names = [f"msg/{source.stem}" for source in sources]

    def told(generator: str, output: Path | None = None, **more: list[str]) -> str:
        """Return the file of arguments that CMake would write for a generator."""
        arguments = {
            "package_name": package,
            "output_dir": str(output or code / generator / package),
            "template_dir": str(share / generator / "resource"),
            "idl_tuples": [f"{code}:{name}.idl" for name in names],
            "target_dependencies": [],
            **more,
        }
        path = code / f"{generator}.json"
        path.write_text(json.dumps(arguments))
        return str(path)

    with redirect_stdout(StringIO()):
        for source in sources:
            folder = source.parents[1]
            convert_msg_to_idl(folder, package, source.relative_to(folder), code / "msg")
        installed = [f"{path.parent.name}:{path.parent}" for path in share.glob("*/msg")]
        generate_type_hash(told("rosidl_generator_type_description", code, include_paths=installed))
        described = [f"{name}.idl:{code / name}.json" for name in names]
        interfaces = [str(source) for source in sources]
        generate_c(told(_STRUCTURES, ros_interface_files=interfaces, type_description_tuples=described))
        generate_typesupport_fastrtps_c(told(_SERIALIZATION))
        generate_introspection(told(_INTROSPECTION))
        generate_type_support(told(_TYPE_SUPPORT), [_SERIALIZATION, _INTROSPECTION])
        generate_py(told("rosidl_generator_py", python), [_TYPE_SUPPORT])
    for generator in (_STRUCTURES, _SERIALIZATION, _INTROSPECTION):
        header = f"{generator}__visibility_control.h"
        text = (share / generator / "resource" / f"{header}.in").read_text()
        text = text.replace("@PROJECT_NAME_UPPER@", package.upper()).replace("@PROJECT_NAME@", package)
        (code / generator / package / "msg" / header).write_text(text)
    (python / "__init__.py").touch()


def _compile(package: str, code: Path, python: Path) -> None:
    """Compile the package's extension module and the two libraries that ROS's type support opens by name.

    They lie beside the module, which names them. So they are loaded when ROS asks for them, and it need not find them.
    """
    import numpy as np

    include, libraries = _prefix() / "include", _prefix() / "lib"
    headers = [include, *include.glob("*/"), *code.glob("rosidl_*/")]  # fastcdr has no folder of its own
    headers += [Path(sysconfig.get_path("include")), Path(np.get_include())]
    flags = ["-c", "-fPIC", "-O1", "-w", *(f"-I{path}" for path in headers)]
    others = [f"{other}__{part}" for other in sorted(_packages_in(code / "msg") - {package}) for part in _PARTS]
    paths = [f"-L{python}", f"-L{libraries}", f"-Wl,-rpath,$ORIGIN:{libraries}", "-Wl,--allow-shlib-undefined"]
    made = {part: f"{package}__{part}" for part in (_SERIALIZATION, _INTROSPECTION)}

    def compiled(unit: Path) -> str:
        _run([_COMPILERS[unit.suffix], *flags, str(unit), "-o", f"{unit}.o"])
        return f"{unit}.o"

    def linked(name: str, folders: Sequence[Path], *needed: str) -> None:
        units = [unit for folder in folders for unit in folder.rglob("*.c*") if unit.suffix in _COMPILERS]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            objects = list(pool.map(compiled, units))
        library = ["g++", "-shared", "-Wl,--no-as-needed", f"-Wl,-soname,{name}", "-o", str(python / name)]
        _run([*library, *objects, *paths, *(f"-l{each}" for each in (*needed, *others, *_RUNTIME))])

    linked(f"lib{made[_SERIALIZATION]}.so", [code / _STRUCTURES, code / _SERIALIZATION])
    linked(f"lib{made[_INTROSPECTION]}.so", [code / _INTROSPECTION], made[_SERIALIZATION])
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    linked(f"{package}_s__{_TYPE_SUPPORT}{suffix}", [code / _TYPE_SUPPORT, python], *made.values())
    for leftover in python.rglob("*.o"):
        leftover.unlink()


def _packages_in(folder: Path) -> set[str]:
    """Return the packages of the messages that those of a folder contain, at any depth."""
    documents = [json.loads(path.read_text())["type_description_msg"] for path in folder.glob("*.json")]
    types = [each["type_name"] for document in documents for each in document["referenced_type_descriptions"]]
    return {name.partition("/")[0] for name in types}


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise MessagesError(f"{' '.join(command[:1] + command[-3:])}: {done.stderr.strip()[-2000:]}")
