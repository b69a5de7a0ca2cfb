"""What scripts and notebooks use, as ``import ehls_ros as ehls``: the work of the verbs, with objects in and out."""
