"""Read bags and tables (CSV, Excel, MAT, TDMS, Parquet) as a Trajectory, write bags, and recover damaged ones."""
