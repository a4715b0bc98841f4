"""Frames out of bytes: in pieces, and behind what only looks like one."""

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as m

from skysweep.vehicles.mavlink.signing import Signing
from skysweep.vehicles.mavlink.wire import Frames, Voice

KEY = bytes(range(32))
NOISE = st.one_of(
    st.binary(max_size=12),
    st.sampled_from([b"\xfd\xff", b"\xfd\xff\x00", b"\xfd\xff\x01", b"\xfe\xff", b"\xfd\x09\x00\x00"]),
)
ENOUGH = b"\x00" * 300  # no frame is longer: what was begun is decided


def frames(count: int) -> list[bytes]:
    signed, unsigned = Voice(190, Signing(KEY)), Voice(190, Signing(None))
    message = m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    return [(signed if n % 2 else unsigned).pack(message) for n in range(count)]


@given(st.lists(NOISE, min_size=6, max_size=6), st.lists(st.integers(1, 60), min_size=1, max_size=40))
def test_no_noise_hides_a_frame_however_the_bytes_are_cut(noise, cuts):
    sent = frames(6)
    data = b"".join(n + f for n, f in zip(noise, sent, strict=True)) + ENOUGH
    reader, heard = Frames(), []
    for cut in cuts:
        heard += [frame for _, frame in reader.read(data[:cut])]
        data = data[cut:]
    heard += [frame for _, frame in reader.read(data)]
    assert [frame for frame in heard if frame in sent] == sent


def test_a_frame_is_there_as_soon_as_it_is_whole():
    reader, (first, second) = Frames(), frames(2)
    assert [f for _, f in reader.read(first + second[:7])] == [first]
    assert [f for _, f in reader.read(second[7:])] == [second]


def test_a_datagram_ends_where_it_ends():
    (frame,) = frames(1)
    assert [f for _, f in Frames().read(b"\xfd\xff\x00" + frame, is_last=True)] == [frame]
