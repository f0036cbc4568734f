"""Classes of messages and services, imported by their ROS names."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import re
from functools import cache
from pathlib import Path
from typing import Any

from rclpy.exceptions import NoTypeSupportImportedException
from rclpy.type_support import check_for_type_support
from rosidl_generator_py.import_type_support_impl import UnsupportedTypeSupport  # type: ignore[import-untyped]

MOST_BYTES = 16_000_000  # in one endpoint
# Discovery tells no depth, nobody knows rate and size of a topic before its first reader, and another depth needs
# another endpoint. So these are upper bounds: a second of the fastest topic, and the sizes of types that can be large,
# a raw image of 320 × 240 or a cloud of 16 beams, and of all others.
_MOST_HELD, _BULK_BYTES, _PLAIN_BYTES = 1000, 250_000, 16_000
_OCTETS = frozenset({"sequence<uint8>", "sequence<int8>", "sequence<octet>"})
# Of rosidl_message_type_support_t of ROS 2 Jazzy, behind three pointers: get_type_hash_func.
_GET_HASH, _GET_HASH_AT = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p), 3 * ctypes.sizeof(ctypes.c_void_p)
_NAME = re.compile(r"([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Za-z][A-Za-z0-9_]*)")
_ACTION_MESSAGES = {"_FeedbackMessage": "FeedbackMessage"}  # ending of the ROS name → its name in the action's `Impl`
_ACTION_SERVICES = {"_SendGoal": "SendGoalService", "_GetResult": "GetResultService"}
_HASH = 15  # characters that tell two hashes apart


class UnknownTypeError(Exception):
    """A type that is not installed on this host, or differs here, or whose libraries cannot be loaded."""


@cache
def message_class(type_name: str) -> Any:
    """Import a message class: ``sensor_msgs/msg/LaserScan`` or ``nav2_msgs/action/Spin_FeedbackMessage``.

    Raises UnknownTypeError if its package is not installed, has no such message, or lacks its libraries.
    """
    return _import(type_name, folder="msg", of_actions=_ACTION_MESSAGES)


@cache
def service_class(type_name: str) -> Any:
    """Import a service class: ``std_srvs/srv/Trigger`` or ``nav2_msgs/action/Spin_SendGoal``; errors as above."""
    return _import(type_name, folder="srv", of_actions=_ACTION_SERVICES)


@cache
def definition_hash(kind: Any) -> str:
    """Return the hash of the definition of a message class that is loaded (REP 2016), as "RIHS01_..."."""
    pointer_of = ctypes.pythonapi.PyCapsule_GetPointer
    pointer_of.restype, pointer_of.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    support = pointer_of(type(kind)._TYPE_SUPPORT, None)  # noqa: SLF001 - where rclpy finds it, too
    version, *digits = ctypes.string_at(_GET_HASH.from_address(support + _GET_HASH_AT)(support), 33)
    return f"RIHS{version:02}_{bytes(digits).hex()}"


def require_same(kind: Any, type_name: str, type_hash: str) -> None:
    """Raise UnknownTypeError where a message class has another definition than the one with this hash; empty = any."""
    if type_hash and (here := definition_hash(kind)) != type_hash:
        raise UnknownTypeError(
            f"{type_name} has another definition here ({here[:_HASH]}...) than there ({type_hash[:_HASH]}...); build "
            "its package from one source on both ends, and restart them"
        )


def is_bulk(kind: Any) -> bool:
    """Return whether samples of a message class can be large: octets are images, clouds and maps."""
    return not _OCTETS.isdisjoint(kind.get_fields_and_field_types().values())


def held_depth(kind: Any, *, asked: int) -> int:
    """Return the depth that holds a second of a topic, so that a busy host loses nothing that has arrived there.

    Parameters
    ----------
    kind : message class, whose size bounds the memory
    asked : depth that the configuration asks for, held in any case (samples)
    """
    return max(asked, min(_MOST_HELD, MOST_BYTES // (_BULK_BYTES if is_bulk(kind) else _PLAIN_BYTES)))


def _import(type_name: str, *, folder: str, of_actions: dict[str, str]) -> Any:
    """Import a class from a folder of its package, or from an action, and load its libraries."""
    match = _NAME.fullmatch(type_name)
    if match is None:
        raise UnknownTypeError(f"{type_name!r} is no type of ROS 2")
    package, kind, name = match.groups()
    ending = f"_{name.rpartition('_')[2]}"
    if not _is_generated(package, kind):
        raise UnknownTypeError(f"{type_name} is not installed here ({package} has no {kind} of ROS)")
    if kind not in {folder, "action"} or (kind == "action" and ending not in of_actions):
        raise UnknownTypeError(f"{type_name} is no {folder}")
    try:
        module = importlib.import_module(f"{package}.{kind}")
        if kind == folder:
            found = getattr(module, name)
        else:
            found = getattr(getattr(module, name.removesuffix(ending)).Impl, of_actions[ending])
    except (ImportError, AttributeError) as error:
        raise UnknownTypeError(f"{type_name} is not installed here ({error})") from error
    try:
        check_for_type_support(found)  # rclpy otherwise loads them at the first endpoint
    except (UnsupportedTypeSupport, NoTypeSupportImportedException) as error:
        raise UnknownTypeError(
            f"the libraries of {type_name} cannot be loaded; source the setup.bash of their workspace"
        ) from error
    return found


def _is_generated(package: str, folder: str) -> bool:
    """Return whether rosidl made this folder of a package, without importing either.

    The other end names the package, and importing one runs it. Of rosidl's packages it runs nothing but definitions.
    """
    spec = importlib.util.find_spec(package)
    for place in (spec.submodule_search_locations or ()) if spec is not None else ():
        made = Path(place, folder, "__init__.py")
        if made.is_file() and f"from {package}.{folder}._" in made.read_text(encoding="utf-8", errors="replace"):
            return True
    return False
