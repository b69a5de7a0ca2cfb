"""`ehls rig-emulator`: emulate the rig over UDP in a process."""

import json
import signal
import sys
import threading
import time
from argparse import ArgumentParser, Namespace
from collections import deque
from pathlib import Path
from typing import Any

from ehls_ros.cli.arguments import add_configured, add_json, add_rig, check_duration
from ehls_ros.cli.results import writable
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.experiments.files import config_folder
from ehls_ros.experiments.graph_check import bridge_at
from ehls_ros.experiments.loop import sampled, simulator_of
from ehls_ros.experiments.spec import Spec, check_spec, load_rig, spec_from_mapping
from ehls_ros.hardware.backends.udp import bound_socket, codec
from ehls_ros.hardware.bridge_file import Bridge
from ehls_ros.hardware.emulator import Emulator
from ehls_ros.hardware.emulator_loop import Delays, Run, run_lockstep, run_realtime
from ehls_ros.hardware.faults import FAULTS
from ehls_ros.hardware.realtime import claim, exact_wake_ups
from ehls_ros.hardware.target import Target
from ehls_ros.hardware.truth_log import TruthLog
from ehls_ros.hardware.wire import BadWire, Impairments, Wire
from ehls_ros.physics.rig import Rig, rig_to_mapping
from ehls_ros.process import Stopping
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.schema import parse

HELP = "Emulate the rig over UDP: plant, converters and sensors; for tests of the hardware bridge."

COMMAND_DELAY = "command_delay"

ROUNDING = 1e-9
"""Delay up to which it is taken as zero [s]."""

PRIORITY = 40
"""SCHED_FIFO priority of the loop, where permitted."""


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    add_rig(parser, "rig file in place of the spec's (default: rig_paper_measured.yaml)", required=False)
    about = "experiment file: its rig, disturbance, period, initial position, oil, seed"
    add_configured(parser, "--spec", "experiments", about)
    parser.add_argument("--bridge", type=Path, help="bridge file with the udp backend (default: bridge_udp.yaml)")
    parser.add_argument("--port", type=int, help="UDP port to listen on in place of the bridge file's; 0: any free port")
    parser.add_argument("--duration", type=float, help="plant time to run in s (default: until stopped)")
    parser.add_argument("--seed", type=int, help="seed of sensor noise and network faults in place of the spec's")
    parser.add_argument("--log", type=Path, help="CSV file of the true states, cycle by cycle, written at the end")
    add_json(parser, "counts and timing")
    parser.add_argument(
        "--disturb-at-once",
        action="store_true",
        help="start the disturbance at once, not after the first command that opens the valve",
    )
    about = "time from that command to the disturbance in s, in which the gate blends in (default: 1)"
    parser.add_argument("--disturb-after", type=float, default=1.0, help=about)
    timing = parser.add_argument_group("timing")
    timing.add_argument("--lockstep", action="store_true", help="in each cycle, wait for the command that answers it")
    timing.add_argument("--patience", type=float, default=30.0, help="longest wait in lockstep in s (default: 30)")
    timing.add_argument("--priority", type=int, default=PRIORITY, help=f"SCHED_FIFO priority; 0: none (default: {PRIORITY})")
    net = parser.add_argument_group("network", "faults of packets in both directions")
    net.add_argument("--latency-ms", type=float, default=0.0, help="delay of every packet")
    net.add_argument("--jitter-ms", type=float, default=0.0, help="largest random extra delay")
    for name in ("loss", "duplicate", "reorder", "corrupt"):
        net.add_argument(f"--{name}", type=float, default=0.0, metavar="SHARE", help="fraction of packets, 0 to 1")
    parser.add_argument(
        "--faults-from-stdin", action="store_true", help=f"for tests, one per line: {', '.join(FAULTS)}; see docs/hardware.md"
    )


def run(options: Namespace) -> int:
    """Run the emulator."""
    bridge = _bridge(options)
    spec = _spec(options)
    seed = spec.settings.seed if options.seed is None else options.seed
    period = spec.settings.control_period
    impairments = _impairments(options)
    if unknown := [signal for signal in bridge.calibration.wired if signal not in spec.rig.sensed]:
        expected = f"channels of {', '.join(spec.rig.sensed)}, which cylinder {spec.rig.cylinder.model} has"
        raise BadInput(f"{unknown[0]} has a channel", f"{options.bridge or 'bridge file'}: channels", expected)
    if options.log is not None:
        writable(options.log.parent, options.log.name)
    parameters = bridge.parameters
    opened = bound_socket(parameters.host, parameters.port if options.port is None else options.port)
    with opened:
        # A fault may delay packets.
        is_good = options.lockstep or (impairments == Impairments() and not options.faults_from_stdin)
        wire = Wire(opened) if is_good else BadWire(opened, impairments, period, seed)
        output = bridge.calibration.output
        target = Target(codec(parameters), period, output.offset)
        kind = DISTURBANCES.load(spec.disturbance.name)
        log = TruthLog() if options.log is not None else None
        emulator = Emulator(
            simulator_of(spec),
            kind.build(spec.disturbance.parameters, sampled(spec.disturbance.signal, period), spec.rig, period),
            bridge.calibration,
            seed,
            disturb_at_once=options.disturb_at_once,
            disturb_after=options.disturb_after,
            log=log,
        )
        delays = Delays()
        begin = time.process_time()
        try:
            _run(options, emulator, target, wire, delays, opened.getsockname())
        finally:
            cpu = time.process_time() - begin
            if log is not None:
                try:
                    log.write(options.log)
                except OSError as error:
                    raise WorkFailed(f"{options.log} cannot be written ({error.strerror})") from error
    figures = _figures(emulator, target, wire, delays, lockstep=options.lockstep)
    figures["cpu_s"] = round(cpu, 2)
    print(json.dumps(figures) if options.json else "\n".join(f"  {name:<24}{value:>12g}" for name, value in figures.items()))
    return 0


def _run(options: Namespace, emulator: Emulator, target: Target, wire: Wire, delays: Delays, address: Any) -> None:
    stop = Stopping()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    cycles = sys.maxsize if options.duration is None else round(options.duration / emulator.period)
    lines: deque[str] = deque()
    if options.faults_from_stdin:
        threading.Thread(target=lambda: lines.extend(map(str.strip, sys.stdin)), daemon=True).start()
    run_of = Run(cycles, stop.is_set, lines, lambda line, now: print(f"fault: {now:.6f} {line}", flush=True))
    print(f"rig emulator: listening at {address[0]} port {address[1]}", flush=True)
    if options.lockstep:
        run_lockstep(emulator, target, wire, run_of, options.patience)
        return
    exact_wake_ups()
    for refusal in claim(options.priority):
        print(f"rig emulator: {refusal}", file=sys.stderr)
    run_realtime(emulator, target, wire, run_of, delays)


def _bridge(options: Namespace) -> Bridge:
    bridge = bridge_at(options.bridge)
    if bridge.backend != "udp":
        raise BadInput(f"name is {bridge.backend!r}", f"{options.bridge}: backend", "udp, the protocol of the emulator")
    return bridge


def _spec(options: Namespace) -> Spec:
    check_duration(options)
    if not 0.0 <= options.disturb_after < 1e6:
        raise BadInput(f"--disturb-after is {options.disturb_after:g}", "command line", "seconds from 0 to below 1e6")
    rig = options.rig or config_folder() / "rig_paper_measured.yaml"
    if options.spec is None:
        nothing = {"reference": {"name": "constant", "value": 0.0}, "controller": "fasmc"}
        return spec_from_mapping({"rig": rig_to_mapping(load_rig(rig)), **nothing}, str(rig), rig.parent)
    content = read_yaml(options.spec, "spec")
    if options.rig is not None and isinstance(content, dict):
        content["rig"] = rig_to_mapping(load_rig(rig))
    spec = spec_from_mapping(content, str(options.spec), options.spec.parent)
    check_spec(spec, str(options.spec))
    return spec._replace(rig=_without_own_delay(spec.rig, spec.settings.control_period))


def _without_own_delay(rig: Rig, period: float) -> Rig:
    """Subtract the one-cycle delay of the wire from the rig's command delay, so that a spec has one meaning on every plant."""
    effects = []
    for use in rig.effects:
        if use.name == COMMAND_DELAY:
            left = use.parameters.delay - period
            effects += [use._replace(parameters=use.parameters._replace(delay=left))] if left > ROUNDING else []
        else:
            effects.append(use)
    return rig._replace(effects=tuple(effects))


def _impairments(options: Namespace) -> Impairments:
    values = {"latency": 1e-3 * options.latency_ms, "jitter": 1e-3 * options.jitter_ms}
    shares = {name: getattr(options, name) for name in ("loss", "duplicate", "reorder", "corrupt")}
    impairments = parse(Impairments, values | shares, "command line")
    if options.lockstep and impairments != Impairments():
        raise BadInput("--lockstep with network faults", "command line", "--lockstep alone, or network faults in real time")
    return impairments


def _figures(emulator: Emulator, target: Target, wire: Wire, delays: Delays, *, lockstep: bool) -> dict[str, float]:
    figures: dict[str, float] = {"cycles": emulator.cycle, **target.figures(), "unsent": wire.unsent}
    if not lockstep:
        parts = {"p50": 0.5, "p99": 0.99, "p999": 0.999}
        figures |= {f"wakeup_{name}_us": round(1e6 * delays.quantile(part)) for name, part in parts.items()}
        figures["wakeup_max_us"] = round(1e6 * delays.largest)
    return figures
