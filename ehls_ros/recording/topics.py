"""Topics of a run: name, ROS type, and the trajectory's signal for each message field."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

NAMESPACE = "/ehls"
"""Default namespace of the graph."""

DEPTH = 1000
"""Minimum queue depth of a control-path topic [messages]: one second of cycles at 1 kHz."""

LOADER_FRAME = "loader"
"""Frame of every message about the loading cylinder: fixed to its piston, x along the piston's positive direction."""

SENDER = "sender"
"""Field of cycle messages with the name of the sender; absent in bags of earlier versions."""


class Topic(NamedTuple):
    """One topic.

    Attributes:
        name: name below the namespace, or an absolute name.
        type: ROS message type.
        signals: names in :data:`ehls_ros.trajectory.SIGNALS` by message field, in the same units.
        depth: history depth of a publisher; all publishers are reliable.
        transient_local: whether the history is kept for late-joining readers.
    """

    name: str
    type: str
    signals: Mapping[str, str] = MappingProxyType({})
    depth: int = 10
    transient_local: bool = False

    def resolve(self, namespace: str = NAMESPACE) -> str:
        """Return the full name, resolved in a namespace as in ROS."""
        return self.name if self.name.startswith("/") else f"{namespace.rstrip('/')}/{self.name}"


def _cycle_topic(name: str, message_type: str, signals: Mapping[str, str]) -> Topic:
    return Topic(name, message_type, signals, DEPTH, transient_local=True)


def _force_topic(name: str) -> Topic:
    signals = {"force": f"{name}_n", "force_rate": f"{name}_rate_n_s", "force_acceleration": f"{name}_acceleration_n_s2"}
    return _cycle_topic(name, "ehls_msgs/msg/ForceReference", signals)


def _position_topic(name: str) -> Topic:
    signals = {"position": f"{name}_m", "velocity": f"{name}_rate_m_s", "acceleration": f"{name}_acceleration_m_s2"}
    return _cycle_topic(name, "ehls_msgs/msg/PositionReference", signals)


LOADER_STATE = _cycle_topic(
    "loader_state",
    "ehls_msgs/msg/LoaderState",
    {
        "position": "position_m",
        "velocity": "velocity_m_s",
        "load_pressure": "load_pressure_pa",
        "spool_position": "spool_m",
        "force": "force_n",
        "supply_pressure": "supply_pressure_pa",
        "oil_temperature": "oil_temperature_k",
    },
)
CHAMBER_PRESSURES = _cycle_topic(
    "chamber_pressures", "ehls_msgs/msg/ChamberPressures", {"pressure_a": "pressure_a_pa", "pressure_b": "pressure_b_pa"}
)
"""Further readings of a rig whose cylinder has two chambers."""

READINGS: Mapping[str, str] = MappingProxyType({**LOADER_STATE.signals, **CHAMBER_PRESSURES.signals})
"""Signals of recordings by the readings of a rig, including those that only a cylinder of two chambers has."""

FORCE_REFERENCE = _force_topic("force_reference")
POSITION_REFERENCE = _position_topic("position_reference")
REFERENCE_TOPICS: Mapping[str, Topic] = MappingProxyType({"force": FORCE_REFERENCE, "position": POSITION_REFERENCE})
"""Reference topic by the controlled quantity; a run has one of them."""

ACTUATOR_TOPICS: Mapping[str, Topic] = MappingProxyType(
    {"force": _force_topic("actuator_force_reference"), "position": _position_topic("actuator_position_reference")}
)
"""Topic of the actuator's setpoint ahead of the cycles, by its quantity. A run has one of them if a companion uses it."""

PROGRAMME_POINT = _cycle_topic(
    "programme_point",
    "ehls_msgs/msg/ProgrammePoint",
    {
        "block": "programme_block",
        "repetition": "programme_repetition",
        "load_cycles": "programme_load_cycles",
        "phase": "programme_phase",
        "state": "programme_state",
    },
)

DISTURBANCE = _cycle_topic(
    "disturbance",
    "ehls_msgs/msg/Disturbance",
    {
        "force": "disturbance_force_n",
        "force_rate": "disturbance_force_rate_n_s",
        "displacement": "disturbance_displacement_m",
        "velocity": "disturbance_velocity_m_s",
    },
)
SERVO_REFERENCE = Topic("servo_reference", "ehls_msgs/msg/Disturbance", depth=DEPTH, transient_local=True)
"""Displacement and velocity setpoints of a simulated position servo, ahead of the cycles.

Not recorded, as the experiment defines them and ``disturbance`` contains the motion.
"""

FRICTION_ESTIMATE = _cycle_topic(
    "friction_estimate",
    "ehls_msgs/msg/FrictionEstimate",
    {
        "gms_force": "friction_gms_n",
        "viscous_force": "friction_viscous_n",
        "element_forces": "friction_elements_n",
        "slipping": "friction_slipping",
    },
)
VALVE_COMMAND = _cycle_topic("valve_command", "ehls_msgs/msg/ValveCommand", {"spool": "valve_command_m"})
CONTROLLER_STATUS = _cycle_topic(
    "controller_status",
    "ehls_msgs/msg/ControllerStatus",
    {
        "e3": "e3_pa",
        "s": "s_pa_s",
        "alpha": "alpha",
        "beta": "beta",
        "delta": "delta_n",
        "u1": "u1_kg_pa_s2",
        "u2": "u2_kg_pa_s2",
        "u3": "u3_kg_pa_s2",
        "force_error": "force_error_n",
        "force_bound": "force_bound_n",
        "saturated": "saturated",
        "at_bound": "at_bound",
        "friction_fallback": "friction_fallback",
    },
)

CYCLE_TOPICS = (
    LOADER_STATE,
    CHAMBER_PRESSURES,
    FORCE_REFERENCE,
    POSITION_REFERENCE,
    PROGRAMME_POINT,
    *ACTUATOR_TOPICS.values(),
    DISTURBANCE,
    FRICTION_ESTIMATE,
    VALVE_COMMAND,
    CONTROLLER_STATUS,
)
"""Topics of a trajectory, in the order of a control cycle; every message has a header and a cycle."""

DRIVING = Topic("driving", "std_msgs/msg/Bool", depth=1, transient_local=True)
"""Whether commands reach the valve; published on change."""

IN_FULL = Topic("commands_in_full", "std_msgs/msg/Bool", depth=1, transient_local=True)
"""Whether commands reach the valve unchanged, neither blended in nor held; published on change, not recorded."""

DRIVER = Topic("driver", "ehls_msgs/msg/Driver", transient_local=True)
"""Controller whose commands the gate passes on; published on change."""

STANDBY_COMMAND = Topic("standby_command", "ehls_msgs/msg/ValveCommand")
"""Command of each standby controller; the commands in a bag name the active one."""

LEAVING = Topic("leaving", "std_msgs/msg/String")
"""Sender name of a node at the end of its loop."""

REFUSED = Topic("refused", "ehls_msgs/msg/Refusal", transient_local=True)
"""Senders rejected by a reader, since another sender owns the input."""

ACCEPTED_RIG = Topic("accepted_rig", "std_msgs/msg/String", depth=1, transient_local=True)
"""Rig file with the changes accepted by an operator, for controllers that subscribe to it (``accept_rig``)."""

HANDOVER_TOPICS = (DRIVER, STANDBY_COMMAND, LEAVING, REFUSED, ACCEPTED_RIG)
"""Topics for a change of the active controller, of an input's owner, or of the accepted rig; not recorded."""

MODEL_HEALTH = Topic("model_health", "ehls_msgs/msg/ModelHealth", depth=1, transient_local=True)
"""Findings of the monitor on the rig; published on change and periodically; not recorded, as a bag can be replayed."""

DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
OF_GATE, TRIPPED_BY = "owner", "cause_1"
"""Keys in the diagnostics of the node with the safety gate.

The first is always present, and only there; the second is present while tripped.
"""

FORCE = Topic("force", "std_msgs/msg/Float64")
WRENCH = Topic("wrench", "geometry_msgs/msg/WrenchStamped")
LOAD_PRESSURE = Topic("load_pressure", "sensor_msgs/msg/FluidPressure")
SUPPLY_PRESSURE = Topic("supply_pressure", "sensor_msgs/msg/FluidPressure")
PRESSURE_A = Topic("pressure_a", "sensor_msgs/msg/FluidPressure")
PRESSURE_B = Topic("pressure_b", "sensor_msgs/msg/FluidPressure")
OIL_TEMPERATURE = Topic("oil_temperature", "sensor_msgs/msg/Temperature")
JOINT_STATES = Topic("joint_states", "sensor_msgs/msg/JointState")

TELEMETRY_TOPICS = (
    DRIVING,
    FORCE,
    WRENCH,
    LOAD_PRESSURE,
    SUPPLY_PRESSURE,
    PRESSURE_A,
    PRESSURE_B,
    OIL_TEMPERATURE,
    JOINT_STATES,
    DIAGNOSTICS,
)
"""Topics recorded for standard tools; the cycle topics contain the same data."""

PARAMETER_EVENTS = Topic("/parameter_events", "rcl_interfaces/msg/ParameterEvent", depth=1000)
ROSOUT = Topic("/rosout", "rcl_interfaces/msg/Log", depth=1000, transient_local=True)

TOPICS = (*CYCLE_TOPICS, *TELEMETRY_TOPICS, PARAMETER_EVENTS, ROSOUT)

CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", depth=1, transient_local=True)
"""The time of a run in lockstep."""

TRANSITION_EVENT = "transition_event"
"""Last part of the name of the topic on which a lifecycle node publishes its transitions."""


def transition_topic(node: str) -> Topic:
    """Return the topic on which a lifecycle node of the namespace publishes its transitions."""
    return Topic(f"{node}/{TRANSITION_EVENT}", "lifecycle_msgs/msg/TransitionEvent")


def known_topic(path: str, namespace: str) -> Topic | None:
    """Return the topic recorded by this package under a full name; None if there is none.

    Args:
        path: full name.
        namespace: namespace of the run.
    """
    parent, _, last = path.rpartition("/")
    if last == TRANSITION_EVENT and parent.startswith(f"{namespace}/"):
        return transition_topic(parent.removeprefix(f"{namespace}/"))
    return next((topic for topic in (*TOPICS, CLOCK) if topic.resolve(namespace) == path), None)


RESPONSE = "response_s"
"""Time from sending a cycle's snapshot to sending its valve command [s]; the only signal without a message field."""
