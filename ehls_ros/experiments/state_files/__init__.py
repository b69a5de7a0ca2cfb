"""State files: everything that is learnt or remembered between runs, through one reader and one writer.

``access`` reads regular files of bounded size and replaces files atomically; ``state_file`` adds the envelope (kind, rig,
control period, checksum) around a typed document and declared arrays; ``archive`` is the form of a file with arrays; ``table``
is a CSV that grows by lines; ``kinds`` declares each kind of state; ``folder_lock`` keeps a second program out of a folder.
"""
