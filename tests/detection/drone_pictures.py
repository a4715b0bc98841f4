"""JPEG files with real EXIF and XMP segments, as drones write them."""

from __future__ import annotations

import io

from PIL import Image

XMP_HEADER = b"http://ns.adobe.com/xap/1.0/\x00"
ATTRIBUTES = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" {namespaces} {attributes}/></rdf:RDF></x:xmpmeta>"""
ELEMENTS = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" {namespaces}>{elements}</rdf:Description></rdf:RDF></x:xmpmeta>"""
DJI = 'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"'


def attributes(namespaces, **values):
    """A packet with attributes; __ in a name stands for the colon, _ for the hyphen of drone-dji."""
    told = " ".join(f'{k.replace("__", ":").replace("_", "-")}="{v}"' for k, v in values.items())
    return ATTRIBUTES.format(namespaces=namespaces, attributes=told).encode()


def dji(heading_deg, pitch_deg, height_m, latitude_deg, longitude_deg, roll_deg=0.0):
    return attributes(
        DJI,
        drone_dji__GpsLatitude=f"{latitude_deg:.9f}",
        drone_dji__GpsLongitude=f"{longitude_deg:.9f}",
        drone_dji__AbsoluteAltitude=f"{height_m + 100:+.2f}",
        drone_dji__RelativeAltitude=f"{height_m:+.2f}",
        drone_dji__GimbalYawDegree=f"{heading_deg:+.2f}",
        drone_dji__GimbalPitchDegree=f"{pitch_deg:+.2f}",
        drone_dji__GimbalRollDegree=f"{roll_deg:+.2f}",
    )


def dms(value):
    degrees, rest = divmod(abs(value), 1.0)
    minutes, rest = divmod(rest * 60.0, 1.0)
    return degrees, minutes, rest * 60.0


def jpeg(
    image,
    xmp=None,
    *,
    make=None,
    focal_35_mm=None,
    digital_zoom=None,
    place=None,
    taken=None,
    gps=None,
    quality=92,
    orientation=None,
):
    """The bytes of an image (H, W, 3) RGB with these tags; ``place`` is latitude, longitude, altitude."""
    exif = Image.Exif()
    if make:
        exif[0x010F] = make
    if orientation:
        exif[0x0112] = orientation
    exposure = exif.get_ifd(0x8769)
    if focal_35_mm:
        exposure[0xA405] = focal_35_mm
    if digital_zoom:
        exposure[0xA404] = digital_zoom
    if taken:
        exposure[0x9003] = taken
    receiver = exif.get_ifd(0x8825)
    if place:
        latitude, longitude, altitude = place
        receiver |= {
            1: "N" if latitude >= 0 else "S",
            2: dms(latitude),
            3: "E" if longitude >= 0 else "W",
            4: dms(longitude),
            5: b"\x00" if altitude >= 0 else b"\x01",
            6: abs(altitude),
        }
    receiver |= gps or {}
    content = io.BytesIO()
    Image.fromarray(image).save(content, "jpeg", exif=exif, quality=quality)
    data = content.getvalue()
    if xmp is not None:
        segment = XMP_HEADER + xmp
        data = data[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2, "big") + segment + data[2:]
    return data
