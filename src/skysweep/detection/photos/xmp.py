"""The XMP packet of a picture: ISO 16684-1, an RDF document inside the file."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml import ElementTree as SafeTree

_HEADER = b"http://ns.adobe.com/xap/1.0/\x00"  # before the packet in a JPEG's APP1 segment
_START, _END = b"<x:xmpmeta", b"</x:xmpmeta>"
_MAX_BYTES = 1_000_000
_CAMERA = "Camera:"  # in front of names in Pix4D's and senseFly's namespace, where pitch counts otherwise


def packet_of(segment: bytes) -> bytes | None:
    """The packet in a JPEG's APP1 segment, if that is what it holds."""
    return segment[len(_HEADER) :] if segment.startswith(_HEADER) else None


def properties(packet: bytes) -> Mapping[str, str]:
    """The simple properties of a packet by local name, written as attributes or as elements.

    Names in the Camera namespace begin with ``Camera:``. A structure's fields have its name and a dot before
    theirs. A packet that is no sound XML has none.
    """
    start, end = packet.find(_START), packet.find(_END)
    if not 0 <= start < end or end - start > _MAX_BYTES:
        return {}
    try:
        root = SafeTree.fromstring(packet[start : end + len(_END)])
    except (ParseError, DefusedXmlException, ValueError, LookupError):
        return {}
    found: dict[str, str] = {}
    for description in root.iter():
        if description.tag.endswith("}Description"):
            _collect(description, "", found)
    return found


def _collect(node: Element, before: str, found: dict[str, str]) -> None:
    for name, value in node.attrib.items():
        found.setdefault(before + _local(name), value.strip())
    for child in node:
        if child.tag.endswith("}Description"):
            _collect(child, before, found)
        elif len(child) or not (child.text or "").strip():
            _collect(child, f"{before}{_local(child.tag)}.", found)
        else:
            found.setdefault(before + _local(child.tag), (child.text or "").strip())


def _local(name: str) -> str:
    uri, brace, local = name.rpartition("}")
    return f"{_CAMERA}{local}" if brace and "camera/" in uri.lower() else local
