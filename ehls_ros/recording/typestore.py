"""Message types for reading and writing bags without ROS."""

from functools import cache
from pathlib import Path

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

MESSAGE_FILES = Path(__file__).parent / "msg"
"""The definitions of ``ehls_msgs``, installed as data of this package."""

SEPARATOR = "=" * 80 + "\n"
"""Line between the definition of a type and those of the types it uses."""


@cache
def typestore() -> Typestore:
    """Return the types of ROS 2 Jazzy together with those of ``ehls_msgs``."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in sorted(MESSAGE_FILES.glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"ehls_msgs/msg/{file.stem}"))
    return store


@cache
def definition(message_type: str) -> str:
    """Return the definitions of a type and of the types it uses, in the form stored by the ROS recorder.

    For ``ehls_msgs`` this is the file itself, whose comments state the fields' units and meaning.
    """
    generated: str = typestore().generate_msgdef(message_type, ros_version=2)[0]
    package, _, name = message_type.split("/")
    if package != "ehls_msgs":
        return generated
    _, line, used = generated.partition(SEPARATOR)
    return (MESSAGE_FILES / f"{name}.msg").read_text(encoding="utf-8") + line + used


def typestore_of(definition: MessageDefinition, message_type: str) -> Typestore:
    """Return the types as defined in the bag, possibly by another version of ``ehls_msgs``.

    Args:
        definition: definition of the type and its nested types, from the bag.
        message_type: name of the type.

    Returns:
        A store with the fields of the type; that of :func:`typestore` if the bag has no definitions, as before ROS 2 Iron.

    Raises:
        rosbags.typesys.TypesysError: the definition is invalid.
    """
    if definition.format is MessageDefinitionFormat.NONE:
        return typestore()
    store = get_typestore(Stores.EMPTY)
    # Registering the types would run code generated from the bag's text.
    if definition.format is MessageDefinitionFormat.IDL:
        store.fielddefs.update(get_types_from_idl(definition.data))
    else:
        store.fielddefs.update(get_types_from_msg(definition.data, message_type))
    return store
