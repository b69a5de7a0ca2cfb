"""The archive of an FMU."""

import hashlib
import html
import io
import re
import uuid
import zipfile
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from ehls_ros import __version__
from ehls_ros.errors import BadInput
from ehls_ros.fmu.description import Version, description, terminals
from ehls_ros.fmu.header import header
from ehls_ros.fmu.library import SOURCE, SUFFIXES, shared_library
from ehls_ros.fmu.model import Model

FOLDERS: Mapping[str, Mapping[str, str]] = {
    "2.0": {"linux": "linux64", "windows": "win64"},
    "3.0": {"linux": "x86_64-linux", "windows": "x86_64-windows"},
}
"""Folders of the binaries by version of FMI and system."""

SYSTEMS = tuple(SUFFIXES)

ICON = "icon.png"

_DATE = (1980, 1, 1, 0, 0, 0)
"""Date of every file in the archive, so that equal models make equal archives."""


def identifier(stem: str, where: str) -> str:
    """Return a name as an identifier of C, for the files of the library.

    Raises:
        BadInput: no letter or digit is left.
    """
    found = re.sub(r"\W+", "_", stem, flags=re.ASCII).strip("_")
    if not found:
        raise BadInput(f"the name {stem!r} has neither letter nor digit", where, "a file name such as rig.fmu")
    return found if found[0].isalpha() else f"fmu_{found}"


def token_of(model: Model) -> str:
    """Return the instantiation token: equal for equal models, so that saved states can be exchanged between them."""
    kernels = " ".join(kernel.__name__ for kernel in model.entries.values())
    text = f"{__version__} {model.name} {kernels} {header(model, '{0000000}')}"
    return f"{{{uuid.UUID(bytes=hashlib.sha256(text.encode()).digest()[:16])}}}"


def fmu(
    model: Model,
    version: Version,
    resources: Mapping[str, bytes],
    where: str,
    systems: Sequence[str] = SYSTEMS,
    say: Callable[[str], None] = lambda text: None,
) -> bytes:
    """Return a model as an FMU.

    Args:
        model: the model.
        version: of FMI.
        resources: further files, by name.
        where: the command, for errors.
        systems: systems to link it for.
        say: called with the name of each step.

    Raises:
        BadInput: the toolchain is not installed.
        WorkFailed: it failed.
    """
    token = token_of(model)
    files = {f"resources/{name}": content for name, content in resources.items()}
    for system in systems:
        say(f"linking for {system}")
        place = f"binaries/{FOLDERS[version][system]}/{model.name}{SUFFIXES[system]}"
        files[place] = shared_library(model, token, system, where)
    generated = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    files["modelDescription.xml"] = description(model, version, token, generated)
    files["documentation/index.html"] = _documentation(model, resources).encode()
    files["documentation/licenses/license.txt"] = (SOURCE / "license.txt").read_bytes()
    icon = (SOURCE / ICON).read_bytes()
    if version == "3.0":
        files["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(model)
        files[f"terminalsAndIcons/{ICON}"] = icon
    else:
        files["model.png"] = icon
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            information = zipfile.ZipInfo(name, _DATE)
            information.compress_type = zipfile.ZIP_DEFLATED
            information.external_attr = 0o644 << 16
            archive.writestr(information, files[name])
    return packed.getvalue()


def _documentation(model: Model, resources: Mapping[str, bytes]) -> str:
    rows = "\n".join(
        f"<tr><td>{html.escape(v.name)}</td><td>{v.causality}</td><td>{html.escape(v.unit)}</td>"
        f"<td>{html.escape(v.description)}</td></tr>"
        for v in model.block.variables
    )
    exchange = "and Model Exchange" if model.event is not None else "; no Model Exchange, as commands are in transit or sampled"
    named = ", ".join(sorted(resources))
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{html.escape(model.name)}</title></head><body>
<h1>{html.escape(model.name)}</h1>
<p>{html.escape(model.description)}</p>
<p>Co-Simulation {exchange}. In Co-Simulation, inputs are sampled and held for {model.period:g} s, and a communication step is a
multiple of that. The machine code needs a processor with AVX2 and FMA. Made by ehls_ros {__version__} from the files in
resources/: {html.escape(named)}.</p>
<table><tr><th>variable</th><th>causality</th><th>unit</th><th>meaning</th></tr>
{rows}
</table></body></html>
"""


def write_fmu(path: Path, content: bytes) -> None:
    """Write an FMU atomically.

    Raises:
        BadInput: it cannot be written.
    """
    scratch = path.with_name(f".{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch.write_bytes(content)
        scratch.replace(path)
    except OSError as error:
        raise BadInput(f"the file cannot be written ({error.strerror})", str(path), "a file in a writable folder") from None
    finally:
        scratch.unlink(missing_ok=True)
