"""Runtime: what every step needs to run as a command: errors, files, options, caching, progress. Knows nothing of images."""
