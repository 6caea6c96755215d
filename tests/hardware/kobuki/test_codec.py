"""The protocol, by the vendor's bytes, by round trips and by garbage."""

import dataclasses
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.hardware.kobuki import codec as p
from tfg_drake.hardware.kobuki.codec import COMMANDS, FEEDBACK, Deframer, checksum, decode, encode

# Frames of the vendor's driver, kobuki_core 1.4.0.
GOLDEN = {
    "aa55060104c8000000cb": p.BaseControl(200, 0),
    "aa5506010438ff0000c4": p.BaseControl(-200, 0),
    "aa550601045c0001005e": p.BaseControl(92, 1),
    "aa55060104a4ff010059": p.BaseControl(-92, 1),
    "aa550601040101900192": p.BaseControl(257, 400),
    "aa55060104fd005aff5b": p.BaseControl(253, -166),
    "aa550601047affb3fecb": p.BaseControl(-134, -333),
    "aa55060104fffe900193": p.BaseControl(-257, 400),
    "aa550601047300010071": p.BaseControl(115, 1),
    "aa550601041801190003": p.BaseControl(280, 25),
    "aa55060104be02ff7f3f": p.BaseControl(702, 32767),
    "aa55060104be0200803f": p.BaseControl(702, -32768),
    "aa550409020b0004": p.RequestExtra(0x0B),
    "aa550601040000000003": p.BaseControl(0, 0),
}


def integers(bits, signed=False):
    low = -(2 ** (bits - 1)) if signed else 0
    return st.integers(low, low + 2**bits - 1)


U8, I8, U16, I16, U32 = integers(8), integers(8, True), integers(16), integers(16, True), integers(32)
COMMAND = st.one_of(
    st.builds(p.BaseControl, I16, I16),
    st.builds(p.SoundSequence, U8),
    st.builds(p.RequestExtra, U16),
    st.builds(p.GeneralOutput, U16),
)
CORE = st.builds(p.CoreSensors, U16, U8, U8, U8, U16, U16, I8, I8, U8, U8, U8, U8)
FROM_BASE = st.one_of(
    CORE,
    st.builds(p.Inertia, I16, I16),
    st.builds(p.HardwareVersion, U8, U8, U8),
    st.builds(p.FirmwareVersion, U8, U8, U8),
    st.builds(p.UniqueId, U32, U32, U32),
)


@pytest.mark.parametrize(("frame", "part"), [(bytes.fromhex(text), part) for text, part in GOLDEN.items()])
def test_golden_bytes_both_ways(frame, part):
    assert encode(part) == frame
    assert [decode(payload, COMMANDS) for payload in Deframer().feed(frame)] == [(part,)]


@pytest.mark.parametrize(
    ("kinds", "lengths"),
    [
        (COMMANDS, {1: 4, 4: 1, 9: 2, 12: 2}),
        (FEEDBACK, {1: 15, 4: 7, 10: 4, 11: 4, 19: 12}),
    ],
)
def test_ids_and_lengths_are_the_vendors(kinds, lengths):
    found = {}
    for number, kind in kinds.items():
        fields = [0] * len(dataclasses.fields(kind))
        frame = encode(kind(*fields))
        assert frame[3] == number
        found[number] = frame[4]
    assert found == lengths


def test_the_core_sensors_byte_by_byte():
    data = bytes.fromhex("010f 3412 05 02 01 feff 0100 ff 02 04 12 a5 01")
    assert decode(data, FEEDBACK) == (p.CoreSensors(0x1234, 5, 2, 1, 65534, 1, -1, 2, 4, 18, 165, 1),)


@given(st.lists(COMMAND, min_size=1, max_size=12))
def test_commands_round_trip(parts):
    (payload,) = Deframer().feed(encode(*parts))
    assert decode(payload, COMMANDS) == tuple(parts)


@given(st.lists(FROM_BASE, min_size=1, max_size=10))
def test_feedback_round_trips(parts):
    (payload,) = Deframer().feed(encode(*parts))
    assert decode(payload, FEEDBACK) == tuple(parts)


@pytest.mark.parametrize("part", [p.BaseControl(32768, 0), p.SoundSequence(-1), p.Inertia(40000, 0)])
def test_what_does_not_fit_is_refused(part):
    with pytest.raises(ValueError, match=type(part).__name__):
        encode(part)


def test_a_payload_has_its_bounds():
    with pytest.raises(ValueError, match="a payload of 0 bytes; a frame carries 3 to 255"):
        encode()
    with pytest.raises(ValueError, match="a payload of 280 bytes"):
        encode(*[p.UniqueId(0, 0, 0)] * 20)


def test_old_firmware_says_its_version_in_two_bytes():
    for number, version in ((123, (0, 0, 1)), (10100, (0, 1, 1)), (111, (1, 1, 1))):
        assert decode(bytes([11, 2]) + number.to_bytes(2, "little"), FEEDBACK) == (p.FirmwareVersion(*version),)
    assert decode(bytes([10, 2, 104, 0]), FEEDBACK) == (p.HardwareVersion(4, 0, 1),)
    assert decode(bytes([11, 2, 7, 0]), FEEDBACK) == ()


def test_unknown_and_misshapen_parts_are_skipped():
    inertia = bytes([4, 7, 1, 0, 2, 0, 0, 0, 0])
    for odd in (b"\x63\x03abc", b"\x04\x03abc", b"\x63\x00", b"\x0d\x04\x00\x02ab", b"\x0d\x01\x00"):
        assert decode(odd + inertia, FEEDBACK) == (p.Inertia(1, 2),)
    assert decode(inertia + b"\x04\x07\x01", FEEDBACK) == (p.Inertia(1, 2),)
    assert decode(inertia + b"\x04", FEEDBACK) == (p.Inertia(1, 2),)


def stream(rng, count=50):
    """Frames as the base sends them, and garbage between some."""
    frames, data = [], b""
    for _ in range(count):
        core = p.CoreSensors(*(rng.randrange(100) for _ in range(12)))
        frames.append((core, p.Inertia(rng.randrange(-18000, 18000), rng.randrange(-9000, 9000))))
        data += encode(*frames[-1]) + rng.choice([b"", b"", b"\xaa", b"\xaa\x55", b"\xaa\x55\x00", rng.randbytes(9)])
    return frames, data


@pytest.mark.parametrize("seed", range(20))
def test_any_chunks_give_the_same_frames(seed):
    rng = random.Random(seed)
    frames, data = stream(rng)
    whole = Deframer().feed(data + bytes(260))
    chunked, deframer, at = [], Deframer(), 0
    while at < len(data):
        size = 1 if seed % 2 else rng.randrange(1, 200)
        chunked += deframer.feed(data[at : at + size])
        at += size
    assert chunked + deframer.feed(bytes(260)) == whole
    decoded = [decode(payload, FEEDBACK) for payload in whole]
    assert [parts for parts in decoded if parts in frames] == frames


def test_a_frame_behind_a_false_length_is_found():
    frame = encode(p.RequestExtra(0x0201))
    deframer = Deframer()
    assert deframer.feed(b"\xaa\x55\xff" + frame * 3) == []
    assert len(deframer.feed(b"\x11" * 250)) == 3
    assert deframer.bad == 1


def test_garbled_frames_are_not_accepted():
    rng = random.Random(1)
    for _ in range(10_000):
        frame = bytearray(encode(p.RequestExtra(rng.randrange(65536)), p.UniqueId(1, 2, 3)))
        for _ in range(rng.randrange(1, 4)):
            frame[rng.randrange(len(frame))] = rng.randrange(256)
        for payload in Deframer().feed(bytes(frame) + bytes(260)):
            body = bytes([len(payload)]) + payload
            assert b"\xaa\x55" + body + bytes([checksum(body)]) in bytes(frame) + bytes(260)
            decode(payload, FEEDBACK)
