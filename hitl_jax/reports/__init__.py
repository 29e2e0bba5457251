"""The report on a folder of results: what holds of the paper's claims."""
