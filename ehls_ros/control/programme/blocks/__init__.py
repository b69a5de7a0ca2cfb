"""Blocks of a test programme, one file each; ``base`` defines the interface of a file."""

from ehls_ros.control.programme.blocks.base import Block
from ehls_ros.families import Family

BLOCKS: Family[Block] = Family("ehls_ros.control.programme.blocks", "programme block", Block)
