"""Transfer of a rig with operator-accepted changes from the monitor to controllers."""

import os
from pathlib import Path

from ehls_ros.control.adaptation.reach import check_reach
from ehls_ros.control.controllers.base import Model, model_of
from ehls_ros.errors import BadInput
from ehls_ros.experiments.state_files import access
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.recording.yaml_text import parse_yaml

MARK = "# ehls_ros accepted rig\n"
"""First line of the file."""

LONGEST = 1 << 16
"""Longest rig text that controllers accept [characters]; two kilobytes are usual."""

EXPECTED = "a rig as near to the controller's rig file as adaptation stays; for another one, start the controller with its file"


def write_accepted(path: Path, text: str) -> None:
    """Write the file of an accepted rig; a file of another kind is not replaced.

    Args:
        path: the file.
        text: content of a rig file.

    Raises:
        NotWritten: the file cannot be written; the message has the path and the reason.
    """
    there = os.path.exists(path)  # noqa: PTH110 - Path.exists raises where nobody may look
    if there and access.first_bytes(path, len(MARK)) != MARK.encode():
        raise access.NotWritten(f"{path}: is not replaced (it is no accepted rig); put it elsewhere")
    access.replace(path, lambda file: file.write(f"{MARK}{text}".encode()))


def accepted_model(text: str, own: Rig, period: float, where: str) -> Model:
    """Return the model of an accepted rig for a controller.

    Args:
        text: content of a rig file.
        own: the rig of the controller's rig file.
        period: period of the control cycles [s].
        where: the topic, for errors.

    Raises:
        BadInput: the text is not a rig, or it is further from the controller's rig file than adaptation may move a model.
    """
    if len(text) > LONGEST:
        raise BadInput(f"the rig has {len(text)} characters", where, f"at most {LONGEST}")
    rig = rig_from_mapping(parse_yaml(text, where, "rig"), where)
    # Only the shift of the rig's coefficients by the detected effects is compared.
    model = model_of(Rig(*rig.effective()), period)
    if rig.limits != own.limits:
        raise BadInput("it has other limits", where, EXPECTED)
    try:
        check_reach(model, model_of(Rig(*own.effective()), period), own.limits)
    except ValueError as error:
        raise BadInput(str(error), where, EXPECTED) from None
    return model
