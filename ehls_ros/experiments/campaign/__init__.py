"""Many experiments from one file: what is varied, where the runs are done, what is kept of them."""
