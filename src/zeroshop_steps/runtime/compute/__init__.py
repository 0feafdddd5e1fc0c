"""What computing needs of the machine: threads, memory, and compiled kernels with their cache and devices."""
