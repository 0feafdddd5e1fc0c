"""BOP: test scenes and results in the benchmark's files, pose errors and scores, alignment and export of models."""
