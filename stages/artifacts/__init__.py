"""Reading and writing what each kind of artifact holds."""
