"""Reproduction of the paper's simulation study, one file per question; ``study`` combines the results."""
