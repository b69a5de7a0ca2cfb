"""Arguments that name a file, or one that comes with the package."""

import argparse
from pathlib import Path

from ehls_ros.experiments.files import configured


class Configured(argparse.Action):
    """Finds the file: the path if there is one, otherwise the package's file of that name."""

    def __init__(self, option_strings: list[str], dest: str, folder: str = "", **options: object) -> None:
        """Remember where the package's files of this kind are.

        Args:
            option_strings: the option's names.
            dest: the attribute that takes the path.
            folder: the kind, as of :func:`ehls_ros.experiments.files.configured`.
            options: what argparse passes on.
        """
        super().__init__(option_strings, dest, **options)  # type: ignore[arg-type]
        self.folder = folder

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option_string: str | None = None
    ) -> None:
        """Set the path."""
        setattr(namespace, self.dest, configured(Path(str(values)), self.folder))
