"""Networks: learned models in plain PyTorch, and the files of their weights."""
