"""Command line arguments that name a file by its path, or a file of the package by its name."""

import argparse
from pathlib import Path

from ehls_ros.experiments.files import configured


class Configured(argparse.Action):
    """Resolve a file: the path if it exists, otherwise the package's file of that name."""

    def __init__(self, option_strings: list[str], dest: str, folder: str = "", **options: object) -> None:
        """Set the folder of the package's files of this kind.

        Args:
            option_strings: the option's names.
            dest: the attribute that takes the path.
            folder: see :func:`ehls_ros.experiments.files.configured`.
            options: further options of argparse.
        """
        super().__init__(option_strings, dest, **options)  # type: ignore[arg-type]
        self.folder = folder

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option_string: str | None = None
    ) -> None:
        """Store the resolved path."""
        setattr(namespace, self.dest, configured(Path(str(values)), self.folder))
