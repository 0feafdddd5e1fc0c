"""App: the command `zeroshop`, which runs the workflow on one object and says what came out."""
