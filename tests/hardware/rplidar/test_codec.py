"""The RPLidar's bytes: requests as Slamtec's document has them, rays there and back, and what is lost on the way."""

import math
import random

import numpy as np
import pytest

from tfg_drake.hardware.rplidar import codec
from tfg_drake.hardware.rplidar.codec import Command, Node, NodeDecoder


def test_requests_and_descriptors():
    """As in the protocol's own examples."""
    assert codec.request(Command.SCAN) == bytes.fromhex("a520")
    assert codec.request(Command.GET_INFO) == bytes.fromhex("a550")
    assert codec.motor(660) == bytes.fromhex("a5f002940 2c1".replace(" ", ""))
    assert codec.descriptor(Command.SCAN) == bytes.fromhex("a55a0500004081")
    assert codec.descriptor(Command.GET_INFO) == bytes.fromhex("a55a1400000004")
    assert codec.descriptor(Command.GET_HEALTH) == bytes.fromhex("a55a0300000006")


def test_an_answer_among_other_bytes():
    whole = b"RP LIDAR System.\r\n" + codec.descriptor(Command.GET_INFO) + bytes([0x18, 29, 1, 7]) + bytes(16)
    assert codec.answer(whole[:-1], Command.GET_INFO) is None
    told = codec.answer(whole + b"more", Command.GET_INFO)
    assert len(told) == 20
    assert codec.model(told) == 1


@pytest.fixture
def turn():
    """A revolution of 400 rays, two without an answer."""
    ranges = np.linspace(0.2, 12.0, 400)
    ranges[[7, 300]] = math.nan
    return [Node(k == 0, 2.0 * math.pi * k / 400, r) for k, r in enumerate(ranges.tolist())]


def close(a, b):
    near = math.isclose(a.angle, b.angle, abs_tol=math.radians(1.0 / 128.0) + 1e-12)
    same = (math.isnan(a.range) and math.isnan(b.range)) or abs(a.range - b.range) <= 0.000125 + 1e-12
    return a.begins == b.begins and near and same


@pytest.mark.parametrize("piece", [1, 4, 7, 5000])
def test_rays_there_and_back_in_pieces(turn, piece):
    data = b"".join(map(codec.encode, turn * 2))
    decoder, nodes = NodeDecoder(), []
    for k in range(0, len(data), piece):
        nodes += decoder.feed(data[k : k + piece])
    assert decoder.lost == 0
    # The last one is believed once the next has come.
    assert len(nodes) == 799
    assert all(close(a, b) for a, b in zip(nodes, turn * 2, strict=False))


def test_what_is_left_after_lost_bytes_was_sent(turn):
    """Of 200 revolutions with two bytes in a thousand lost nine rays in ten are believed, and of a thousand that are,
    one at most was never sent."""
    chance = random.Random(0)
    decoder, believed, wrong = NodeDecoder(), 0, 0
    for _ in range(200):
        sent = b"".join(map(codec.encode, turn))
        for node in decoder.feed(bytes(byte for byte in sent if chance.random() >= 0.002)):
            believed += 1
            row = round(node.angle / (2.0 * math.pi) * 400) % 400
            wrong += not any(close(node, turn[(row + step) % 400]) for step in (-1, 0, 1))
    assert decoder.lost > 0
    assert believed > 0.9 * 200 * 400
    assert wrong < 1e-3 * believed


def test_noise_is_no_ray():
    assert len(NodeDecoder().feed(random.Random(1).randbytes(20_000))) < 40
