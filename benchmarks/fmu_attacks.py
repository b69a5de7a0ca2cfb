"""Damaged FMUs as plants: each is refused in one line, or runs; nothing else happens to this process.

    make setup WITH=fmu
    python -m benchmarks.fmu_attacks --count 1000

Damages are drawn by a seed: bytes and the length of the archive, the model description (characters, elements, attributes,
units, value references), bytes of the library's code and data, another library, paths out of the archive.
"""

import itertools
import random
import re
import shutil
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from benchmarks.common import parser_of
from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_rig
from ehls_ros.fmu import foreign_plant
from ehls_ros.fmu.archive import fmu
from ehls_ros.fmu.foreign_plant import ForeignPlant
from ehls_ros.fmu.plant_map import PlantMap
from ehls_ros.fmu.plant_model import plant_model

PERIOD, STEPS = 1e-3, 20

SLOW = 15.0
"""Time above which a case counts as slow [s]."""

Files = dict[str, bytes]

DESCRIPTION = "modelDescription.xml"


def _text(change: Callable[[str, random.Random], str]) -> Callable[[Files, random.Random], None]:
    def damage(files: Files, dice: random.Random) -> None:
        files[DESCRIPTION] = change(files[DESCRIPTION].decode(), dice).encode(errors="surrogateescape")

    return damage


def _characters(text: str, dice: random.Random) -> str:
    letters = list(text)
    for _ in range(dice.randint(1, 30)):
        letters[dice.randrange(len(letters))] = dice.choice("<>\"'&;=/ \x00aé9-")
    return "".join(letters)


def _drop(pattern: str) -> Callable[[str, random.Random], str]:
    def change(text: str, dice: random.Random) -> str:
        found = dice.choice(list(re.finditer(pattern, text)))
        return text[: found.start()] + text[found.end() :]

    return change


def _replace(pattern: str, values: list[str]) -> Callable[[str, random.Random], str]:
    def change(text: str, dice: random.Random) -> str:
        for _ in range(dice.randint(1, 5)):
            found = dice.choice(list(re.finditer(pattern, text)))
            text = text[: found.start(1)] + dice.choice(values) + text[found.end(1) :]
        return text

    return change


def _entity(text: str, dice: random.Random) -> str:
    """Nest entities that expand to gigabytes."""
    names = [f"e{i}" for i in range(12)]
    entities = "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in itertools.pairwise(names))
    document = f'<!DOCTYPE x [<!ENTITY e0 "0123456789">{entities}]>'
    return text.replace("<fmiModelDescription", f"{document}<fmiModelDescription", 1).replace("time", "&e11;", 1)


def _binary(files: Files, dice: random.Random) -> None:
    name = next(name for name in files if name.endswith(".so"))
    code = bytearray(files[name])
    for _ in range(dice.choice((1, 10, 100, 1000))):
        code[dice.randrange(len(code))] = dice.randrange(256)
    files[name] = bytes(code[: dice.randrange(len(code))] if dice.random() < 0.2 else code)


def _other_library(files: Files, dice: random.Random) -> None:
    name = next(name for name in files if name.endswith(".so"))
    files[name] = dice.choice((b"", b"\x7fELF", Path("/proc/self/exe").read_bytes()))


def _path(files: Files, dice: random.Random) -> None:
    files[dice.choice(("../outside", "/tmp/outside", "resources/../../outside", "a\\b", "c:x"))] = b"x"  # noqa: S108 - never written


DAMAGES: dict[str, Callable[[Files, random.Random], None]] = {
    "characters": _text(_characters),
    "element": _text(_drop(r"<\w+ [^>]*/>")),
    "attribute": _text(_drop(r' \w+="[^"]*"')),
    "value": _text(_replace(r'="([^"]*)"', ["", "-1", "1e999", "NaN", "99999999999", "x" * 5000, "true", "Pa"])),
    "unit": _text(_replace(r' unit="([^"]*)"', ["furlong", "mm", "bar", "", "1", "K"])),
    "reference": _text(_replace(r'valueReference="(\d+)"', ["0", "1", "500", "4294967295", "77"])),
    "entities": _text(_entity),
    "binary": _binary,
    "library": _other_library,
    "path": _path,
}
"""Damages of the content, by name."""

ARCHIVE = ("truncated", "bytes")
"""Damages of the packed archive."""


def damaged(content: bytes, kind: str, dice: random.Random, folder: Path) -> bytes:
    """Return a damaged FMU."""
    if kind == "truncated":
        return content[: dice.randrange(len(content))]
    if kind == "bytes":
        changed = bytearray(content)
        for _ in range(dice.choice((1, 10, 100))):
            changed[dice.randrange(len(changed))] = dice.randrange(256)
        return bytes(changed)
    packed = folder / "original.fmu"
    packed.write_bytes(content)
    with zipfile.ZipFile(packed) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    DAMAGES[kind](files, dice)
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return packed.read_bytes()


def main() -> None:
    """Print the outcomes by kind of damage."""
    parser = parser_of(__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    foreign_plant.PREPARATION, foreign_plant.ANSWER = 10.0, 2.0
    rig = load_rig(configured("rig_paper"))
    dice, folder = random.Random(options.seed), Path(tempfile.mkdtemp(prefix="ehls_fmu_attacks_"))  # noqa: S311
    outcomes, wrong = Counter[tuple[str, str]](), list[str]()
    kinds = (*ARCHIVE, *DAMAGES)
    try:
        model = plant_model(rig, "rig")
        contents = [fmu(model, version, {}, "benchmark", ["linux"]) for version in ("2.0", "3.0")]
        for number in range(options.count):
            kind = kinds[number % len(kinds)]
            path = folder / "damaged.fmu"
            path.write_bytes(damaged(dice.choice(contents), kind, dice, folder))
            begun = time.monotonic()
            outcome = _run(path, rig)
            took = time.monotonic() - begun
            outcomes[kind, outcome.partition(":")[0]] += 1
            if outcome.startswith("WRONG") or took > SLOW:
                wrong.append(f"case {number}, {kind}: {outcome} after {took:.1f} s")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    for kind in kinds:
        counts = {outcome: count for (of, outcome), count in sorted(outcomes.items()) if of == kind}
        print(f"{kind:<12}" + ", ".join(f"{outcome} {count}" for outcome, count in counts.items()))
    print(f"{options.count} cases, {len(wrong)} with another error, more than one line, or more than {SLOW:g} s")
    for line in wrong[:20]:
        print(f"  {line}")


def _run(path: Path, rig: object) -> str:
    """Run an FMU as a plant and return the outcome."""
    try:
        plant = ForeignPlant(path, PlantMap(), rig, PERIOD)  # type: ignore[arg-type]
    except (BadInput, WorkFailed) as error:
        return "refused" if "\n" not in str(error) else f"WRONG: {error!r}"
    except Exception as error:  # noqa: BLE001 - that is what is looked for
        return f"WRONG: {error!r}"
    try:
        for step in range(STEPS):
            plant.advance(1e-4 * step, 0.0, 0.0, 0.0, 0.0)
    except Exception as error:  # noqa: BLE001 - that is what is looked for
        return f"WRONG: {error!r}"
    else:
        if "\n" in plant.trouble():
            return f"WRONG: {plant.trouble()!r}"
        return "lost in a step" if plant.lost else "runs"
    finally:
        plant.close()


if __name__ == "__main__":
    main()
