"""Cost of a packet and of a round trip to the emulated rig, and the emulator's wake-up jitter at 1 kHz.

python benchmarks/udp_echo.py --duration 60
"""

import argparse
import json
import os
import subprocess
import sys
import time
import timeit
from pathlib import Path

import numpy as np
import yaml

from ehls_ros.hardware.bridge_file import bridge_from_mapping
from ehls_ros.hardware.packet import Codec, Kind, Packet

CONFIG = Path(__file__).resolve().parents[1] / "config"
PERIOD = 1e-3
KEY = b"a secret of both"
PARTS = (0.5, 0.99, 0.999, 1.0)


def packets() -> None:
    """Print the cost of packing and unpacking a packet."""
    packet = Packet(Kind.MEASUREMENT, 7, 9, 41, 40, 5, 0, 0, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    for name, codec in (("crc", Codec()), ("key", Codec(KEY))):
        data = codec.pack(packet)
        for verb, work in (("pack", lambda c=codec: c.pack(packet)), ("parse", lambda c=codec, d=data: c.parse(d))):
            best = min(timeit.repeat(work, number=20_000, repeat=5)) / 20_000
            print(f"{verb:6} {len(data)} bytes, {name}   {1e6 * best:6.2f} us")


def quantiles(name: str, seconds: np.ndarray) -> None:
    """Print quantiles in us."""
    values = "  ".join(f"p{100 * part:g} {1e6 * np.quantile(seconds, part):8.1f}" for part in PARTS)
    print(f"{name:34} {values} us")


def clock(duration: float) -> None:
    """Print the wake-up latency of an otherwise idle thread, the lower bound."""
    late, deadline = [], time.monotonic()
    for _ in range(round(duration / PERIOD)):
        deadline += PERIOD
        time.sleep(max(deadline - time.monotonic(), 0.0))
        late.append(time.monotonic() - deadline)
    quantiles("sleeping thread late by", np.array(late))


def emulator(duration: float, priority: int) -> None:
    """Answer each measurement of an emulator at once; print the times of measurements and answers."""
    bridge = bridge_from_mapping(yaml.safe_load((CONFIG / "bridge_udp.yaml").read_text(encoding="utf-8")), "bridge_udp.yaml")
    arguments = ("--port", "0", "--json", "--duration", str(duration), "--priority", str(priority))
    command = [sys.executable, "-m", "ehls_ros.cli.main", "rig-emulator", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None  # noqa: S101
        port = int(process.stdout.readline().rsplit(" ", 1)[1])
        bridge = bridge._replace(parameters=bridge.parameters._replace(port=port))
        device = bridge.open(PERIOD)
        came = []
        while process.poll() is None:
            reading = device.read(0.1)
            if reading is not None:
                came.append((time.monotonic(), reading.sequence))
                device.write(0.1, reading.sequence)
        times, numbers = np.array(came).T
        offset = np.min(times - PERIOD * numbers)
        quantiles("measurements late by", times - PERIOD * numbers - offset)
        seen = device.figures()
        device.close()
        figures = json.loads(process.stdout.read().splitlines()[-1])
    print(f"measurements: {seen['received']} received, {seen['skipped']} superseded, {seen['lost']} lost")
    print(f"commands: {seen['sent']} sent, {figures['commands']} taken, {figures['late']} late, watchdog {figures['watchdog']}")
    wake = {name: value for name, value in figures.items() if name.startswith("wakeup")}
    print(f"emulator: {wake}, {100 * figures['cpu_s'] / duration:.0f} % of a core")


def echo(count: int) -> None:
    """Print the round trip to an emulator in lockstep: measurement, answer, plant, next measurement."""
    bridge = bridge_from_mapping(yaml.safe_load((CONFIG / "bridge_udp.yaml").read_text(encoding="utf-8")), "bridge_udp.yaml")
    command = [sys.executable, "-m", "ehls_ros.cli.main", "rig-emulator", "--port", "0", "--lockstep"]
    command += ["--duration", str(count * PERIOD)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None  # noqa: S101
        port = int(process.stdout.readline().rsplit(" ", 1)[1])
        bridge = bridge._replace(parameters=bridge.parameters._replace(port=port))
        device = bridge.open(PERIOD)
        took, sent = [], time.monotonic()
        for cycle in range(count):
            while (reading := device.read(1.0)) is None:
                pass
            now = time.monotonic()
            if cycle:
                took.append(now - sent)
            sent = time.monotonic()
            device.write(0.0, reading.sequence)
        device.close()
        process.stdout.read()
    quantiles("round trip in lockstep", np.array(took))


def main() -> None:
    """Run everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=20.0, help="length of the realtime run [s]")
    options = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores")
    packets()
    clock(options.duration / 2)
    echo(5000)
    for priority in (0, 40):
        print(f"priority {priority}:")
        emulator(options.duration, priority)


if __name__ == "__main__":
    main()
