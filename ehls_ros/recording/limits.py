"""Limits of all readers.

Recordings of a rig stay far below them; files above them are refused before they cost memory or time. An hour of ten columns at
1 kHz has 3.6e7 values and takes 0.7 GB as CSV.
"""

TEXT = 4 * 2**20
"""Longest YAML file, bag metadata or reference file; a load spectrum of 10^5 points is shorter [characters]."""

YAML_DEPTH = 50
"""Deepest nesting of collections; a spec has six levels [1]."""

YAML_NUMBER = 400
"""Longest number; the largest float has 309 digits [characters]."""

TABLE = 8 * 2**30
"""Largest CSV, MAT or Parquet file [B]."""

TABLE_LARGER = ": split it by time, or write it as Parquet"

LINE = 2**18
"""Longest line of a CSV file; a thousand columns take a tenth [characters]."""

ROWS = 20_000_000
"""Most samples of a recording: 5.5 h at 1 kHz [1]."""

VALUES = 200_000_000
"""Most numbers of a table, rows times columns: an hour of all signals at 1 kHz [1]."""

BAG = 64 * 2**30
"""Largest bag [B]; an hour of ours takes 4 GB."""

BAG_LARGER = ": `ros2 bag convert` splits it"

TOPICS = 4096
"""Most topics of a bag [1]."""

MESSAGE = 2**16
"""Largest message of a topic that is read; ours have some hundred bytes [B]."""

GATHERED = 2**26
"""Messages decoded together [B]."""

LAYOUTS = 64
"""Most layouts, by the lengths of strings and sequences, among messages decoded together; ours have one or two [1]."""

SUMMARY = 2**26
"""Largest summary of an mcap file and largest record other than a chunk; a bag of 4 GB has 3 MB [B]."""

CHUNK = 2**26
"""Largest chunk of an mcap file, compressed or not; recorders write 1 to 4 MB [B]."""

CHUNKS_AT_ONCE = 2**28
"""Largest total of chunks that overlap in time and so are in memory together [B]."""

EXPANSION = 100
"""Largest compression ratio; a run compresses two- to fivefold, one in which nothing moves elevenfold [1]."""

EXPANDED = 2**26
"""Size to which any file may expand, whatever its ratio [B]."""

COPIES = 4
"""Copies of an expanded MAT or Parquet file that a library may hold [1]."""

SECONDS = 60.0
"""Time to read any file [s]."""

SLOWEST = 1e6
"""Slowest reading rate of a larger file; even a busy computer is ten times as fast [B/s]."""
