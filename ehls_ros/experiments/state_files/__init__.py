"""State files: persistence of learnt and remembered data between runs, with one reader and one writer.

``access`` reads regular files of bounded size, replaces files atomically, and gives a process exclusive use of a folder.
``state_file`` adds the envelope (kind, rig, control period, checksum) around a typed document and declared arrays. ``archive``
is the format of a file with arrays, ``table`` a CSV that grows by lines. ``kinds`` declares each kind of state.
"""
