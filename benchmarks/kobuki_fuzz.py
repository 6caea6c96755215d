"""A million garbled frames through the Kobuki's decoder: what came through, and that nothing wrong did.

python benchmarks/kobuki_fuzz.py
python benchmarks/kobuki_fuzz.py --frames 10000 --seed 3

Frames as the base sends them are changed, cut, lengthened, torn apart and strung together, and go through one decoder
in random chunks. Each payload that it lets through must stand in the stream as it is, behind the header and before
the right checksum; anything else, an exception too, ends the run with exit code 1.
"""

from __future__ import annotations

import argparse
import random
import time

from tfg_drake.hardware.kobuki import payloads as p
from tfg_drake.hardware.kobuki.codec import FEEDBACK, HEADER, Deframer, checksum, decode, encode

# Frames strung together before they go through the decoder.
_BATCH = 100


def _frame(rng: random.Random) -> bytes:
    core = p.CoreSensors(*(rng.randrange(128) for _ in range(12)))
    gyro = p.RawGyro(rng.randrange(256), tuple((rng.randrange(-999, 999), 0, 7) for _ in range(rng.choice((2, 3)))))
    return encode(core, p.DockInfrared(0, 0, 0), p.Inertia(rng.randrange(-18000, 18000), 5), gyro)


def mutated(frame: bytes, rng: random.Random) -> bytes:
    """The frame, garbled in one of six ways or left as it is."""
    at = rng.randrange(len(frame))
    match rng.randrange(7):
        case 0:
            return frame[:at] + bytes([rng.randrange(256)]) + frame[at + 1 :]
        case 1:
            return frame[:at] + bytes([frame[at] ^ 1 << rng.randrange(8)]) + frame[at + 1 :]
        case 2:
            return frame[:at]
        case 3:
            return frame[:at] + rng.randbytes(rng.randrange(1, 20)) + frame[at:]
        case 4:
            return frame[:at] + HEADER + frame[at:]
        case 5:
            return frame[:2] + bytes([rng.randrange(256)]) + frame[3:]
        case _:
            return frame


def fuzz(frames: int, seed: int) -> dict[str, int]:
    """Counts of frames sent, left whole, let through, whole ones among those, false beginnings, wrongly let through."""
    rng, deframer = random.Random(seed), Deframer()
    counts = dict.fromkeys(("frames", "whole", "accepted", "whole accepted", "false beginnings", "wrong"), 0)
    before = b""
    while counts["frames"] < frames:
        pieces = [(frame, mutated(frame, rng)) for frame in (_frame(rng) for _ in range(_BATCH))]
        stream = b"".join(piece for _, piece in pieces)
        found, at = [], 0
        while at < len(stream):
            size = rng.randrange(1, 400)
            found += deframer.feed(stream[at : at + size])
            at += size
        whole = {frame[3:-1] for frame, piece in pieces if piece == frame}
        # A frame may have begun in the batch before.
        searched = before + stream
        for payload in found:
            body = bytes([len(payload)]) + payload
            counts["wrong"] += HEADER + body + bytes([checksum(body)]) not in searched
            counts["whole accepted"] += payload in whole
            decode(payload, FEEDBACK)
        before = stream[-2 * 260 :]
        counts["frames"] += len(pieces)
        counts["whole"] += len(whole)
        counts["accepted"] += len(found)
    counts["false beginnings"] = deframer.bad
    return counts


def main() -> None:
    """Run it and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    begin = time.perf_counter()
    counts = fuzz(options.frames, options.seed)
    for name, count in counts.items():
        print(f"{name:<18}{count:>10}")
    print(f"{'seconds':<18}{time.perf_counter() - begin:>10.1f}")
    if counts["wrong"]:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
