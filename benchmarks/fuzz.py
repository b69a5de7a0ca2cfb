"""Random and damaged inputs for what reads foreign bytes: nothing may crash, hang, or keep memory.

python benchmarks/fuzz.py --target packet --inputs 1000000
"""

import argparse
import random
import resource
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterator

from ehls_ros.hardware.packet import HEADER, LARGEST, MAGIC, MOST_VALUES, VERSION, Codec, Kind, Packet

SLOWEST = 0.5
"""Time for one input above which it counts as a hang [s]."""


def sample_packet(draw: random.Random) -> Packet:
    """Return a packet that may be on the wire."""
    kind = draw.choice(list(Kind))
    count = {Kind.HELLO: 0, Kind.COMMAND: 1}.get(kind, draw.randint(1, MOST_VALUES))
    return Packet(
        kind=kind,
        session=draw.getrandbits(64) | 1,
        peer=draw.getrandbits(64),
        sequence=draw.getrandbits(draw.choice((8, 32, 64))),
        answered=draw.getrandbits(draw.choice((8, 32, 64))),
        time_ns=draw.getrandbits(63) - 2**62,
        watchdog_us=draw.randint(1, 10**6) if kind == Kind.COMMAND else 0,
        status=draw.randint(0, 2) if kind == Kind.MEASUREMENT else 0,
        values=tuple(draw.uniform(-10.0, 10.0) for _ in range(count)),
    )


def spoilt_packets(seed: int, codec: Codec) -> Iterator[bytes]:
    """Yield bytes without end: noise, noise behind a good header, and packets cut, lengthened, turned over or joined."""
    draw = random.Random(seed)  # noqa: S311
    while True:
        whole = codec.pack(sample_packet(draw))
        match draw.randrange(7):
            case 0:
                yield draw.randbytes(draw.randrange(2 * LARGEST))
            case 1:
                yield MAGIC + bytes([VERSION, draw.randrange(5)]) + draw.randbytes(draw.randrange(LARGEST))
            case 2:
                yield whole[: draw.randrange(len(whole))]
            case 3:
                yield whole + draw.randbytes(draw.randint(1, 64))
            case 4:
                spoilt = bytearray(whole)
                for _ in range(draw.randint(1, 4)):
                    spoilt[draw.randrange(len(spoilt))] ^= 1 << draw.randrange(8)
                yield bytes(spoilt)
            case 5:
                # A damaged packet whose checksum is right all the same.
                body = bytearray(whole[:-8])
                position = draw.randrange(len(body))
                body[position] = draw.randrange(256)
                if draw.random() < 0.1:
                    body[8:16] = bytes(8)
                if len(body) > HEADER.size and draw.random() < 0.5:
                    body[HEADER.size : HEADER.size + 8] = struct.pack("<d", draw.choice((float("nan"), float("inf"), 1e300)))
                yield bytes(body) + codec.tag(bytes(body))
            case _:
                yield whole


def fuzz_packet(inputs: int, seed: int) -> Counter[str]:
    """Feed the packet's parser; returns how often which outcome came."""
    codec = Codec()
    outcomes: Counter[str] = Counter()
    for _, data in zip(range(inputs), spoilt_packets(seed, codec), strict=False):
        start = time.perf_counter()
        packet = codec.parse(data)
        if time.perf_counter() - start > SLOWEST:
            outcomes["hang"] += 1
        if packet is None:
            continue
        # What is taken is whole: packed again it is the same bytes.
        outcomes["taken"] += 1
        outcomes["changed"] += codec.pack(packet) != data
    return outcomes + Counter({f"refused_{reason}": count for reason, count in codec.refused.items()})


TARGETS: dict[str, Callable[[int, int], Counter[str]]] = {"packet": fuzz_packet}


def main() -> None:
    """Run and print the outcomes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--target", choices=TARGETS, default="packet")
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    fuzz = TARGETS[options.target]
    fuzz(min(options.inputs, 10_000), options.seed)
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
    outcomes = fuzz(options.inputs, options.seed)
    took = time.perf_counter() - start
    growth = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    for outcome, count in sorted(outcomes.items()):
        print(f"{outcome:24}{count:12d}")
    print(f"{options.inputs} inputs in {took:.1f} s, largest memory grew by {growth} KiB")


if __name__ == "__main__":
    main()
