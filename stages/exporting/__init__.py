"""What `stylerf export` writes: one module per kind, each with `write(job)`."""
