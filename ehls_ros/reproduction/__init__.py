"""Reproduction of the paper's simulation study: its cases, one module per question, ``study``, which runs all, the report."""
