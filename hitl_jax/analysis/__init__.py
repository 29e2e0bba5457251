"""What saved results say: statistics, tables, figures. Imports nothing but `results`."""
