"""Reading and writing the contents of each kind of artifact."""
