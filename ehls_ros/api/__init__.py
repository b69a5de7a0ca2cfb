"""Python interface for scripts and notebooks, ``import ehls_ros as ehls``: the verbs as functions on objects."""
