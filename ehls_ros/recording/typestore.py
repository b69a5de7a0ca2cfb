"""Message types for reading and writing bags without ROS."""

from functools import cache
from pathlib import Path

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

MESSAGE_FILES = Path(__file__).parent / "msg"
"""The definitions of ``ehls_msgs``, installed as data of this package."""


@cache
def typestore() -> Typestore:
    """Return the types of ROS 2 Jazzy together with those of ``ehls_msgs``."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in sorted(MESSAGE_FILES.glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"ehls_msgs/msg/{file.stem}"))
    return store


def typestore_of(definition: MessageDefinition, message_type: str) -> Typestore:
    """Return the types a bag itself defines, which another version of ``ehls_msgs`` may have written.

    Args:
        definition: what the bag says the type looks like, with the types nested in it.
        message_type: name of the type.

    Returns:
        A store that knows the fields of the type; it is that of :func:`typestore` when the bag defines nothing, as
        bags older than ROS 2 Iron do.

    Raises:
        rosbags.typesys.TypesysError: the definition is no message definition.
    """
    if definition.format is MessageDefinitionFormat.NONE:
        return typestore()
    store = get_typestore(Stores.EMPTY)
    # not registered: that would run code made from the bag's text
    if definition.format is MessageDefinitionFormat.IDL:
        store.fielddefs.update(get_types_from_idl(definition.data))
    else:
        store.fielddefs.update(get_types_from_msg(definition.data, message_type))
    return store
