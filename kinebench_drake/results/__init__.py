"""Results of runs: rows, metadata, aggregates and the output folder."""
