"""Loads rclpy, and makes classes for message types that are not installed.

TF and detections are ``tf2_msgs`` and ``vision_msgs``. An installed ROS 2 has the first and often the second;
PyPI has neither. rclpy gets messages as finished CDR, so a type needs no code of its own, only its name and
hash. If its package is missing, the type support of another message is borrowed under that name.
"""

from __future__ import annotations

import ctypes
import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from skysweep.errors import MissingExtraError, UserError
from skysweep.ros.interfaces import type_hash

# The default buffers of Fast DDS are smaller than a picture and lose most of them; these hold several.
_FAST_DDS_TRANSPORTS = "DEFAULT?max_msg_size=65500B&sockets_size=4MB"
_FAST_DDS_LOCALHOST = Path(__file__).with_name("fastdds_localhost.xml")
_FAST_DDS_PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")  # before 3.0, since
_MIDDLEWARES = ("rmw_fastrtps_cpp", "rmw_cyclonedds_cpp", "rmw_zenoh_cpp", "rmw_connextdds")
_DONOR = "geometry_msgs/msg/PolygonStamped"  # unbounded, like every type that borrows from it


@cache
def load_rclpy() -> Any:
    """The module rclpy. Raises UserError if it or a middleware is not installed."""
    wanted = os.environ.get("RMW_IMPLEMENTATION")
    try:
        importlib.import_module("rpyutils")
    except ModuleNotFoundError:
        raise MissingExtraError("ROS 2", "ros") from None
    middleware = next((n for n in ([wanted] if wanted else _MIDDLEWARES) if _loads(f"lib{n}.so")), None)
    if middleware is None:
        if not _loads("librcutils.so"):
            raise UserError("ROS 2: its libraries are not on LD_LIBRARY_PATH; source its setup.bash")
        remedy = "ROS 2: no middleware is installed;"
        if wanted:
            remedy = f"RMW_IMPLEMENTATION={wanted}: this middleware is not installed; unset the variable, or"
        raise UserError(
            f"{remedy} install one:  pip install ros-rmw-fastrtps-cpp  (or ros-<distribution>-rmw-...)"
        )
    if middleware == "rmw_fastrtps_cpp":
        _make_room_for_pictures()
    try:
        return importlib.import_module("rclpy")
    except ImportError as error:
        reason = str(error).splitlines()[0]
        raise UserError(
            f"ROS 2 is installed but does not load ({reason}); use the Python that this ROS 2 was made for"
        ) from None


@cache
def message_class(type_name: str) -> Any:
    """The class that rclpy needs for a topic of serialised messages."""
    package, _, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):  # or a folder of that name: a workspace's sources
        return _borrowed_class(package, name, type_hash(type_name))


@contextmanager
def quiet_borrowing() -> Iterator[None]:
    """Wraps the creation of a publisher or subscription.

    A borrowed type has no description of its fields. Fast DDS works without one, but leaves an error behind
    that it would print at the next call.
    """
    yield
    ctypes.CDLL("librcutils.so").rcutils_reset_error()


def _make_room_for_pictures() -> None:
    """Larger buffers in Fast DDS, unless the user has set its transports.

    For ``LOCALHOST`` rmw_fastrtps always adds its own transports, with small buffers. So rmw_fastrtps is not
    told, and Fast DDS gets the same setting in a profile.
    """
    if any(name in os.environ for name in ("FASTDDS_BUILTIN_TRANSPORTS", *_FAST_DDS_PROFILES)):
        return
    if os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST":
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
        os.environ[_FAST_DDS_PROFILES[_loads("libfastdds.so")]] = str(_FAST_DDS_LOCALHOST)
    else:
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = _FAST_DDS_TRANSPORTS


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


# ---- borrowing: rosidl's and Fast DDS' C structures, as of ROS 2 Iron and later ---------------------------

_FAST_DDS = b"rosidl_typesupport_fastrtps_c"
_Dispatch = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
_Hash = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)


class _TypeSupport(ctypes.Structure):
    """``rosidl_message_type_support_t``."""

    _fields_ = (
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("dispatch", ctypes.c_void_p),
        ("hash", ctypes.c_void_p),
        ("description", ctypes.c_void_p),
        ("sources", ctypes.c_void_p),
    )


class _Callbacks(ctypes.Structure):
    """``message_type_support_callbacks_t``: the name, and functions that serialised messages do not use."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("functions", ctypes.c_void_p * 5),
    )


_ALIVE: list[Any] = []  # referenced by C code


def _borrowed_class(package: str, name: str, rihs: str) -> Any:
    if load_rclpy().get_rmw_implementation_identifier() != "rmw_fastrtps_cpp":
        raise UserError(
            f"{package}: is not installed; install ros-<distribution>-{package.replace('_', '-')}, "
            "or use RMW_IMPLEMENTATION=rmw_fastrtps_cpp"
        )
    donor = type(message_class(_DONOR))
    donor.__import_type_support__()
    get_pointer = ctypes.pythonapi.PyCapsule_GetPointer
    get_pointer.restype, get_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    address = get_pointer(donor._TYPE_SUPPORT, None)
    dispatch = _Dispatch(_TypeSupport.from_address(address).dispatch)
    lender = _TypeSupport.from_address(dispatch(address, _FAST_DDS))

    callbacks = _Callbacks.from_buffer_copy(_Callbacks.from_address(lender.data))
    callbacks.namespace, callbacks.name = f"{package}::msg".encode(), name.encode()
    digest = bytes.fromhex(rihs.removeprefix("RIHS01_"))
    hash_value = (ctypes.c_uint8 * 33)(1, *digest)
    get_hash = _Hash(lambda _support: ctypes.addressof(hash_value))
    support = _TypeSupport(
        _FAST_DDS,
        ctypes.addressof(callbacks),
        lender.dispatch,
        ctypes.cast(get_hash, ctypes.c_void_p).value,
        lender.description,
        lender.sources,
    )
    _ALIVE.extend((callbacks, hash_value, get_hash, support))
    new_capsule = ctypes.pythonapi.PyCapsule_New
    new_capsule.restype = ctypes.py_object
    new_capsule.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    made = {"_TYPE_SUPPORT": new_capsule(ctypes.addressof(support), None, None)}
    kind = type(
        f"Metaclass_{name}", (donor,), made | {"__import_type_support__": classmethod(lambda _: None)}
    )
    return kind(name, (), {"__slots__": ()})
