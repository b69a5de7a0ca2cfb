"""Reproduction of the paper's simulation study: cases, one module per question, ``study``, which runs them all, and the report."""
