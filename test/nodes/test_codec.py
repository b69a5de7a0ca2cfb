"""The struct codec against rclpy's own serialisation."""

import random

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from rclpy.serialization import deserialize_message, serialize_message

from ehls_msgs import msg
from ehls_ros.nodes.codec import Decoder, Encoder

PLAIN = [
    msg.LoaderState,
    msg.ValveCommand,
    msg.ForceReference,
    msg.PositionReference,
    msg.ProgrammePoint,
    msg.Disturbance,
    msg.ControllerStatus,
]
"""Types of a header, numbers and a sender."""

SENDER = "/ehls/fasmc_node-4711"
FRAMES = ["", "loader", "a", "ab", "abc", "abcdefg", "abcdefgh"]


def filled(kind, frame, seed=1):
    random.seed(seed)
    message = kind()
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = 1_700_000_000, 123_456_789
    values = []
    for name, field in kind.get_fields_and_field_types().items():
        if name == "header":
            continue
        value = {
            "uint64": 2**60 + 7,
            "uint32": 2**31 + 7,
            "uint8": 200,
            "double": random.gauss(0, 1e5),
            "boolean": True,
            "string": SENDER,
        }[field]
        setattr(message, name, value)
        if field != "string":
            values.append(value)
    return message, values


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("kind", PLAIN)
def test_encoder_writes_what_rclpy_writes(kind, frame):
    message, values = filled(kind, frame)
    stamp = 1_700_000_000_123_456_789
    assert deserialize_message(Encoder(kind, frame, sender=SENDER)(stamp, *values), kind) == message


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("kind", PLAIN)
def test_decoder_reads_what_rclpy_wrote(kind, frame):
    message, values = filled(kind, frame)
    assert Decoder(kind)(serialize_message(message)) == (1_700_000_000_123_456_789, *values, SENDER)


@pytest.mark.parametrize("elements", [1, 2, 3, 7])
def test_sequences_are_written_and_what_comes_before_them_read(elements):
    lengths = {"element_forces": elements, "slipping": elements}
    forces = [float(i) for i in range(elements)]
    flags = [i % 2 == 0 for i in range(elements)]
    encode = Encoder(msg.FrictionEstimate, "", lengths, SENDER)
    encoded = encode(5, 9, 1.5, -2.5, elements, *forces, elements, *flags)
    message = deserialize_message(encoded, msg.FrictionEstimate)
    assert (list(message.element_forces), list(message.slipping), message.sender) == (forces, flags, SENDER)
    assert Decoder(msg.FrictionEstimate)(encoded) == (5, 9, 1.5, -2.5, SENDER)


@pytest.mark.parametrize("sender", ["", "a", "/ehls/fasmc_node-4711", "Größe"])
def test_the_sender_of_a_command_is_read_after_its_numbers(sender):
    command = msg.ValveCommand(cycle=3, spool=1e-3, sender=sender)
    assert Decoder(msg.ValveCommand)(serialize_message(command)) == (0, 3, 1e-3, sender)


@pytest.mark.parametrize("kind", [msg.LoaderState, msg.ValveCommand])
def test_what_is_no_message_is_none(kind):
    decode = Decoder(kind)
    whole = serialize_message(filled(kind, "loader")[0])
    # A message may end with padding, but with no more than that.
    for length in range(len(whole.rstrip(b"\0"))):
        assert decode(whole[:length]) is None
    random.seed(2)
    for _ in range(2000):
        decode(bytes(random.randrange(256) for _ in range(random.randrange(120))))


def test_frame_lengths_of_strangers_do_not_fill_the_memory():
    decode = Decoder(msg.ValveCommand)
    for length in range(5000):
        decode(b"\0\1\0\0" + bytes(8) + length.to_bytes(4, "little") + bytes(length))
    assert len(decode._formats) <= Decoder.MOST_FORMATS
