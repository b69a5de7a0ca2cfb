"""The UDP packet: bytes as documented, and a parser that refuses everything else."""

import hashlib
import importlib.util
import struct
import zlib
from pathlib import Path

import pytest

from ehls_ros.hardware.packet import MAX_SIZE, MAX_VALUES, REASONS, Codec, Kind, Packet, Status

MEASUREMENT = Packet(Kind.MEASUREMENT, 7, 9, 41, 40, -5, 0, Status.WATCHDOG, (1.5, -2.25, 0.0))
COMMAND = Packet(Kind.COMMAND, 9, 7, 12, 41, 123, 10_000, 0, (-4.75,))
HELLO = Packet(Kind.HELLO, 9, 0, 1, 0, 5)
KEY = b"a secret of both"


def documented(values=(1.5, -2.25, 0.0), **changed):
    """Return a measurement's bytes, built from the documented table without the codec; CRC by zlib."""
    fields = {
        "magic": b"EHLS",
        "version": 1,
        "kind": 2,
        "count": len(values),
        "session": 7,
        "peer": 9,
        "sequence": 41,
        "answered": 40,
        "time_ns": -5,
        "watchdog_us": 0,
        "status": 2,
    }
    formats = dict(zip(fields, ("4s", "B", "B", "H", "Q", "Q", "Q", "Q", "q", "I", "I"), strict=True))
    fields.update(changed)
    body = b"".join(struct.pack("<" + formats[name], value) for name, value in fields.items())
    body += struct.pack(f"<{len(values)}d", *values)
    return body + struct.pack("<Q", zlib.crc32(body))


def test_bytes_are_those_documented():
    assert Codec().pack(MEASUREMENT) == documented()
    assert Codec().parse(documented()) == MEASUREMENT
    keyed = Codec(KEY).pack(MEASUREMENT)
    assert keyed[:-8] == documented()[:-8]
    assert keyed[-8:] == hashlib.blake2b(keyed[:-8], digest_size=8, key=KEY).digest()


@pytest.mark.parametrize("key", [b"", KEY])
@pytest.mark.parametrize(
    "packet", [MEASUREMENT, COMMAND, HELLO, MEASUREMENT._replace(values=tuple(map(float, range(MAX_VALUES))))]
)
def test_round_trip(packet, key):
    codec = Codec(key)
    data = codec.pack(packet)
    assert len(data) == 64 + 8 * len(packet.values) <= MAX_SIZE
    assert Codec(key).parse(data) == packet
    assert not any(codec.refused.values())


nan, inf = float("nan"), float("inf")
DAMAGED = {
    "empty": (b"", "length"),
    "cut in the header": (documented()[:50], "length"),
    "over-long": (documented() + bytes(MAX_SIZE), "length"),
    "a byte too many": (documented() + b"\0", "count"),
    "a value missing": (documented()[:-16] + documented()[-8:], "count"),
    "other magic": (documented(magic=b"EHLT"), "magic"),
    "later version": (documented(version=2), "version"),
    "unknown kind": (documented(kind=4), "kind"),
    "count beyond the bytes": (documented(count=4), "count"),
    "hello with values": (documented(kind=1), "count"),
    "command with three values": (documented(kind=3), "count"),
    "measurement without values": (documented(values=()), "count"),
    "wrong checksum": (documented()[:-1] + b"\1", "tag"),
    "checksum of a key": (Codec(KEY).pack(MEASUREMENT), "tag"),
    "nan": (documented(values=(1.0, nan)), "value"),
    "inf": (documented(values=(-inf,)), "value"),
    "no session": (documented(session=0), "session"),
    "unknown status": (documented(status=3), "field"),
    "measurement with a watchdog": (documented(watchdog_us=1), "field"),
    "command without a watchdog": (documented(kind=3, values=(1.0,), status=0), "field"),
    "command with a watchdog of an hour": (documented(kind=3, values=(1.0,), status=0, watchdog_us=3_600_000_000), "field"),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_damage_is_refused_and_counted(case):
    data, reason = DAMAGED[case]
    codec = Codec()
    assert codec.parse(data) is None
    assert codec.refused == {name: int(name == reason) for name in REASONS}


def test_every_single_bit_matters():
    whole = documented()
    codec = Codec()
    for bit in range(8 * len(whole)):
        data = bytearray(whole)
        data[bit // 8] ^= 1 << bit % 8
        assert codec.parse(bytes(data)) is None
    assert sum(codec.refused.values()) == 8 * len(whole)


def test_another_key_is_refused():
    codec = Codec(b"another secret")
    assert codec.parse(Codec(KEY).pack(COMMAND)) is None
    assert codec.parse(Codec().pack(COMMAND)) is None
    assert codec.refused["tag"] == 2


def test_random_and_damaged_packets():
    spec = importlib.util.spec_from_file_location("fuzz", Path(__file__).resolve().parents[2] / "benchmarks" / "fuzz.py")
    fuzz = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fuzz)
    outcomes = fuzz.fuzz_packet(100_000, seed=20)
    assert not outcomes["hang"]
    assert not outcomes["changed"]
    assert sum(outcomes.values()) == 100_000
    # The inputs cover every reason, and valid packets were accepted.
    assert outcomes["taken"] > 10_000
    assert all(outcomes[f"refused_{reason}"] for reason in REASONS)
