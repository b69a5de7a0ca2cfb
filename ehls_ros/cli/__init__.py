"""The `ehls` command."""
