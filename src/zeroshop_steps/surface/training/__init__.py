"""What the optimizers share: the initial state, losses, Adam, the training loop, options and runs."""
