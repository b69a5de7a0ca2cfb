"""`python -m ehls_ros`: the `ehls` command."""

from ehls_ros.cli.main import entry

if __name__ == "__main__":
    entry()
